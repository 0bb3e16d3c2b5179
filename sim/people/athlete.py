"""The athlete: an MJCF tree of sixteen segments, dressed. Kinematics and rendering only; nothing collides."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Final, Literal

import mujoco
import numpy as np

from pzcap.types import HINGE_AXES, LUMBAR_FRACTION, PARENTS, SEGMENTS, THORAX_FRACTION, Garment, Pose
from sim.people import anthropometry
from sim.people.clothing import Wardrobe, paint
from sim.ranges import Range

GEOM_GROUP: Final = 1
"""The athlete's geoms, so that segmentation and hiding can tell them from the hall."""

CLOTH: Final = "cloth_"
"""Begins the name of a loose piece's body; that of the segment below it follows."""

_ELLIPSOID, _CAPSULE = mujoco.mjtGeom.mjGEOM_ELLIPSOID, mujoco.mjtGeom.mjGEOM_CAPSULE
_Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class AthleteConfig:
    """The looks of the athlete."""

    clothing: Literal["rich", "plain"] = "rich"
    """rich: printed shirt and seams, whose texture can be tracked; plain: cloth of weak texture."""
    sleeves: Literal["short", "long"] = "short"
    """Sleeves of the shirt. Long ones make the forearms look like the trunk: their colours tell nothing."""
    loose_m: Annotated[float, Range(0.0, 0.2)] = 0.0
    """Metres that T-shirt and trousers stand off the skin, hang behind its motion by at most, and swing; 0: all is
    tight."""
    skirt: bool = False
    """A skirt to the middle of the thighs over loose trousers."""
    ponytail: bool = False
    """Hair that hangs down behind the head, and behind its motion."""

    def garments(self) -> dict[Garment, float]:
        """How far the loose clothes stand off the skin, metres."""
        worn: dict[Garment, float] = {"shirt": self.loose_m, "trousers": self.loose_m} if self.loose_m else {}
        return worn | ({"skirt": self.loose_m + 0.02} if self.skirt else {})


@dataclass(frozen=True, slots=True)
class _Shape:
    """One geom: an ellipsoid (centre, half axes) or a capsule (`to` set: from centre to there, radius in half[0])."""

    segment: str
    skin: str  # a part that `clothing.paint` knows
    centre: _Vector
    half: _Vector
    to: _Vector | None = None

    def girth_m(self) -> float:
        a, b = (self.half[0], self.half[1]) if self.to is None else (self.half[0], self.half[0])
        return float(2 * np.pi * np.sqrt((a * a + b * b) / 2))

    def length_m(self) -> float:
        return float(np.pi * self.half[2] if self.to is None else np.linalg.norm(np.subtract(self.to, self.centre)))


def add_athlete(
    spec: mujoco.MjSpec,
    measurements: dict[str, float],
    config: AthleteConfig,
    rng: np.random.Generator,
    prefix: str = "",
    group: int = GEOM_GROUP,
) -> None:
    """Add the athlete to the world: bodies and joints named as `types.SEGMENTS` (the free joint: "root").

    Geoms are in ``group``; girths are those of ``measurements`` (metres) where the tape lies. ``rng`` chooses
    colours and print. Of other people a ``prefix`` stands before all names.
    """
    tree = anthropometry.body_tree(measurements)
    bodies: dict[str, mujoco.MjsBody] = {}
    for s, name in enumerate(SEGMENTS):
        parent = spec.worldbody if PARENTS[s] < 0 else bodies[SEGMENTS[PARENTS[s]]]
        body = bodies[name] = parent.add_body(name=prefix + name, pos=tree.offsets_m[s])
        if PARENTS[s] < 0:
            body.add_joint(name=prefix + "root", type=mujoco.mjtJoint.mjJNT_FREE)
            continue
        limits = anthropometry.joint_limit_rad(name)
        if name in HINGE_AXES:
            hinge = mujoco.mjtJoint.mjJNT_HINGE
            body.add_joint(name=prefix + name, type=hinge, axis=HINGE_AXES[name], limited=1, range=np.degrees(limits))
        else:
            body.add_joint(name=prefix + name, type=mujoco.mjtJoint.mjJNT_BALL, limited=1, range=np.degrees(limits))
    wardrobe = Wardrobe.draw(config.clothing == "rich", rng)
    materials: dict[tuple[str, str], str] = {}

    def add(body: mujoco.MjsBody, shape: _Shape) -> None:
        key = (shape.segment, shape.skin)
        if key not in materials:
            materials[key] = _add_material(spec, shape, wardrobe, rng, prefix)
        geom = body.add_geom(
            type=_ELLIPSOID if shape.to is None else _CAPSULE, material=materials[key], group=group,
            contype=0, conaffinity=0,
        )  # fmt: skip
        if shape.to is None:
            geom.pos, geom.size = shape.centre, shape.half
        else:
            geom.fromto, geom.size = [*shape.centre, *shape.to], [shape.half[0], 0.0, 0.0]

    shapes = list(_shapes(measurements))
    for shape in shapes:
        if config.sleeves == "long" and shape.skin == "skin" and shape.segment.endswith("arm"):
            shape = replace(shape, skin="sleeve")
        add(bodies[shape.segment], shape)
    for piece in _loose(measurements, shapes, config):
        if (cloth := CLOTH + piece.segment) not in bodies:
            # nobody sees it before it is hung
            bodies[cloth] = spec.worldbody.add_body(name=prefix + cloth, mocap=True, pos=(0.0, 0.0, -10.0))
        add(bodies[cloth], piece)


