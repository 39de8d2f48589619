"""What ANYmal C looks like, in primitive shapes; physics knows nothing of it.

Sizes are read off the extents of the meshes of `anymal_c_simple_description` (see `anymal_c`). Leg shapes are those
of the left front leg in its link's frame [m]; the others are reflections.
"""

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from arrive.robots.parts import VISUAL_GROUP, Vec3

RED = (0.88, 0.22, 0.17)
BLACK = (0.06, 0.06, 0.07)
DARK = (0.15, 0.16, 0.18)
COVER = (0.25, 0.25, 0.28)
STEEL = (0.36, 0.40, 0.43)
TUBE = (0.52, 0.52, 0.53)
GLASS = (0.10, 0.13, 0.24)
WHITE = (0.95, 0.95, 0.92)
ORIGIN: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Cuboid:
    """A box by its centre, half extents [m] and rotation vector [rad]."""

    rgb: Vec3
    centre: Vec3
    half: Vec3
    turn: Vec3 = ORIGIN


@dataclass(frozen=True)
class Rod:
    """A cylinder, or a capsule if its ends are round, from `start` to `end` [m]."""

    rgb: Vec3
    start: Vec3
    end: Vec3
    radius: float
    shape: Literal["cylinder", "capsule"] = "cylinder"


@dataclass(frozen=True)
class Ball:
    """An ellipsoid by its centre and half axes [m]."""

    rgb: Vec3
    centre: Vec3
    half: Vec3


Shape = Cuboid | Rod | Ball


def octagonal_prism(rgb: Vec3, x: tuple[float, float], y: float, z: tuple[float, float], cut: float) -> list[Shape]:
    """A bar along x, y and -y its sides, with its four edges cut off at 45 degrees, `cut` from each edge."""
    centre = (sum(x) / 2, 0.0, sum(z) / 2)
    length, height = (x[1] - x[0]) / 2, (z[1] - z[0]) / 2
    flat = Cuboid(rgb, centre, (length, y, height - cut))
    tall = Cuboid(rgb, centre, (length, y - cut, height))
    corners = [
        Cuboid(
            rgb,
            (centre[0], side_y * (y - cut), centre[2] + side_z * (height - cut)),
            (length, cut / np.sqrt(2), cut / np.sqrt(2)),
            (np.pi / 4, 0.0, 0.0),
        )
        for side_y in (1, -1)
        for side_z in (1, -1)
    ]
    return [flat, tall, *corners]


TRUNK: list[Shape] = [
    *octagonal_prism(RED, (-0.300, 0.305), 0.159, (-0.105, 0.098), 0.055),
    Cuboid(DARK, (0.0, 0.0, 0.0), (0.4145, 0.07, 0.072)),
    Cuboid(RED, (0.0, 0.0, -0.075), (0.4145, 0.085, 0.030)),
    Cuboid(BLACK, (0.0, 0.0, 0.002), (0.306, 0.1595, 0.003)),
    Cuboid(RED, (-0.205, 0.0, 0.100), (0.085, 0.085, 0.023)),
    Cuboid(RED, (0.265, 0.0, 0.095), (0.040, 0.075, 0.015)),
    Cuboid(BLACK, (0.055, 0.0, 0.097), (0.165, 0.075, 0.006)),
    Rod(BLACK, (0.01, 0.0, 0.10), (0.01, 0.0, 0.118), 0.014),
    Rod(BLACK, (-0.095, 0.0, 0.10), (-0.095, 0.0, 0.135), 0.008),
    Rod(BLACK, (-0.095, 0.0, 0.13), (-0.095, 0.0, 0.284), 0.0035, "capsule"),
    # Lidar inside its cage.
    Rod(DARK, (-0.364, 0.0, 0.070), (-0.364, 0.0, 0.122), 0.050),
    Rod(GLASS, (-0.364, 0.0, 0.122), (-0.364, 0.0, 0.162), 0.051),
    Rod(DARK, (-0.364, 0.0, 0.162), (-0.364, 0.0, 0.178), 0.050),
    Cuboid(COVER, (-0.364, 0.0, 0.196), (0.044, 0.048, 0.007)),
    Cuboid(COVER, (-0.364, 0.0, 0.240), (0.026, 0.036, 0.007)),
]

