"""The types that flow between the stages, and the conventions they share. The first file to read.

The names of the body, `pzcap.anatomy`, are of the conventions and imported from here.

World
    Right-handed, z up, metres. The world frame is the frame of the calibration object.
Camera
    OpenCV axes: x right, y down, z forward. Pixel (0, 0) is the *centre* of the top-left pixel.
Transforms
    ``world_T_cam`` (4, 4) maps camera coordinates to world coordinates. Only that direction is stored; names
    cancel when multiplied: ``world_T_cam = world_T_head @ head_T_cam``.
Head
    The tripod head. Its z axis is the pan axis; at pan 0 (the reference pose) its x axis points to where the camera
    looks and its y axis to the left. Its origin is on that axis, as high as the projection centre.
Angles
    Radians. Positive pan turns the view to the left seen from above, positive tilt turns it up, positive roll turns
    the *camera* clockwise seen from behind it (the image content turns counter-clockwise).
Lens
    A point at normalised image coordinates ``(x, y) = (X/Z, Y/Z)`` is seen at
    ``principal_px + focal_px * (1 + k1 * (x^2 + y^2)) * (x, y)`` (square pixels); `pzcap.geometry.lens` has the rest.
Quaternions
    ``wxyz``, unit length.
Missing values
    A ``valid`` mask stands beside the array. Values where it is False are meaningless but finite; never NaN.
Units
    SI and pixels; a name ends in its unit (``_rad``, ``_px``, ``_m``, ``_s``) where its type does not say it.
    Uncertainty is a sibling in the same unit. Geometry is float64.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.anatomy import DOF as DOF
from pzcap.anatomy import ENDS as ENDS
from pzcap.anatomy import GARMENTS as GARMENTS
from pzcap.anatomy import HINGE_AXES as HINGE_AXES
from pzcap.anatomy import JOINTS as JOINTS
from pzcap.anatomy import LUMBAR_FRACTION as LUMBAR_FRACTION
from pzcap.anatomy import MEASUREMENTS as MEASUREMENTS
from pzcap.anatomy import PARENTS as PARENTS
from pzcap.anatomy import SEGMENTS as SEGMENTS
from pzcap.anatomy import THORAX_FRACTION as THORAX_FRACTION
from pzcap.anatomy import Garment as Garment
from pzcap.anatomy import Sex as Sex
from pzcap.anatomy import without_side as without_side
from pzcap.marks import KnownLength as KnownLength
from pzcap.marks import Mark as Mark

Array = NDArray[np.float64]  # float64 array; the shape stands in the comment or docstring beside it
Image = NDArray[np.uint8]  # uint8 image, (H, W) grey or (H, W, 3) in OpenCV's blue-green-red order
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]
Float32 = NDArray[np.float32]  # float32 array, where precision matters less than memory


class PzcapError(Exception):
    """A fault that a user can mend: the message says in one line what is wrong, where, and what to do about it.

    What it quotes may hold anything: a line break becomes a space, and what no terminal prints its escape.
    """

    def __str__(self) -> str:
        return "".join(
            sign if sign.isprintable() else " " if sign.isspace() else sign.encode("unicode_escape").decode()
            for sign in super().__str__()
        )


# --------------------------------------------------------------------------------------------------------------
# What a crew brings home


@dataclass(frozen=True, slots=True, eq=False)
class Marker:
    """One fiducial marker of the calibration object."""

    id: int
    corners_m: Array  # (4, 3) world; clockwise seen from the front, beginning at the marker's own top left (cv2.aruco)


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationObject:
    dictionary: str  # name of the cv2.aruco dictionary, such as "DICT_4X4_50"
    markers: tuple[Marker, ...]
    wireframe_m: Array  # (E, 2, 3) edges to draw, world


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """The athlete as measured with a tape. Keys are MEASUREMENTS; one that is missing was not measured."""

    measurements_m: dict[str, float]
    sigma_m: float  # standard deviation of a measurement that has none of its own
    sigmas_m: Mapping[str, float] = field(default_factory=dict)  # of those that have
    mass_kg: float | None = None
    sex: Sex | None = None
    loose_m: Mapping[Garment, float] = field(default_factory=dict)  # how far clothes stand off the skin; others: tight

    def sigma_of(self, name: str) -> float:
        """Standard deviation of one measurement."""
        return self.sigmas_m.get(name, self.sigma_m)


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A pose of the skeleton."""

    root_position_m: Array  # (3,) world position of the pelvis joint
    rotations: Array  # (16, 4) wxyz, pelvis: world from segment; others: parent from segment


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A pose of one instant that tracking starts from: fitted to the images by hand, or found from keypoints."""

    frame: int  # index of the frame set
    pose: Pose
    covariance: Array | None = None  # (43, 43) of the pose's tangent; None: a hand fitted it, which errs as hands do
    found: bool = False  # in keypoints; else a person posed it


@dataclass(frozen=True, slots=True, eq=False)
class CameraFiles:
    """Recordings of one camera. A file that the crew did not bring is None."""

    name: str
    reference: Path | None  # still image of the calibration object at the reference pose
    sweep: Path | None  # pan sweep of the empty hall
    zoom: Path | None  # zoom run with the head locked
    motion: Path | None  # the motion, with timecode
    keypoints: Path | None = None  # what a detector found in the motion: a folder or a file
    keypoints_from: int | None = None  # number that it gave to the first picture, 0 or 1; None: its numbers tell


@dataclass(frozen=True, slots=True, eq=False)
class CameraClock:
    """Clock of a camera's motion video against the common one, for cameras without timecode (sync.json)."""

    offset_s: float  # common time of what the file shows at its time 0
    rate: float  # seconds of common time that pass while the file shows one
    sigma_s: float  # standard deviation of the offset
    by: str  # what it is known by: sound, flash, motion, hand


