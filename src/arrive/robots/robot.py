"""What the rest of the software needs to know about a robot."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco

from arrive.actuation import Motor


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
    action_scale: float
    """Radians of joint target per unit of action."""
    motor: Motor
    foot_sites: tuple[str, ...]
    foot_bodies: tuple[str, ...]
    collision_bodies: tuple[str, ...]
    """Bodies whose contacts count as the collisions N_c of the paper's eq. 2."""
    crash_bodies: tuple[str, ...]
    """Bodies whose contact ends the episode."""
    joint_mirror: tuple[tuple[str, float], ...]
    """For each joint, its partner under left-right reflection and the sign of the position there."""
    joint_reverse: tuple[tuple[str, float], ...] | None = None
    """The same under front-back reflection; None for a robot whose hind legs are no mirror image of the front ones."""