# Once more at -y.
TRUNK_LEFT: list[Shape] = [
    Cuboid(BLACK, (0.0, 0.152, 0.028), (0.062, 0.010, 0.020)),
    Cuboid(COVER, (0.0, 0.159, 0.025), (0.040, 0.006, 0.010)),
    Cuboid(COVER, (-0.364, 0.040, 0.221), (0.026, 0.005, 0.026), (0.5, 0.0, 0.0)),
    Rod(COVER, (0.318, 0.062, 0.075), (0.365, 0.046, 0.166), 0.008, "capsule"),
    Rod(COVER, (0.398, 0.062, 0.075), (0.400, 0.046, 0.166), 0.008, "capsule"),
    Rod(COVER, (0.365, 0.046, 0.166), (0.400, 0.046, 0.166), 0.008, "capsule"),
    Rod(COVER, (0.318, 0.062, 0.080), (0.398, 0.062, 0.080), 0.007, "capsule"),
    Rod(COVER, (0.400, 0.046, 0.166), (0.400, 0.0, 0.168), 0.009, "capsule"),
    Rod(COVER, (0.365, 0.046, 0.166), (0.365, 0.0, 0.168), 0.009, "capsule"),
    *[Rod(COVER, (-0.364 + x, 0.058, 0.075), (-0.364 + x, 0.045, 0.195), 0.007, "capsule") for x in (-0.038, 0.038)],
]

# Once more at the rear.
FACE: list[Shape] = [
    *octagonal_prism(RED, (0.4145, 0.470), 0.154, (-0.107, 0.073), 0.050),
    *octagonal_prism(RED, (0.470, 0.488), 0.151, (-0.100, 0.072), 0.050),
    *octagonal_prism(RED, (0.488, 0.502), 0.146, (-0.092, 0.070), 0.049),
    *octagonal_prism(RED, (0.502, 0.513), 0.140, (-0.082, 0.067), 0.047),
    *octagonal_prism(RED, (0.513, 0.520), 0.132, (-0.072, 0.062), 0.045),
    Cuboid(DARK, (0.520, 0.0, 0.018), (0.006, 0.020, 0.018)),
    Rod(GLASS, (0.520, 0.0, 0.018), (0.530, 0.0, 0.018), 0.010),
    Cuboid(BLACK, (0.518, 0.0, -0.040), (0.004, 0.046, 0.010)),
    *[Rod(BLACK, (0.500, y, -0.008), (0.5215, y, -0.008), 0.038) for y in (-0.085, 0.085)],
    *[Rod(DARK, (0.500, y, -0.008), (0.5235, y, -0.008), 0.014) for y in (-0.085, 0.085)],
    *[Cuboid(WHITE, (0.478, y, 0.070), (0.012, 0.016, 0.004)) for y in (-0.075, 0.075)],
]

HIP: list[Shape] = [
    Rod(STEEL, (-0.050, 0.0, 0.0), (-0.012, 0.0, 0.0), 0.046),
    Rod(DARK, (-0.012, 0.0, 0.0), (0.014, 0.0, 0.0), 0.053),
    Cuboid(DARK, (0.055, 0.0, 0.0), (0.045, 0.042, 0.040)),
    Rod(DARK, (0.0599, -0.030, 0.0), (0.0599, 0.048, 0.0), 0.050),
    Rod(STEEL, (0.0599, 0.048, 0.0), (0.0599, 0.070, 0.0), 0.047),
    Rod(BLACK, (0.0599, 0.070, 0.0), (0.0599, 0.088, 0.0), 0.054),
]

