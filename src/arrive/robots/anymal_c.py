"""ANYmal C by ANYbotics: a 12-joint quadruped of 52 kg, built from primitive shapes.

All figures come from the manufacturer's public description `anymal_c_simple_description` (URDF, BSD-3-Clause; in the
PyPI package example-robot-data 6.0.0), with the links that fixed joints join lumped together. Frames are parallel to
the base frame (x forward, y left, z up) at zero joint positions.

The model is exactly mirror symmetric, the published figures nearly so. Dropped from the base: a centre of mass 0.18 mm
to the right, Ixy = 8.2e-3 and Iyz = -1.2e-3 kg m^2. The legs' figures are the mean over the four legs reflected to
the left front one; they differ from it by at most 0.051 mm and 1.1e-4 kg m^2, because the drives are one part turned
and not mirrored. The hatch's published inertia (0.001 in all nine entries) is no rigid body's: of it only the
diagonal is kept. The depth cameras' slightly breaks the triangle inequality too, which their sum with the rest hides.
The description gives joints no friction and no damping, so neither does this model.
"""

import math
from dataclasses import dataclass

import mujoco

from arrive.actuation import Motor
from arrive.robots.anymal_c_visuals import add_base_shapes, add_leg_shapes
from arrive.robots.parts import Inertial, Vec3, add_hinge, collide, collide_capsule, set_inertial
from arrive.robots.robot import Robot


@dataclass(frozen=True)
class Leg:
    """Where a leg sits and which signs turn the left front leg's figures into its own."""

    name: str
    x_sign: float
    y_sign: float

    def place(self, point: Vec3) -> Vec3:
        """The point of this leg that corresponds to a point of the left front one [m]."""
        return (self.x_sign * point[0], self.y_sign * point[1], point[2])


LEGS = (Leg("LF", 1, 1), Leg("LH", -1, 1), Leg("RF", 1, -1), Leg("RH", -1, -1))
DRIVES = ("HAA", "HFE", "KFE")

BASE = Inertial(
    26.37317, (-0.017793943, 0.0, 0.008504339), (0.216711743, 1.785161689, 1.833699450, 0.0, 0.057933189, 0.0)
)
HIP = Inertial(
    2.781,
    (0.056711974, 0.017393887, -0.000460841),
    (0.003295526, 0.004939210, 0.005833864, 0.000000248, 0.000001046, 0.000135809),
)
THIGH = Inertial(
    3.071,
    (0.0, 0.030814718, -0.245695734),
    (0.029904049, 0.029563794, 0.004861085, 0.000000052, 0.000010157, 0.004142426),
)
SHANK = Inertial(
    0.33842,
    (0.034527672, 0.006859670, 0.000977104),
    (0.000328528, 0.001111938, 0.000896128, 0.000021188, 0.000013360, 0.000000069),
)
FOOT = Inertial(
    0.25,
    (0.009480000, -0.009480000, 0.124300000),
    (0.003171741, 0.003171741, 0.000083192, 0.000002630, 0.000068156, 0.000068156),
)
"""The lower tube with its foot, as the description has it; about the centre of the contact sphere, 22.5 mm above the
description's FOOT frame."""

# Joint origins and the centre of the foot's contact sphere in the parent's frame, left front leg [m].
HAA_IN_BASE: Vec3 = (0.2999, 0.104, 0.0)
HFE_IN_HIP: Vec3 = (0.0599, 0.08381, 0.0)
KFE_IN_THIGH: Vec3 = (0.0, 0.1003, -0.285)
FOOT_IN_SHANK: Vec3 = (0.08795, 0.01305, -0.31547)
FOOT_RADIUS = 0.03

HAA_RANGE = (-0.72, 0.49)
"""Of the left legs, positive outwards; the right legs' is its mirror image [rad]."""
PITCH_RANGE = (-9.42477796077, 9.42477796077)
"""Of HFE and KFE: one and a half turns either way [rad]."""

ROTOR_INERTIA = 0.1
"""Inertia that a drive's rotor adds to its joint [kg m^2].

The ANYdrive's rotor is not published. Its harmonic drive has 1:50 (Hutter et al. 2016), so 120 N m of stall torque are
2.4 N m at the rotor. A motor of that size is the Mini Cheetah's (3 N m, 63e-6 kg m^2 in its published model), which
would add 63e-6 * 50^2 = 0.16 kg m^2. The drive's spring hides part of that from fast impacts, hence the lower figure;
0.05 to 0.16 is plausible.
"""

ANYDRIVE = Motor(
    stiffness=80.0,
    damping=2.0,
    effort_limit=80.0,
    stall_torque=120.0,
    no_load_speed=7.5,
    rotor_inertia=ROTOR_INERTIA,
)
"""Of every joint."""

DEFAULT_HFE = 0.4
DEFAULT_KFE = -0.8
"""Default pose of the front legs; the hind legs mirror it (legged_gym, anymal_c) [rad]."""


def build_spec(visuals: bool = True) -> mujoco.MjSpec:
    """The robot alone, its base frame at the origin; `visuals` adds the shapes that only pictures need."""
    spec = mujoco.MjSpec()
    spec.modelname = "anymal_c"
    spec.compiler.degree = False
    base = spec.worldbody.add_body(name="base")
    base.add_freejoint(name="base")
    set_inertial(base, BASE)
    _add_base_collision(base)
    if visuals:
        add_base_shapes(base)
    for leg in LEGS:
        links = _add_leg(base, leg)
        if visuals:
            add_leg_shapes(links, leg.x_sign, leg.y_sign)
    return spec


