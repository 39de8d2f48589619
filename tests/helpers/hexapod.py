"""A test robot with six legs of four joints, and motors that differ along a leg."""

import math

import mujoco

from arrive.actuation import Motor
from arrive.robots.parts import Inertial, add_hinge, collide, collide_capsule, set_inertial
from arrive.robots.robot import Robot

LEGS = {"LF": (0.2, 1), "LM": (0.0, 1), "LH": (-0.2, 1), "RF": (0.2, -1), "RM": (0.0, -1), "RH": (-0.2, -1)}
"""Where a leg sits along the base [m], and its side."""
JOINTS = {"YAW": 0.0, "LIFT": 0.5, "KNEE": -1.2, "ANKLE": -0.5}
"""Default position of each joint of a left leg, which points outwards when all are 0 [rad]."""
LENGTHS = {"COXA": 0.05, "FEMUR": 0.15, "TIBIA": 0.15, "TARSUS": 0.10}
MASSES = {"COXA": 0.3, "FEMUR": 0.4, "TIBIA": 0.3, "TARSUS": 0.1}
FOOT_KG, BASE_KG, FOOT_RADIUS = 0.05, 6.0, 0.02
PARTNERS = {"F": "H", "M": "M", "H": "F"}


def build_spec(visuals: bool = True) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    base = spec.worldbody.add_body(name="trunk")
    base.add_freejoint(name="trunk")
    set_inertial(base, Inertial(BASE_KG, (0.0, 0.0, 0.0), (0.02, 0.1, 0.11, 0.0, 0.0, 0.0)))
    collide(base, mujoco.mjtGeom.mjGEOM_BOX, size=[0.25, 0.08, 0.04])
    for name, (x, side) in LEGS.items():
        body, at = base, (x, 0.1 * side, 0.0)
        for joint, (part, length) in zip(JOINTS, LENGTHS.items(), strict=True):
            body = body.add_body(name=f"{name}_{part}", pos=at)
            mass = MASSES[part]
            inertia = (mass * length**2 / 6 + 1e-4, 1e-4, mass * length**2 / 6 + 1e-4, 0.0, 0.0, 0.0)
            set_inertial(body, Inertial(mass, (0.0, side * length / 2, 0.0), inertia))
            add_hinge(body, f"{name}_{joint}", (0, 0, 1) if joint == "YAW" else (1, 0, 0), (-2.0, 2.0))
            at = (0.0, side * length, 0.0)
            if part != "COXA":
                collide_capsule(body, (0.0, 0.03 * side, 0.0), (0.0, side * (length - 0.02), 0.0), 0.012)
        foot = body.add_body(name=f"{name}_FOOT", pos=at)
        set_inertial(foot, Inertial(FOOT_KG, (0.0, 0.0, 0.0), (1e-5, 1e-5, 1e-5, 0.0, 0.0, 0.0)))
        foot.add_site(name=f"{name}_TIP", size=[FOOT_RADIUS] * 3)
        collide(foot, mujoco.mjtGeom.mjGEOM_SPHERE, size=[FOOT_RADIUS, 0, 0])
    return spec


def standing_height() -> float:
    pitch, height = 0.0, FOOT_RADIUS
    for joint, length in zip(list(JOINTS)[1:], list(LENGTHS.values())[1:], strict=True):
        pitch += JOINTS[joint]
        height -= length * math.sin(pitch)
    return height


def motor(joint: str) -> Motor:
    effort = {"YAW": 15.0, "LIFT": 30.0, "KNEE": 25.0, "ANKLE": 12.0}[joint]
    return Motor(4.0 * effort, 0.06 * effort, effort, 1.2 * effort, 240.0 / effort, 1e-3 * effort)


JOINT_NAMES = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS)

HEXAPOD = Robot(
    name="hexapod",
    description="a six-legged robot for tests",
    build_spec=build_spec,
    base_body="trunk",
    joint_names=JOINT_NAMES,
    default_joint_pos=tuple(side * position for _, side in LEGS.values() for position in JOINTS.values()),
    standing_height=standing_height(),
    size=0.5,
    mass=BASE_KG + len(LEGS) * (sum(MASSES.values()) + FOOT_KG),
    action_scale=0.3,
    motors=tuple(motor(joint) for _ in LEGS for joint in JOINTS),
    foot_sites=tuple(f"{leg}_TIP" for leg in LEGS),
    foot_bodies=tuple(f"{leg}_FOOT" for leg in LEGS),
    collision_bodies=tuple(f"{leg}_{part}" for leg in LEGS for part in ("FEMUR", "TIBIA", "TARSUS")),
    crash_bodies=("trunk",),
    joint_reverse=tuple(
        (name[0] + PARTNERS[name[1]] + name[2:], -1.0 if name.endswith("YAW") else 1.0) for name in JOINT_NAMES
    ),
)
