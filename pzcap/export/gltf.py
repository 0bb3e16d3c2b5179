"""glTF 2.0, one binary file: the skinned body and the cameras; metres, y up, facing +z in the zero pose.

Zoom is animated by the extension KHR_animation_pointer. A camera has a vertical field of view and no more: the
principal point and the distortion stand in the table beside. Frames without a body or a camera have no key: viewers
interpolate.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pzcap.export.axes import LOOKING_BACK, Y_UP_FACING_Z
from pzcap.export.rest_pose import BONE_PARENTS, BONES, rest_pose
from pzcap.export.take import LocatedCamera, Take, library
from pzcap.io.files import write_bytes
from pzcap.types import Array, Camera, Mask

_POINTER: Final = "KHR_animation_pointer"
_KINDS: Final = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


def write(take: Take, folder: Path) -> list[Path]:
    """Write what of body and cameras there is; the file."""
    scene = _Scene(take, library("pygltflib", "glTF"))
    motion = take.reconstruction.motion
    if motion is not None and motion.body is not None:
        scene.add_body()
    else:
        take.cameras()  # one of the two there must be
    if any(track is not None and track.valid.any() for track in take.reconstruction.tracks):
        for located in take.cameras():
            scene.add_camera(located)
    return [write_bytes(folder / f"{take.file}.glb", scene.content())]


class _Scene:
    """A file that is being put together: its arrays lie one after the other in one buffer."""

    def __init__(self, take: Take, gltf: Any) -> None:
        self._take, self._gltf = take, gltf
        self._data = bytearray()
        self._root = gltf.GLTF2(scene=0, scenes=[gltf.Scene(nodes=[])], asset=gltf.Asset(generator="pzcap"))
        self._animation = gltf.Animation(name=take.file)

    def content(self) -> bytes:
        """The whole file."""
        if self._animation.channels:
            self._root.animations.append(self._animation)
        self._root.buffers.append(self._gltf.Buffer(byteLength=len(self._data)))
        self._root.set_binary_blob(bytes(self._data))
        return b"".join(self._root.save_to_bytes())

    def add_body(self) -> None:
        """The athlete: bones as nodes, the skin, and the motion."""
        gltf, nodes = self._gltf, self._root.nodes
        motion, body = self._take.rig()
        rest, first, turn = rest_pose(body), len(nodes), Y_UP_FACING_Z
        for name, offset in zip(BONES, rest.offsets_m, strict=True):
            nodes.append(gltf.Node(name=name, translation=(turn @ offset).tolist(), children=[]))
        for bone, parent in enumerate(BONE_PARENTS):
            if parent >= 0:
                nodes[first + parent].children.append(first + bone)
        inverse = np.tile(np.eye(4), (len(BONES), 1, 1))
        inverse[:, 3, :3] = -rest.places_m @ turn.T  # columns of each matrix one after the other
        self._root.skins.append(
            gltf.Skin(
                inverseBindMatrices=self._array(inverse.reshape(-1, 16)),
                joints=list(range(first, first + len(BONES))),
                skeleton=first,
            )
        )
        carriers = np.zeros((len(rest.carriers), 4), np.uint16)
        carriers[:, 0] = rest.carriers
        points = self._array(rest.skin_m @ turn.T, bounds=True, target=gltf.ARRAY_BUFFER)
        attributes = gltf.Attributes(
            POSITION=points,
            NORMAL=self._array(rest.normals @ turn.T, target=gltf.ARRAY_BUFFER),
            JOINTS_0=self._array(carriers, target=gltf.ARRAY_BUFFER),
            WEIGHTS_0=self._array(np.tile([1.0, 0.0, 0.0, 0.0], (len(carriers), 1)), target=gltf.ARRAY_BUFFER),
        )
        faces = self._array(rest.faces.astype(np.uint32).reshape(-1, 1), target=gltf.ELEMENT_ARRAY_BUFFER)
        self._root.meshes.append(gltf.Mesh(primitives=[gltf.Primitive(attributes=attributes, indices=faces)]))
        nodes.append(gltf.Node(name="skin", mesh=len(self._root.meshes) - 1, skin=len(self._root.skins) - 1))
        self._root.scenes[0].nodes += [first, len(nodes) - 1]

        times = self._times(motion.valid)
        self._animate(times, motion.root_position_m[motion.valid] @ turn.T, {"node": first, "path": "translation"})
        for segment in range(motion.rotations.shape[1]):
            quaternions = Rotation.from_quat(motion.rotations[motion.valid, segment], scalar_first=True)
            turned = turn @ quaternions.as_matrix() @ turn.T
            self._animate(times, _quaternions(turned), {"node": first + segment, "path": "rotation"})

    def add_camera(self, located: LocatedCamera) -> None:
        """A camera: its node moves and turns, its field of view zooms."""
        gltf, turn = self._gltf, Y_UP_FACING_Z
        cameras: list[Camera] = [camera for _, camera in located.frames()]
        poses = np.array([camera.world_T_cam for camera in cameras])
        places, turned = poses[:, :3, 3] @ turn.T, _quaternions(turn @ poses[:, :3, :3] @ LOOKING_BACK)
        fields = 2.0 * np.arctan([0.5 * camera.height / camera.focal_px for camera in cameras])
        lens, node = located.head.lens, len(self._root.nodes)
        view = gltf.Perspective(aspectRatio=lens.width / lens.height, yfov=float(fields[0]), znear=0.1)
        self._root.cameras.append(gltf.Camera(type="perspective", name=located.name, perspective=view))
        number = len(self._root.cameras) - 1
        pose = {"translation": places[0].tolist(), "rotation": turned[0].tolist()}
        self._root.nodes.append(gltf.Node(name=f"camera_{located.file}", camera=number, **pose))
        self._root.scenes[0].nodes.append(node)
        times = self._times(located.track.valid)
        self._animate(times, places, {"node": node, "path": "translation"})
        self._animate(times, turned, {"node": node, "path": "rotation"})
        pointer = {_POINTER: {"pointer": f"/cameras/{number}/perspective/yfov"}}
        self._animate(times, fields[:, None], {"path": "pointer", "extensions": pointer})
        if _POINTER not in self._root.extensionsUsed:
            self._root.extensionsUsed.append(_POINTER)

    def _times(self, valid: Mask) -> int:
        return self._array(self._take.times_s[valid][:, None], bounds=True)

    def _animate(self, times: int, values: Array, target: dict[str, Any]) -> None:
        self._animation.samplers.append(self._gltf.AnimationSampler(input=times, output=self._array(values)))
        sampler = len(self._animation.samplers) - 1
        where = self._gltf.AnimationChannelTarget(**target)
        self._animation.channels.append(self._gltf.AnimationChannel(sampler=sampler, target=where))

    def _array(self, values: NDArray[Any], *, bounds: bool = False, target: int | None = None) -> int:
        """Append ``values`` (N, K) to the buffer; the number of their accessor. Floats become float32."""
        stored = values if values.dtype.kind == "u" else values.astype(np.float32)
        kinds = {"float32": self._gltf.FLOAT, "uint16": self._gltf.UNSIGNED_SHORT, "uint32": self._gltf.UNSIGNED_INT}
        start, raw = len(self._data), np.ascontiguousarray(stored).tobytes()
        self._data += raw + bytes(-len(raw) % 4)
        view = self._gltf.BufferView(buffer=0, byteOffset=start, byteLength=len(raw), target=target)
        self._root.bufferViews.append(view)
        limits = {"min": stored.min(axis=0).tolist(), "max": stored.max(axis=0).tolist()} if bounds else {}
        self._root.accessors.append(
            self._gltf.Accessor(
                bufferView=len(self._root.bufferViews) - 1,
                componentType=kinds[stored.dtype.name],
                count=len(stored),
                type=_KINDS[stored.shape[1]],
                **limits,
            )
        )
        return len(self._root.accessors) - 1


def _quaternions(rotations: Array) -> Array:
    """(N, 4) x, y, z, w of rotations (N, 3, 3), each on the side of the one before: viewers go straight between."""
    found = Rotation.from_matrix(rotations).as_quat()
    flips = np.where(np.sum(found[1:] * found[:-1], axis=1) < 0.0, -1.0, 1.0)
    return np.asarray(found * np.concatenate([[1.0], np.cumprod(flips)])[:, None])