def set_pose(model: mujoco.MjModel, data: mujoco.MjData, pose: Pose, prefix: str = "") -> None:
    """Write a pose to ``data.qpos``. A hinge takes the angle about its axis; call ``mj_kinematics`` afterwards.
    ``prefix`` as `add_athlete` has it."""
    for s, name in enumerate(SEGMENTS):
        at = int(model.joint(prefix + ("root" if PARENTS[s] < 0 else name)).qposadr[0])
        if PARENTS[s] < 0:
            data.qpos[at : at + 3] = pose.root_position_m
            data.qpos[at + 3 : at + 7] = pose.rotations[s]
        elif name in HINGE_AXES:
            angle = 2.0 * np.arctan2(np.dot(HINGE_AXES[name], pose.rotations[s, 1:]), pose.rotations[s, 0])
            data.qpos[at] = (angle + np.pi) % (2 * np.pi) - np.pi
        else:
            data.qpos[at : at + 4] = pose.rotations[s]


def _add_material(spec: mujoco.MjSpec, shape: _Shape, wardrobe: Wardrobe, rng: np.random.Generator, prefix: str) -> str:
    name = f"{prefix}athlete_{shape.segment}_{shape.skin}"
    side = shape.segment.split("_")[0]
    part = f"{side}_{shape.skin}" if shape.skin in ("thigh", "shank") else shape.skin
    image = paint(part, shape.girth_m(), shape.length_m(), wardrobe, rng)
    texture = spec.add_texture(
        name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=image.shape[1], height=image.shape[0], nchannel=3
    )
    texture.data = image.tobytes()
    material = spec.add_material(name=name, specular=0.1, shininess=0.1)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return name


def _oval(girth_m: float, flatness: float) -> tuple[float, float]:
    """Return half depth (x) and half breadth (y) of an ellipse of this girth whose depth is ``flatness`` x breadth."""
    breadth = girth_m / (2 * np.pi * np.sqrt((1 + flatness**2) / 2))
    return float(flatness * breadth), float(breadth)


def _shapes(m: dict[str, float]) -> Iterable[_Shape]:
    yield from _trunk(m)
    yield from _head(m)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        yield from _arm(m, side, sign)
        yield from _leg(m, side, sign)


_WORN: Final = ("hips", "seat", "waist", "chest", "yoke", "sleeve", "thigh", "shank")
"""Skins that T-shirt and trousers cover."""


