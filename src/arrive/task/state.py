"""The typed state that observations, rewards and terminations use."""

from dataclasses import dataclass

from torch import Tensor


@dataclass
class State:
    """The robots at one policy step, float32, one row per environment.

    Frames: `_w` is the environment's own world frame (its tile's origin), `_b` the base frame.
    """

    base_pos_w: Tensor
    """(n, 3) [m]."""
    base_quat_w: Tensor
    """(n, 4), (w, x, y, z), rotates from base to world."""
    base_lin_vel_w: Tensor
    """(n, 3) [m/s]."""
    base_lin_vel_b: Tensor
    """(n, 3) [m/s]."""
    base_ang_vel_b: Tensor
    """(n, 3) [rad/s]."""
    gravity_b: Tensor
    """(n, 3) unit vector of gravity."""
    joint_pos: Tensor
    """(n, joints) [rad]."""
    joint_offset: Tensor
    """(n, joints) joint_pos minus the default pose [rad]."""
    joint_vel: Tensor
    """(n, joints) [rad/s]."""
    joint_acc: Tensor
    """(n, joints) change of joint_vel over the policy step [rad/s^2]."""
    joint_torque: Tensor
    """(n, joints) at the last physics step [N m]."""
    foot_pos_b: Tensor
    """(n, feet, 3) [m]."""
    foot_vel_w: Tensor
    """(n, feet, 3) [m/s]."""
    foot_acc_w: Tensor
    """(n, feet, 3) change of foot velocity over the policy step [m/s^2]."""
    landed_air_s: Tensor
    """(n, feet) air time of feet that have just landed, 0 for the others [s]."""
    action: Tensor
    """(n, joints) the action just applied, in units of the action scale."""
    previous_action: Tensor
    """(n, joints) the action before it."""
    crash_contacts: Tensor
    """(n,) number of contacts of bodies that must not touch anything."""
    collision_contacts: Tensor
    """(n,) number of thighs and shanks in contact, the paper's N_c."""
    foot_contacts: Tensor
    """(n, feet) number of contacts of each foot."""
    heights_w: Tensor
    """(n, points) ground height under each point of `HeightGrid` [m]."""
    fall_height: Tensor
    """(n,) a base below this height has fallen into a hole [m]."""
    finite: Tensor
    """(n,) bool: the simulation did not diverge. If it did, all other entries of that robot are zero."""


@dataclass
class Command:
    """A target, and the time left to reach it."""

    target_w: Tensor
    """(n, 3) target position of the base [m]."""
    time_left_s: Tensor
    """(n,) until the episode ends [s]."""
    start_distance: Tensor
    """(n,) distance to the target when it was given [m]."""
    crossing: Tensor
    """(n,) bool: the target lies beyond the terrain, so that reaching or missing it changes the terrain level."""
