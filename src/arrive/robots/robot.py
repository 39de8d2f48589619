"""The description of a robot that the rest of the software needs."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from arrive.actuation import Motor
from arrive.errors import ArriveError, unknown_name

ANYMAL_C_KG = 52.13485
"""For which payloads and torques are given."""


@dataclass(frozen=True)
class Robot:
    """A legged robot as data; a new robot is one module that builds one of these.

    Names are those of the bodies, joints and sites of the spec that `build_spec` returns. The spec holds the robot
    alone: a free-floating base body at the origin, its joints, its collision geoms (group 3, which collide with the
    terrain alone; physics lets those of different legs collide), its visual geoms (group 2, which collide with
    nothing) and one site per foot at the centre of its contact sphere. Motors, sensors and terrain are added by the
    scene.
    """

    name: str
    description: str
    build_spec: Callable[[bool], mujoco.MjSpec]
    """Builds the spec; its argument says whether to add the visual geoms, which pictures need and physics does not."""
    base_body: str
    joint_names: tuple[str, ...]
    """Actuated joints in the order of actions and joint observations."""
    default_joint_pos: tuple[float, ...]
    """Joint positions that a zero action asks for [rad]."""
    standing_height: float
    """Height of the base above flat ground at the default pose, feet on the ground [m]."""
    size: float
    """Its lengths over those of ANYmal C, for which terrain, tasks and observations give theirs."""
    mass: float
    """Of all its bodies [kg]."""
    action_scale: float
    """Radians of joint target per unit of action."""
    motors: tuple[Motor, ...]
    """One for each joint, in the order of `joint_names`."""
    foot_sites: tuple[str, ...]
    foot_bodies: tuple[str, ...]
    collision_bodies: tuple[str, ...]
    """Bodies whose contacts count as the collisions N_c of the paper's eq. 2."""
    crash_bodies: tuple[str, ...]
    """Bodies whose contact ends the episode."""
    joint_reverse: tuple[tuple[str, float], ...] | None = None
    """For each joint, its partner under front-back reflection and the sign of the position there; None for a robot
    whose hind legs are no mirror image of the front ones."""

    def __post_init__(self) -> None:
        """Refuse what does not fit together.

        Raises:
            ArriveError: a list of another length than the joints or feet, no foot, a body with two roles, a reflection
                that does not undo itself, or a figure that is not finite or has the wrong sign.
        """
        problem = self._problem()
        if problem:
            raise ArriveError(f"robot {self.name!r}: {problem}")

    @property
    def mass_share(self) -> float:
        """Its mass over that of ANYmal C."""
        return self.mass / ANYMAL_C_KG

    def motor_of(self, joint: str | None) -> Motor:
        """The motor of a joint, of the first one for None.

        Raises:
            ArriveError: there is no such joint.
        """
        if joint is not None and joint not in self.joint_names:
            raise unknown_name(f"joint of {self.name}", joint, self.joint_names)
        return self.motors[0 if joint is None else self.joint_names.index(joint)]

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The robot alone, compiled once for all who read from it. Do not change it."""
        return self.build_spec(False).compile()

    def foot_corners(self) -> np.ndarray:
        """(feet, 2) places of the feet under the robot in its default pose, forward and left of the base [m]."""
        data = mujoco.MjData(self.model)
        for name, position in zip(self.joint_names, self.default_joint_pos, strict=True):
            data.qpos[self.model.joint(name).qposadr[0]] = position
        mujoco.mj_kinematics(self.model, data)
        base = data.body(self.base_body).xpos
        return np.array([data.site(site).xpos - base for site in self.foot_sites])[:, :2]

    def _problem(self) -> str:
        """What does not fit together, or an empty string."""
        joints, feet = self.joint_names, self.foot_sites
        for name, size in (("default_joint_pos", len(joints)), ("motors", len(joints)), ("foot_bodies", len(feet))):
            if len(getattr(self, name)) != size:
                return f"{name} has {len(getattr(self, name))} entries where {size} are needed"
        if len(set(joints)) != len(joints):
            return "joint_names has a name twice"
        if not feet:
            return "foot_sites names no foot"
        for name in ("standing_height", "size", "mass", "action_scale"):
            if not _is_above_0(getattr(self, name)):
                return f"{name} must be a finite number above 0, not {getattr(self, name)!r}"
        for joint, motor in zip(joints, self.motors, strict=True):
            if not isinstance(motor, Motor):
                return f"motors must be of the class Motor, not {motor!r}"
            if problem := motor.problem():
                return f"the motor of {joint}: {problem}"
        roles = {name: getattr(self, name) for name in ("crash_bodies", "collision_bodies", "foot_bodies")}
        seen: dict[str, str] = {}
        for role, bodies in roles.items():
            for body in bodies:
                if body in seen:
                    return f"body {body!r} is in {seen[body]} and in {role}; its contacts count for one of them"
                seen[body] = role
        pairs = self.joint_reverse
        if pairs is None:
            return ""
        if len(pairs) != len(joints) or {partner for partner, _ in pairs} != set(joints):
            return "joint_reverse does not name every joint once"
        place = dict(zip(joints, pairs, strict=True))
        for joint, (partner, sign) in place.items():
            if place[partner] != (joint, sign):
                return (
                    f"joint_reverse does not undo itself: {joint} goes to {partner}, which goes to {place[partner][0]}"
                )
        return ""


def _is_above_0(value: object) -> bool:
    return isinstance(value, int | float) and 0.0 < value < math.inf