def _loose(m: dict[str, float], shapes: Iterable[_Shape], config: AthleteConfig) -> Iterable[_Shape]:
    """Pieces of loose clothes and hair, in the frames of the segments below them."""
    if config.loose_m:
        for shape in shapes:
            if shape.skin in _WORN:
                a, b, c = shape.half
                wider = (a + config.loose_m, b + config.loose_m, c + 0.3 * config.loose_m if shape.to is None else c)
                yield replace(shape, half=wider)
    if config.skirt:
        depth, breadth = _oval(m["girth_hips"], 0.80)
        length, room = 0.55 * m["thigh"], config.loose_m + 0.02
        half = (depth + room, breadth + room, 0.6 * length)
        yield _Shape("pelvis", "hips", (0.0, 0.0, -0.25 * length), half)
        yield _Shape(
            "pelvis", "hips", (0.0, 0.0, -0.6 * length), (depth + 1.6 * room, breadth + 1.6 * room, 0.4 * length)
        )
    if config.ponytail:
        behind, height = -0.5 * m["girth_head"] / np.pi, 0.6 * m["head"]
        for k in range(3):
            yield _Shape("head", "hair", (behind - 0.02, 0.0, height - 0.09 * k), (0.024 - 0.004 * k, 0.026, 0.07))


def _trunk(m: dict[str, float]) -> Iterable[_Shape]:
    top = (1 - THORAX_FRACTION) * m["trunk"]
    waist_z = (THORAX_FRACTION - LUMBAR_FRACTION) * m["trunk"]
    depth, breadth = _oval(m["girth_hips"], 0.76)
    yield _Shape("pelvis", "hips", (-0.008, 0, 0.1 * m["trunk"] - 0.02), (depth * 0.95, breadth, 0.24 * m["trunk"]))
    for y in (0.42, -0.42):
        half = (0.62 * depth, 0.56 * breadth, 0.16 * m["trunk"])
        yield _Shape("pelvis", "seat", (-0.42 * depth, y * breadth, -0.01), half)
    depth, breadth = _oval(m["girth_waist"], 0.74)
    yield _Shape("lumbar", "waist", (0.0, 0, 0.35 * waist_z), (depth, breadth, 1.4 * waist_z))
    depth, breadth = _oval(m["girth_chest"], 0.70)
    shoulder = top - m["shoulder_drop"]
    yield _Shape("thorax", "chest", (0.0, 0, 0.36 * top), (depth, breadth, 0.58 * top))
    yield _Shape("thorax", "waist", (0.0, 0, 0.10 * top), (0.93 * depth, 0.92 * breadth, 0.72 * top))  # ribs
    # shoulder girdle and the slope from neck to shoulder
    reach = 0.5 * m["shoulder_width"]
    yield _Shape("thorax", "yoke", (-0.006, 0, shoulder - 0.022), (0.62 * depth, 1.12 * reach, 0.25 * top))
    yield _Shape("thorax", "yoke", (-0.014, 0, shoulder + 0.014), (0.44 * depth, 0.60 * reach, 0.048))


def _head(m: dict[str, float]) -> Iterable[_Shape]:
    neck, height = m["girth_neck"] / (2 * np.pi), m["head"]
    yield _Shape("head", "skin", (-0.018, 0, -0.06), (neck, neck, neck), (0.0, 0, 0.25 * height))
    breadth, depth = _oval(m["girth_head"], 0.80)
    yield _Shape("head", "skin", (0.014, 0, 0.52 * height), (0.97 * depth, 0.96 * breadth, 0.41 * height))
    yield _Shape("head", "skin", (0.026, 0, 0.26 * height), (0.72 * depth, 0.80 * breadth, 0.25 * height))  # jaw
    yield _Shape("head", "skin", (0.016 + 0.97 * depth, 0, 0.43 * height), (0.013, 0.010, 0.024))  # nose
    for y in (1.0, -1.0):
        yield _Shape("head", "skin", (0.004, y * 0.98 * breadth, 0.48 * height), (0.016, 0.008, 0.030))  # ear
        yield _Shape("head", "hair", (0.014 + 0.90 * depth, y * 0.034, 0.585 * height), (0.008, 0.018, 0.006))  # brow
        yield _Shape("head", "hair", (0.014 + 0.93 * depth, y * 0.032, 0.535 * height), (0.006, 0.011, 0.006))  # eye
    # the hair lies round the skull, leaves the face free and ends at the vertex
    yield _Shape("head", "hair", (-0.004, 0, 0.70 * height), (0.98 * depth, 1.05 * breadth, 0.30 * height))
    yield _Shape("head", "hair", (-0.026, 0, 0.52 * height), (0.80 * depth, 0.97 * breadth, 0.34 * height))


