"""Unitree Go2: a 12-joint quadruped of 15 kg, built from primitive shapes.

Figures are those of Unitree's public description `go2_description` (unitree_ros, BSD-3-Clause) as MuJoCo Menagerie's
`unitree_go2` has them. The rotors' masses are not in it; the head and the feet are lumped with their links.

The model is exactly mirror symmetric. Dropped from the base: Ixy = 1.2e-4 and Iyz = -3.1e-5 kg m^2. The hind legs are
the front ones shifted, not mirrored, so that the robot has no front-back symmetry. The description's joints have no
friction and no damping, so neither has this model. Boxes and cylinders of legs are capsules of the same extent here.
"""

import math
from dataclasses import dataclass

import mujoco

from arrive.actuation import Motor
from arrive.robots.parts import (
    Inertial,
    Vec3,
    add_hinge,
    add_visual,
    collide,
    collide_capsule,
    set_inertial,
    show_collision_shapes,
)
from arrive.robots.robot import Robot

DRIVES = ("hip", "thigh", "calf")


@dataclass(frozen=True)
class Leg:
    """Where a leg sits, and which signs turn the front left hip's figures into its own."""

    name: str
    x_sign: float
    y_sign: float

    @property
    def front(self) -> bool:
        return self.x_sign > 0


LEGS = (Leg("FL", 1, 1), Leg("FR", 1, -1), Leg("RL", -1, 1), Leg("RR", -1, -1))

BASE = Inertial(6.921, (0.021112, 0.0, -0.005366), (0.02448, 0.098077, 0.107, 0.0, 0.0014849, 0.0))
HIP = Inertial(0.678, (-0.0054, 0.00194, -0.000105), (0.00048, 0.000884, 0.000596, -3.01e-06, 1.11e-06, -1.42e-06))
THIGH = Inertial(1.152, (-0.00374, -0.0223, -0.0327), (0.00584, 0.0058, 0.00103, 8.72e-05, -0.000289, 0.000808))
CALF = Inertial(
    0.241352, (0.00629595, -0.000622121, -0.141417), (0.00146354, 0.00148999, 5.327e-05, 2.2e-07, 5.97e-06, 1.225e-05)
)
"""With the foot."""

HIP_IN_BASE: Vec3 = (0.1934, 0.0465, 0.0)
THIGH_IN_HIP: Vec3 = (0.0, 0.0955, 0.0)
CALF_IN_THIGH: Vec3 = (0.0, 0.0, -0.213)
FOOT_IN_CALF: Vec3 = (-0.002, 0.0, -0.213)
FOOT_RADIUS = 0.022
"""Joint origins and the centre of the foot's contact sphere in the parent's frame, front left leg [m]."""

HIP_RANGE = (-1.0472, 1.0472)
THIGH_RANGE_FRONT = (-1.5708, 3.4907)
THIGH_RANGE_REAR = (-0.5236, 4.5379)
CALF_RANGE = (-2.7227, -0.83776)

GEAR_RATIO = 6.33
"""Of the drives (Unitree's GO-M8010-6)."""
KNEE_LINKAGE = 45.43 / 23.7
"""The knee's drive turns the calf through a linkage: more torque, less speed, and its square of the inertia."""
ROTOR_INERTIA = 0.000111842
"""Of a rotor about its axis, from the rotor links of the description's URDF [kg m^2]. With the gear it adds 4.5 g m^2
to hip and thigh and 16.5 g m^2 to the calf; the Menagerie has 10 g m^2 for all."""


def drive(ratio: float) -> Motor:
    """The drive behind so much more gear: 23.7 N m and 30.1 rad/s at the hip (the URDF's limits).

    The torque falls linearly from the effort limit at rest to zero at the highest speed, as Isaac Lab has it for this
    robot. Gains are those of Extreme Parkour (Cheng et al. 2023) for A1, a robot of this size: with Isaac Lab's 25
    N m/rad the standing robot sinks by 14 % of its height and its weight comes to lie 48 mm behind its feet's middle;
    with 40 it sinks by 6 %.
    """
    return Motor(
        stiffness=40.0,
        damping=1.0,
        effort_limit=23.7 * ratio,
        stall_torque=23.7 * ratio,
        no_load_speed=30.1 / ratio,
        rotor_inertia=ROTOR_INERTIA * (GEAR_RATIO * ratio) ** 2,
    )


DEFAULT_THIGH, DEFAULT_CALF = 0.85, -1.5
"""Default pose: the calf as in unitree_rl_gym, the thigh between its 0.8 (front) and 1.0 (rear) [rad].

All knees point backwards, so that legs which yield under the weight carry it backwards: with feet under the hips
(0.75) it comes to lie 44 mm behind them, and the hind legs sink onto their calves. This thigh sets the feet 33 mm
behind the hips, and the robot comes to stand level with its weight within 10 mm of their middle.
"""


SHELL, LIMB = {"rgba": (0.80, 0.80, 0.82, 1.0)}, {"rgba": (0.25, 0.25, 0.28, 1.0)}