@dataclass(frozen=True, slots=True, eq=False)
class Capture:
    """A capture folder, read and checked. `pzcap.io.capture` reads and writes it; docs/capture.md specifies it."""

    folder: Path
    name: str
    frame_rate: Fraction
    cameras: tuple[CameraFiles, ...]
    calibration_object: CalibrationObject | None
    subject: Subject | None
    keyframe_poses: dict[str, Pose]  # timecode "hh:mm:ss:ff" -> pose
    full_turn: bool  # the sweeps go all the way round, so that the circle closes
    keyframe_covariances: Mapping[str, Array] = field(default_factory=dict)  # (43, 43) of some of these, by timecode
    sync: dict[str, CameraClock] | None = None  # of each camera by its name; None: the videos have timecode
    lengths: tuple[KnownLength, ...] = ()  # what tells how long a metre is, where there is no calibration object


@dataclass(frozen=True, slots=True, eq=False)
class FrameSet:
    """The views of one instant. A view that was dropped or has not been recorded is None."""

    index: int
    timecode: str
    images: tuple[Image | None, ...]  # one a camera, (H, W, 3)
    keypoints: tuple[Array, ...] = ()  # one a camera, (P, 26, 3) as in `pzcap.io.detections`; none: no camera has any
    # one a camera, frame periods from the instant of the frame set to that of the picture, by its stamp; none: all 0
    late: tuple[float, ...] = ()
    # one a camera, the second field of an interlaced frame, half a frame period after the image; none: no camera is
    second_fields: tuple[Image | None, ...] = ()


