"""Computes the observation terms in the controller. `arrive.terms` has their meaning.

The exported file lists the terms of its network, with their order and scale.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from arrive.deployment.goals import Order
from arrive.deployment.inputs import Frame
from arrive.deployment.policy_file import PolicyFile
from arrive.errors import ArriveError, unknown_name
from arrive.registry import add
from arrive.terms import TERMS


class Moment(NamedTuple):
    """Values of one step, from which the terms are computed."""

    policy: PolicyFile
    frame: Frame
    to_world: np.ndarray
    """(3, 3) rotation from base to world."""
    order: Order
    action: np.ndarray
    """(joints,) the network's last output, or the action that corresponds to the safe stance."""
    heights_w: np.ndarray
    """(points,) without NaN [m]."""
    default: np.ndarray
    """(joints,) default pose [rad]."""


@dataclass(frozen=True)
class ObservedTerm:
    """How the controller computes one term."""

    size: Callable[[PolicyFile], int]
    compute: Callable[[Moment], np.ndarray | tuple[float, ...]]
    """Returns the values in the term's unit, before scaling."""


def _three(policy: PolicyFile) -> int:
    return 3


def _joints(policy: PolicyFile) -> int:
    return len(policy.robot.joint_names)


def _heights(moment: Moment) -> np.ndarray:
    grid, clipped = moment.policy.grid, _below(moment, moment.heights_w)
    if grid.samples == 1:
        return clipped
    rows, columns = (count // grid.samples for count in grid.shape)
    return clipped.reshape(rows, grid.samples, columns, grid.samples).mean(axis=(1, 3)).ravel()


def _foot_heights(moment: Moment) -> np.ndarray:
    grid, joint_pos = moment.policy.grid, moment.frame.joint_pos[None]
    feet_b = moment.policy.robot.kinematics.positions_b(np.sin(joint_pos), np.cos(joint_pos))[0]
    yaw = math.atan2(moment.to_world[1, 0], moment.to_world[0, 0])
    cos, sin = math.cos(yaw), math.sin(yaw)
    feet = (feet_b @ moment.to_world.T)[:, :2] @ np.array([[cos, -sin], [sin, cos]])
    places = feet[:, None] + np.array(grid.foot_points_m)
    return _below(moment, moment.heights_w[grid.nearest(places.reshape(-1, 2))])


def _below(moment: Moment, heights_w: np.ndarray) -> np.ndarray:
    """How far ground lies below the point that heights are relative to, clipped [m]."""
    grid = moment.policy.grid
    below = moment.frame.base_pos_w[2] - grid.offset_m - heights_w
    return np.minimum(np.maximum(below, grid.clip_m[0]), grid.clip_m[1])


COMPUTED: dict[str, ObservedTerm] = {
    "base_lin_vel": ObservedTerm(_three, lambda m: m.frame.base_lin_vel_b),
    "base_ang_vel": ObservedTerm(_three, lambda m: m.frame.base_ang_vel_b),
    "gravity": ObservedTerm(_three, lambda m: -m.to_world[2]),
    "target": ObservedTerm(_three, lambda m: (m.order.target_w - m.frame.base_pos_w) @ m.to_world),
    "time_left": ObservedTerm(lambda policy: 1, lambda m: (min(m.order.time_left_s, m.policy.task.episode_s),)),
    "joint_pos": ObservedTerm(_joints, lambda m: m.frame.joint_pos - m.default),
    "joint_vel": ObservedTerm(_joints, lambda m: m.frame.joint_vel),
    "action": ObservedTerm(_joints, lambda m: m.action),
    "foot_heights": ObservedTerm(lambda p: len(p.robot.feet) * len(p.grid.foot_points_m), _foot_heights),
    "heights": ObservedTerm(lambda policy: policy.grid.num_heights, _heights),
}
"""The terms of `arrive.terms` that the controller can compute."""


def register_computed(name: str, term: ObservedTerm) -> None:
    """Add the computation of your own observation term. Without it, the controller refuses policies that use the term.

    Raises:
        ArriveError: the name is taken.
    """
    add("observation of the controller", COMPUTED, name, term)


def check_observed_terms(policy: PolicyFile) -> None:
    """Check that the controller knows every term of the network, with the size, unit and frame in the file.

    Raises:
        ArriveError: a term is unknown, or has another size, unit or frame.
    """
    for term in policy.terms:
        if term.name not in COMPUTED:
            raise unknown_name("observation of the controller, needed by the policy:", term.name, COMPUTED)
        known = TERMS[term.name]
        for what, found, expected in (
            ("entries", term.stop - term.start, COMPUTED[term.name].size(policy)),
            ("as its unit", term.unit, known.unit),
            ("as its frame", term.frame.split(",")[0], known.frame),
        ):
            if found != expected:
                raise ArriveError(
                    f"observation {term.name!r} of {policy.path} has {found!r} {what}, the controller has {expected!r}"
                )
