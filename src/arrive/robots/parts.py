"""Building blocks of robots' specs: inertials, hinges and collision shapes."""

from dataclasses import dataclass
from typing import Any

import mujoco

Vec3 = tuple[float, float, float]

VISUAL_GROUP = 2
"""Of geoms that are looked at and collide with nothing."""
COLLISION_GROUP = 3
"""Of geoms that touch the terrain; pictures show them where a robot has no others."""


@dataclass(frozen=True)
class Inertial:
    """Mass [kg], centre of mass in the body frame [m] and inertia about it: xx, yy, zz, xy, xz, yz [kg m^2]."""

    mass: float
    com: Vec3
    inertia: tuple[float, float, float, float, float, float]

    def reflected(self, x_sign: float, y_sign: float) -> "Inertial":
        """The inertial of the mirror image about the y-z plane (x_sign -1), the x-z plane (y_sign -1), or both."""
        xx, yy, zz, xy, xz, yz = self.inertia
        com = (x_sign * self.com[0], y_sign * self.com[1], self.com[2])
        return Inertial(self.mass, com, (xx, yy, zz, x_sign * y_sign * xy, x_sign * xz, y_sign * yz))


def set_inertial(body: mujoco.MjsBody, inertial: Inertial) -> None:
    """Give a body its mass and inertia."""
    body.mass = inertial.mass
    body.ipos = inertial.com
    body.fullinertia = inertial.inertia
    body.explicitinertial = True


def add_hinge(body: mujoco.MjsBody, name: str, axis: Vec3, limits: tuple[float, float]) -> None:
    """A hinge at the body's origin with a range [rad]."""
    body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, range=limits, limited=True)


def collide(body: mujoco.MjsBody, shape: mujoco.mjtGeom, **properties: Any) -> None:
    """Add a geom that collides with the terrain (`contype` 1) and not with the robot (`conaffinity` 0)."""
    properties = {"rgba": [0.3, 0.5, 0.8, 0.5]} | properties
    properties |= {"group": COLLISION_GROUP, "contype": 1, "conaffinity": 0, "condim": 3, "mass": 0.0}
    body.add_geom(type=shape, **properties)


def collide_capsule(body: mujoco.MjsBody, start: Vec3, end: Vec3, radius: float, **properties: Any) -> None:
    """Add a capsule that collides with the terrain [m]."""
    collide(body, mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*start, *end], size=[radius, 0, 0], **properties)


def add_visual(body: mujoco.MjsBody, shape: mujoco.mjtGeom, **properties: Any) -> None:
    """Add a geom that is only looked at."""
    body.add_geom(type=shape, group=VISUAL_GROUP, contype=0, conaffinity=0, mass=0.0, **properties)


def show_collision_shapes(body: mujoco.MjsBody) -> None:
    """Add visible copies of the collision shapes to a body and all its descendants."""
    for geom in [geom for geom in body.geoms if geom.group == COLLISION_GROUP]:
        add_visual(body, geom.type, fromto=geom.fromto, pos=geom.pos, quat=geom.quat, size=geom.size, rgba=geom.rgba)
    for child in body.bodies:
        show_collision_shapes(child)
