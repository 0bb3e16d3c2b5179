"""The rows of the board that this tree makes: each method, the tracks that it enters, and the run that answers for it.

Methods that share most of their work, such as those of the peer bench, are run together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from experiments.benchmark.methods import bodies, cameras
from experiments.benchmark.methods.given import Answered, Given
from experiments.comparisons.peers import bench


@dataclass(frozen=True, slots=True)
class Method:
    """One row of the board."""

    key: str
    label: str
    tracks: tuple[str, ...]
    run: str  # of RUNS
    published: str = ""  # what its authors reached on data of their own, and where they say it
    notes: str = ""


RUNS: Final[Mapping[str, Callable[[Given], dict[str, Answered]]]] = {
    "ours": bodies.run_ours,
    "paper": cameras.run_paper,
    "peers": cameras.run_peers,
    "self_calibration": cameras.run_self_calibration,
    "triangulated": bodies.run_triangulated,
    "fixed_tools": bodies.run_fixed_tools,
    "locked": bodies.run_locked,
    "trackers": bodies.run_trackers,
}

_LOCKED: Final = (
    "other footage: the same motion by cameras that stand still and have all of its way in view; cameras are not scored"
)

_LOCATED: Final = "sees the views that pzcap's own cameras were found in"

METHODS: Final[tuple[Method, ...]] = (
    Method("ours", "pzcap", ("everything", "cameras"), "ours"),
    Method(
        "paper",
        "Yamamoto's method (eqs. 6, 15)",
        ("cameras",),
        "paper",
        published="no figure: the paper shows an overlay on the calibration object (Fig. 8)",
    ),
    *(
        Method(
            f"peer_{key}",
            bench.METHODS[key].label.replace("ours", "pzcap"),
            ("cameras_given_panorama",),
            "peers",
            notes="CPU time of one thread, decoding and calibration not counted",
        )
        for key in cameras.PEERS
    ),
    Method("shum_szeliski", "Shum and Szeliski (2000)", ("self_calibration",), "self_calibration"),
    Method("sinha_pollefeys", "Sinha and Pollefeys (2006)", ("self_calibration",), "self_calibration"),
    Method("wu_radke", "Wu and Radke (2013)", ("self_calibration",), "self_calibration"),
    Method("triangulated", "keypoints triangulated, pzcap's cameras", ("everything",), "triangulated"),
    Method(
        "pose2sim",
        "Pose2Sim 0.10, virtual fixed cameras",
        ("everything",),
        "fixed_tools",
        published="joint angles of the legs, mean error: walking 3.0, running 4.1, cycling 4.0 deg "
        "(Pagnon et al. 2022, Sensors 22, 2712)",
        notes="triangulation and filter; virtual cameras that stand for pzcap's, keypoints carried over",
    ),
    Method(
        "aniposelib",
        "aniposelib 0.8, virtual fixed cameras",
        ("everything",),
        "fixed_tools",
        notes="triangulation alone; virtual cameras that stand for pzcap's, keypoints carried over",
    ),
    Method("locked", "pzcap, locked cameras", ("everything",), "locked", notes=_LOCKED),
    Method("locked_triangulated", "keypoints triangulated, locked cameras", ("everything",), "locked", notes=_LOCKED),
    Method("triangulated_true_cameras", "keypoints triangulated", ("body_given_cameras",), "triangulated"),
    Method("tracker_true_cameras", "pzcap's tracker", ("body_given_cameras",), "trackers", notes=_LOCATED),
    Method("tracker_true_cameras_masks", "pzcap's tracker", ("body_given_cameras_masks",), "trackers", notes=_LOCATED),
)