def _add_leg(base: mujoco.MjsBody, leg: Leg) -> list[mujoco.MjsBody]:
    """Hip, thigh, shank and foot of one leg with their joints, collision shapes and foot site."""
    hip = _add_link(base, leg, "HIP", HAA_IN_BASE, HIP)
    thigh = _add_link(hip, leg, "THIGH", HFE_IN_HIP, THIGH)
    shank = _add_link(thigh, leg, "SHANK", KFE_IN_THIGH, SHANK)
    low, high = HAA_RANGE if leg.y_sign > 0 else (-HAA_RANGE[1], -HAA_RANGE[0])
    add_hinge(hip, f"{leg.name}_HAA", (1, 0, 0), (low, high))
    add_hinge(thigh, f"{leg.name}_HFE", (0, 1, 0), PITCH_RANGE)
    add_hinge(shank, f"{leg.name}_KFE", (0, 1, 0), PITCH_RANGE)
    foot = _add_link(shank, leg, "FOOT", FOOT_IN_SHANK, FOOT)
    foot.add_site(name=f"{leg.name}_FOOT", size=[FOOT_RADIUS] * 3, group=4)
    collide(foot, mujoco.mjtGeom.mjGEOM_SPHERE, size=[FOOT_RADIUS, 0, 0])
    collide_capsule(thigh, leg.place((0.0, 0.03, 0.0)), leg.place((0.0, 0.03, -0.285)), 0.0375)
    # The knee: the KFE drive (radius 0.05) and the shank's hub beside it (0.06), -0.04 to 0.14 m along the axis.
    collide_capsule(thigh, leg.place((0.0, 0.015, -0.285)), leg.place((0.0, 0.085, -0.285)), 0.055)
    collide_capsule(shank, leg.place((0.08795, 0.01305, -0.0175)), leg.place(FOOT_IN_SHANK), 0.0175)
    return [hip, thigh, shank, foot]


def _add_base_collision(base: mujoco.MjsBody) -> None:
    """A box and a capsule on either side: the description's boxes and cylinders of trunk and faces, end to end."""
    collide(base, mujoco.mjtGeom.mjGEOM_BOX, size=[0.5245, 0.07, 0.09])
    for y in (0.07, -0.07):
        collide_capsule(base, (-0.4345, y, 0.0), (0.4345, y, 0.0), 0.09)


def _add_link(parent: mujoco.MjsBody, leg: Leg, part: str, origin: Vec3, inertial: Inertial) -> mujoco.MjsBody:
    body = parent.add_body(name=f"{leg.name}_{part}", pos=leg.place(origin))
    set_inertial(body, inertial.reflected(leg.x_sign, leg.y_sign))
    return body


def default_joint_pos() -> tuple[float, ...]:
    """Joint positions of the default pose, leg by leg [rad]."""
    return tuple(q for leg in LEGS for q in (0.0, leg.x_sign * DEFAULT_HFE, leg.x_sign * DEFAULT_KFE))


def standing_height() -> float:
    """Height of the base when the feet touch flat ground at the default pose [m], by forward kinematics."""
    shank_pitch = DEFAULT_HFE + DEFAULT_KFE
    knee_z = KFE_IN_THIGH[2] * math.cos(DEFAULT_HFE)
    foot_z = FOOT_IN_SHANK[2] * math.cos(shank_pitch) - FOOT_IN_SHANK[0] * math.sin(shank_pitch)
    return FOOT_RADIUS - knee_z - foot_z


def joint_reverse(joint_names: tuple[str, ...]) -> tuple[tuple[str, float], ...]:
    """Partner and sign of each joint under reflection about the y-z plane.

    F and H swap. A rotation about the plane's normal (HAA, about x) does not change sign; one about an axis in it (HFE
    and KFE, about y) does. The legs are exact images; the base's centre of mass, 18 mm behind the middle, is not.
    """
    other_end = {"F": "H", "H": "F"}
    return tuple(
        (name[0] + other_end[name[1]] + name[2:], 1.0 if name.endswith("HAA") else -1.0) for name in joint_names
    )


JOINT_NAMES = tuple(f"{leg.name}_{drive}" for leg in LEGS for drive in DRIVES)
FEET = tuple(f"{leg.name}_FOOT" for leg in LEGS)

ANYMAL_C = Robot(
    name="anymal_c",
    description="ANYbotics ANYmal C: 52 kg quadruped with 12 series-elastic drives",
    build_spec=build_spec,
    base_body="base",
    joint_names=JOINT_NAMES,
    default_joint_pos=default_joint_pos(),
    standing_height=standing_height(),
    size=1.0,
    mass=52.13485,
    action_scale=0.5,
    motors=(ANYDRIVE,) * len(JOINT_NAMES),
    foot_sites=FEET,
    foot_bodies=FEET,
    collision_bodies=tuple(f"{leg.name}_{part}" for leg in LEGS for part in ("THIGH", "SHANK")),
    crash_bodies=("base",),
    joint_reverse=joint_reverse(JOINT_NAMES),
)