# --------------------------------------------------------------------------------------------------------------
# Cameras


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A camera at one instant: everything that a projection needs."""

    width: int
    height: int
    world_T_cam: Array  # (4, 4)
    focal_px: float
    principal_px: Array  # (2,)
    k1: float
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """Intrinsics as smooth functions of the focal length: polynomials in log(focal / reference focal)."""

    width: int
    height: int
    reference_focal_px: float
    principal_px: Array  # (P, 2) coefficients, constant first
    k1: Array  # (Q,) coefficients, constant first; of the others as well, by default none
    k2: Array = field(default_factory=lambda: np.zeros(1))
    p1: Array = field(default_factory=lambda: np.zeros(1))
    p2: Array = field(default_factory=lambda: np.zeros(1))
    # (3,) how much larger blue, green and red are than grey values, relative, about the middle of the image; frames are
    # rid of it where they are compared with the panorama (`pzcap.imaging.colour`)
    lateral_colour: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class PanZoomCamera:
    """A camera on a head: what stays while it pans and zooms. `pzcap.geometry.camera.at` gives an instant's Camera."""

    lens: Lens
    world_T_head: Array  # (4, 4)
    tilt_rad: float  # of the optical axis against the plane normal to the pan axis
    roll_rad: float
    # the projection centre against the pan axis, forward and to the left (what the slide head left)
    offset_m: Array = field(default_factory=lambda: np.zeros(2), kw_only=True)  # (2,)
    # relative, of all focal lengths in common: the scale of the sweep, which only a closed circle fixes well
    focal_sigma: float = field(default=0.0, kw_only=True)
    # covariance of pan and log focal that calibration's own errors give all frames, at equally spaced pans from 0 to
    # the left, and at focal lengths in units of the reference's; none: not known, and focal_sigma stands for it
    shared_covariance: Array = field(default_factory=lambda: np.zeros((0, 0, 2, 2)), kw_only=True)  # (P, Z, 2, 2)
    shared_zooms: Array = field(default_factory=lambda: np.zeros(0), kw_only=True)  # (Z,)
    # of the projection centre, forward along the optical axis, for each unit of log focal
    travel_m: float = field(default=0.0, kw_only=True)
    # read-out of a rolling shutter: how long after the top edge the bottom edge is exposed, and its standard deviation
    readout_s: float = field(default=0.0, kw_only=True)
    readout_sigma_s: float = field(default=0.0, kw_only=True)
    # how long after the instant of a frame set the camera exposes it, by its own clock, and the standard deviation
    clock_s: float = field(default=0.0, kw_only=True)
    clock_sigma_s: float = field(default=0.0, kw_only=True)


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceCamera:
    """One camera at its reference pose, from the image of the calibration object (section 3.4)."""

    camera: Camera
    points_m: Array  # (N, 3) marker corners, world
    points_px: Array  # (N, 2) where they were detected
    residuals_px: Array  # (N, 2) detected minus projected; of the corners, also where the pose is not fitted to them


@dataclass(frozen=True, slots=True, eq=False)
class InverseDepthMap:
    """Nearness of the hall, as far as it matters to a projection centre that is not quite on the pan axis.

    Inverse distance from the pan axis, 1 / m: a floor so far below, or the wall before it, and what departs from these.
    """

    height_m: float
    walls: Array  # (A,) at equally spaced azimuths round the turn, from 0 to the left; none: all is far away
    departures: Array  # (R, A) how much nearer it is, as a share of that; rows at equally spaced slopes
    slopes: Array  # (2,) of their first and last row
    lean: Array = field(default_factory=lambda: np.zeros(2), kw_only=True)
    """(2,) by how much the floor rises towards azimuth 0, and to the left of it: the pan axis is not quite upright."""


FAR_AWAY: Final = InverseDepthMap(1.0, np.zeros(0), np.zeros((0, 0)), np.zeros(2))


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Panorama:
    """The empty hall on a cylinder about the pan axis (section 3, eqs. 3-6).

    A direction at azimuth ``a`` (positive to the left of the reference pose's view) and slope ``h`` (height over
    horizontal distance) stands at column ``origin_px[0] - a * px_per_rad`` and row ``origin_px[1] - h * px_per_rad``.
    A panorama of a full turn wraps: columns are modulo ``2 * pi * px_per_rad``, which then equals the image width.
    """

    image: Image  # (H, W, 3)
    valid: Mask  # (H, W) something was pasted here
    px_per_rad: float
    origin_px: Array  # (2,) column and row of azimuth 0, slope 0
    full_turn: bool
    sweep_pan_rad: Array  # (M,) pan of each sweep frame
    sweep_inliers: NDArray[np.int64]  # (M,) feature matches that agreed with the neighbouring frames
    closure_rad: float  # what the chain of displacements missed the full turn by, before it was distributed
    residual_px: float  # RMS of the sweep's feature matches after the adjustment
    surroundings: InverseDepthMap = FAR_AWAY
    fine: NDArray[np.uint16] = field(default_factory=lambda: np.zeros((0, 0), np.uint16))
    # (5 H, 7 W) the hall within pixels, as `pzcap.extras.superresolution` has it; empty: not known