THIGH: list[Shape] = [
    Rod(COVER, (0.0, 0.004, 0.0), (0.0, 0.066, 0.0), 0.064),
    Cuboid(COVER, (0.0, 0.035, -0.060), (0.058, 0.031, 0.065)),
    Cuboid(COVER, (0.0, 0.035, -0.128), (0.047, 0.031, 0.012)),
    Rod(DARK, (0.0, 0.030, 0.0), (0.0, 0.068, 0.0), 0.030),
    Cuboid(DARK, (0.0, 0.022, -0.190), (0.037, 0.034, 0.085)),
    Rod(DARK, (0.0, -0.014, -0.285), (0.0, 0.062, -0.285), 0.056),
    Rod(STEEL, (0.0, -0.038, -0.285), (0.0, -0.014, -0.285), 0.048),
    Rod(BLACK, (0.0, -0.040, -0.285), (0.0, -0.030, -0.285), 0.022),
    Rod(STEEL, (0.0, 0.062, -0.285), (0.0, 0.080, -0.285), 0.047),
    Rod(BLACK, (0.0, 0.080, -0.285), (0.0, 0.090, -0.285), 0.054),
]

SHANK: list[Shape] = [
    Rod(COVER, (0.0, -0.012, 0.0), (0.0, 0.032, 0.0), 0.060),
    Cuboid(COVER, (0.048, 0.010, 0.002), (0.055, 0.022, 0.044)),
    Rod(COVER, (0.098, -0.012, 0.010), (0.098, 0.032, 0.010), 0.036),
    Cuboid(COVER, (0.098, 0.010, -0.014), (0.032, 0.021, 0.026)),
    Rod(DARK, (0.0, 0.010, 0.0), (0.0, 0.034, 0.0), 0.028),
    Rod(TUBE, (0.090, 0.012, -0.030), (0.088, 0.013, -0.255), 0.0155),
    Rod(DARK, (0.088, 0.013, -0.250), (0.088, 0.013, -0.275), 0.0185),
]

FOOT: list[Shape] = [
    Ball(BLACK, (0.0, 0.0, 0.010), (0.025, 0.025, 0.042)),
    Ball(BLACK, ORIGIN, (0.0298, 0.0298, 0.0298)),
]


def add_base_shapes(base: mujoco.MjsBody) -> None:
    """Trunk with shells, lidar, handle and side cameras, and the two faces."""
    _add(base, TRUNK, 1, 1)
    for sign in (1, -1):
        _add(base, TRUNK_LEFT, 1, sign)
        _add(base, FACE, sign, 1)


def add_leg_shapes(links: list[mujoco.MjsBody], x_sign: float, y_sign: float) -> None:
    """Covers, drives, tube and foot on the hip, thigh, shank and foot bodies of one leg."""
    for body, shapes in zip(links, (HIP, THIGH, SHANK, FOOT), strict=True):
        _add(body, shapes, x_sign, y_sign)


def _add(body: mujoco.MjsBody, shapes: list[Shape], x_sign: float, y_sign: float) -> None:
    """Add shapes reflected in x and y as the signs say."""
    mirror = np.array([x_sign, y_sign, 1.0])
    for shape in shapes:
        look = {"rgba": [*shape.rgb, 1.0], "group": VISUAL_GROUP, "contype": 0, "conaffinity": 0, "mass": 0.0}
        if isinstance(shape, Rod):
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE if shape.shape == "capsule" else mujoco.mjtGeom.mjGEOM_CYLINDER
            ends = np.concatenate([mirror * shape.start, mirror * shape.end])
            body.add_geom(type=kind, fromto=ends, size=[shape.radius, 0, 0], **look)
        elif isinstance(shape, Ball):
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, pos=mirror * shape.centre, size=shape.half, **look)
        else:
            quat = _quaternion(np.prod(mirror) * mirror * shape.turn)
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=mirror * shape.centre, quat=quat, size=shape.half, **look)


def _quaternion(turn: np.ndarray) -> np.ndarray:
    """Unit quaternion (w, x, y, z) of a rotation vector [rad]."""
    angle = np.linalg.norm(turn)
    axis = turn / angle if angle > 0 else turn
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])