def build_spec(visuals: bool = True) -> mujoco.MjSpec:
    """The robot alone, its base frame at the origin; `visuals` adds the shapes that only pictures need."""
    spec = mujoco.MjSpec()
    spec.modelname = "go2"
    spec.compiler.degree = False
    base = spec.worldbody.add_body(name="base")
    base.add_freejoint(name="base")
    set_inertial(base, BASE)
    collide(base, mujoco.mjtGeom.mjGEOM_BOX, size=[0.1881, 0.04675, 0.057], **SHELL)
    collide_capsule(base, (0.285, 0.0, 0.01), (0.293, 0.0, -0.06), 0.047, **SHELL)  # the head
    for leg in LEGS:
        _add_leg(base, leg)
    if visuals:
        show_collision_shapes(base)
        _show_shells(base)
    return spec


def _add_leg(base: mujoco.MjsBody, leg: Leg) -> None:
    """Hip, thigh, calf and foot of one leg with their joints, collision shapes and foot site."""

    def place(point: Vec3) -> Vec3:
        return point[0], leg.y_sign * point[1], point[2]

    hip = base.add_body(name=f"{leg.name}_hip", pos=(leg.x_sign * HIP_IN_BASE[0], leg.y_sign * HIP_IN_BASE[1], 0.0))
    set_inertial(hip, HIP.reflected(leg.x_sign, leg.y_sign))
    thigh = hip.add_body(name=f"{leg.name}_thigh", pos=place(THIGH_IN_HIP))
    set_inertial(thigh, THIGH.reflected(1, leg.y_sign))
    calf = thigh.add_body(name=f"{leg.name}_calf", pos=CALF_IN_THIGH)
    set_inertial(calf, CALF.reflected(1, leg.y_sign))
    add_hinge(hip, f"{leg.name}_hip_joint", (1, 0, 0), HIP_RANGE)
    add_hinge(thigh, f"{leg.name}_thigh_joint", (0, 1, 0), THIGH_RANGE_FRONT if leg.front else THIGH_RANGE_REAR)
    add_hinge(calf, f"{leg.name}_calf_joint", (0, 1, 0), CALF_RANGE)
    # The foot's mass is the calf's; a body of its own tells its contacts apart.
    foot = calf.add_body(name=f"{leg.name}_foot", pos=FOOT_IN_CALF)
    set_inertial(foot, Inertial(1e-6, (0.0, 0.0, 0.0), (1e-9, 1e-9, 1e-9, 0.0, 0.0, 0.0)))
    foot.add_site(name=f"{leg.name}_foot", size=[FOOT_RADIUS] * 3, group=4)
    collide(foot, mujoco.mjtGeom.mjGEOM_SPHERE, size=[FOOT_RADIUS, 0, 0], **LIMB)
    collide_capsule(thigh, (0.0, 0.0, 0.0), (0.0, 0.0, -0.19), 0.0225, **LIMB)
    collide_capsule(calf, (0.003, 0.0, -0.02), (0.016, 0.0, -0.11), 0.0125, **LIMB)
    collide_capsule(calf, (0.018, 0.0, -0.12), (0.003, 0.0, -0.195), 0.011, **LIMB)


def _show_shells(base: mujoco.MjsBody) -> None:
    """The rounded flanks of the trunk, and the hip and thigh drives, which touch nothing here."""
    capsule, cylinder = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER
    for side in (1, -1):
        add_visual(base, capsule, fromto=(-0.16, 0.05 * side, 0.0, 0.2, 0.05 * side, 0.0), size=[0.05, 0, 0], **SHELL)
    for hip, leg in zip(base.bodies, LEGS, strict=True):
        out = 0.1 * leg.y_sign
        add_visual(hip, cylinder, fromto=(-0.03, 0.0, 0.0, 0.03, 0.0, 0.0), size=[0.045, 0, 0], **LIMB)
        add_visual(hip, cylinder, fromto=(0.0, 0.6 * out, 0.0, 0.0, out, 0.0), size=[0.046, 0, 0], **LIMB)


def standing_height() -> float:
    """Height of the base when the feet touch flat ground at the default pose [m], by forward kinematics."""
    pitch = DEFAULT_THIGH + DEFAULT_CALF
    foot_z = FOOT_IN_CALF[2] * math.cos(pitch) - FOOT_IN_CALF[0] * math.sin(pitch)
    return FOOT_RADIUS - CALF_IN_THIGH[2] * math.cos(DEFAULT_THIGH) - foot_z


JOINT_NAMES = tuple(f"{leg.name}_{part}_joint" for leg in LEGS for part in DRIVES)
FEET = tuple(f"{leg.name}_foot" for leg in LEGS)

GO2 = Robot(
    name="go2",
    description="Unitree Go2: 15 kg quadruped with 12 drives, three kinds of joints",
    build_spec=build_spec,
    base_body="base",
    joint_names=JOINT_NAMES,
    default_joint_pos=(0.0, DEFAULT_THIGH, DEFAULT_CALF) * len(LEGS),
    standing_height=standing_height(),
    size=0.7,
    mass=15.206412,
    action_scale=0.25,
    motors=(drive(1.0), drive(1.0), drive(KNEE_LINKAGE)) * len(LEGS),
    foot_sites=FEET,
    foot_bodies=FEET,
    collision_bodies=tuple(f"{leg.name}_{part}" for leg in LEGS for part in ("thigh", "calf")),
    crash_bodies=("base",),
)
"""A leg of 0.426 m against ANYmal C's 0.61 m gives the size."""