@dataclass(frozen=True, slots=True, eq=False)
class Localisation:
    """One frame found on the panorama (section 4)."""

    pan_rad: float
    tilt_rad: float
    focal_px: float
    covariance: Array  # (2, 2) of (pan_rad, log focal)
    valid: bool
    frame_points_px: Array  # (N, 2) inlier matches in the frame
    panorama_points_px: Array  # (N, 2) and in the panorama
    roll_rad: float = 0.0  # beyond the camera's own
    sway_sigma: Array = field(default_factory=lambda: np.ones(2))  # (2,) of tilt and roll
    # change of pan and log focal from the top edge to the bottom edge, with a rolling shutter
    shear: Array = field(default_factory=lambda: np.zeros(2))  # (2,)
    shear_sigma: Array = field(default_factory=lambda: np.ones(2))  # (2,)
    bands: Array = field(default_factory=lambda: np.zeros(0))  # (K,) of mains light, `pzcap.imaging.row_bands`
    readout: float = 0.0  # frame periods from the top edge to the bottom edge, as known by then
    # pan and log focal half a frame period later, by the second field of an interlaced frame; none: it is whole
    second_field: Array = field(default_factory=lambda: np.zeros(0))  # (2,)
    # change of pan and log focal that is expected since the frame before, where that one's picture is shown once more
    missed: Array = field(default_factory=lambda: np.zeros(2))  # (2,)


@dataclass(frozen=True, slots=True, eq=False)
class PanZoomTrack:
    """Pan and zoom of one camera, a value a frame set."""

    pan_rad: Array  # (F,)
    tilt_rad: Array  # (F,)
    roll_rad: Array  # (F,) beyond the camera's own
    focal_px: Array  # (F,)
    covariance: Array  # (F, 2, 2) of (pan_rad, log focal)
    inliers: NDArray[np.int64]  # (F,)
    valid: Mask  # (F,)
    # with a rolling shutter: change of pan and log focal from the top edge to the bottom edge, and the read-out, frame
    # periods, as it was known by then; none: all rows are exposed at once
    shear: Array = field(default_factory=lambda: np.zeros((0, 2)))  # (F, 2)
    readout: Array = field(default_factory=lambda: np.zeros(0))  # (F,)


@dataclass(frozen=True, slots=True, eq=False)
class Silhouette:
    """Foreground of one view (stage 5). Where nobody expects the athlete it is all zero."""

    probability: Image  # (H, W) 0..255, that the pixel shows the athlete
    background: Image  # (H, W, 3) the panorama as this camera sees it, gain matched to the frame
    evidence: NDArray[np.float32]  # (H // 2, W // 2) log-odds that it shows the athlete, from its colours alone
    valid: bool
    others: Image = field(default_factory=lambda: np.zeros((0, 0), np.uint8))  # (H // 2, W // 2) 0: nobody else


@dataclass(frozen=True, slots=True, eq=False)
class MovedBody:
    """The body that a `Motion` moves, in the zero pose: all that a rig is made of. Every vertex is carried by one
    segment, as the tracker has it."""

    offsets_m: Array  # (16, 3) joint of each segment in its parent's frame; zero for the root
    ends_m: Array  # (7, 3) ENDS, each in the frame of its segment
    skin_m: Array  # (V, 3) vertices, each in the frame of its segment
    skin_segment: Indices  # (V,) index into SEGMENTS
    skin_faces: Indices  # (T, 3) triangles, counter-clockwise seen from outside


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The athlete's motion (section 5)."""

    root_position_m: Array  # (F, 3)
    rotations: Array  # (F, 16, 4) as in Pose
    joints_m: Array  # (F, 16, 3) JOINTS, world
    sigma_m: Array  # (F, 16) standard deviation of a joint's distance from the truth
    keyframes: NDArray[np.int64]  # (K,) frame indices that a person posed; not those found from keypoints
    valid: Mask  # (F,)
    body: MovedBody | None = None  # None where joints alone were found

    def pose(self, frame: int) -> Pose:
        """The pose of one frame."""
        return Pose(self.root_position_m[frame], self.rotations[frame])


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """Everything the pipeline found. A stage that could not run (something was not brought home) left None."""

    capture_name: str
    method: str
    frame_rate: Fraction
    timecodes: tuple[str, ...]  # (F,)
    camera_names: tuple[str, ...]  # (C,)
    references: tuple[ReferenceCamera | None, ...]  # (C,)
    cameras: tuple[PanZoomCamera | None, ...]  # (C,)
    panoramas: tuple[Panorama | None, ...]  # (C,)
    tracks: tuple[PanZoomTrack | None, ...]  # (C,)
    # (C,) what each frame alone gave, not smoothed, corrected by the body; None where none was tracked
    refined: tuple[PanZoomTrack | None, ...]
    motion: Motion | None
    notes: tuple[str, ...]  # what was skipped, and why; what the motion says about its keyframes