def _arm(m: dict[str, float], side: str, sign: float) -> Iterable[_Shape]:
    upper, elbow = m["girth_upper_arm"] / (2 * np.pi), m["girth_elbow"] / (2 * np.pi)
    lower, wrist = m["girth_forearm"] / (2 * np.pi), m["girth_wrist"] / (2 * np.pi)
    segment, length = f"{side}_upper_arm", m["upper_arm"]
    yield _Shape(segment, "sleeve", (0, -sign * 0.006, -0.036), (1.12 * upper, 1.06 * upper, 1.45 * upper))  # deltoid
    yield _Shape(segment, "sleeve", (0, 0, -0.36 * length), (upper, upper, 0.42 * length))
    yield _Shape(segment, "skin", (0, 0, -0.42 * length), (0.94 * elbow, 0, 0), (0, 0, -length))
    yield _Shape(segment, "skin", (0.004, 0, -0.5 * length), (0.97 * upper, 0.97 * upper, 0.44 * length))
    segment, length = f"{side}_forearm", m["forearm"]
    yield _Shape(segment, "skin", (0.002, 0, -0.28 * length), (lower, lower, 0.48 * length))
    yield _Shape(segment, "skin", (0, 0, -0.12 * length), (wrist, 0, 0), (0, 0, -length))
    segment, length = f"{side}_hand", m["hand"]
    yield _Shape(segment, "skin", (0, 0, -0.28 * length), (0.016, 0.040, 0.30 * length))
    for y, reach in ((0.027, 0.92), (0.009, 1.0), (-0.009, 0.98), (-0.027, 0.86)):
        tip = (0.0, 0.9 * y, -reach * length + 0.009)
        yield _Shape(segment, "skin", (0, y, -0.42 * length), (0.009, 0, 0), tip)
    # the thumb is towards the body when the palm faces back
    yield _Shape(
        segment, "skin", (0, -sign * 0.026, -0.16 * length), (0.011, 0, 0), (0.008, -sign * 0.056, -0.48 * length)
    )


def _leg(m: dict[str, float], side: str, sign: float) -> Iterable[_Shape]:
    thigh, knee = m["girth_thigh"] / (2 * np.pi), m["girth_knee"] / (2 * np.pi)
    calf, ankle = m["girth_calf"] / (2 * np.pi), m["girth_ankle"] / (2 * np.pi)
    segment, length = f"{side}_thigh", m["thigh"]
    yield _Shape(segment, "thigh", (0, sign * 0.012, -0.26 * length), (thigh, thigh, 0.52 * length))
    yield _Shape(segment, "thigh", (0, 0, -0.66 * length), (1.12 * knee, 1.12 * knee, 0.42 * length))
    yield _Shape(segment, "thigh", (0, 0, -0.3 * length), (knee, 0, 0), (0, 0, -length))
    segment, length = f"{side}_shank", m["shank"]
    yield _Shape(segment, "shank", (-0.010, 0, -0.30 * length), (calf, calf, 0.40 * length))
    yield _Shape(segment, "shank", (0, 0, -0.55 * length), (1.15 * ankle, 1.15 * ankle, 0.42 * length))
    yield _Shape(segment, "shank", (0, 0, -0.1 * length), (0.85 * knee, 0.85 * knee, 0.14 * length))
    yield _Shape(segment, "sock", (0, 0, -0.6 * length), (ankle, 0, 0), (0, 0, -length))
    segment, sole, foot = f"{side}_foot", m["ankle_height"], m["foot"]
    heel, ball = 0.48 * sole, 0.045
    yield _Shape(segment, "shoe", (-0.25 * foot + heel, 0, heel - sole), (heel, 0, 0), (0.30 * foot, 0, heel - sole))
    yield _Shape(segment, "shoe", (0.42 * foot, 0, 0.020 - sole), (0.33 * foot, ball, 0.020))
    yield _Shape(segment, "shoe", (0.10 * foot, 0, 0.030 - sole), (0.30 * foot, 0.036, 0.030))
    yield _Shape(segment, "shoe", (0.0, 0, 0.0), (0.8 * ankle, 0, 0), (0.40 * foot, 0, 0.026 - sole))  # instep
