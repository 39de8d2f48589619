"""Computes the observation terms in the controller. `arrive.terms` has their meaning.

The exported file lists the terms of its network, with their order and scale.
"""

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
    grid = moment.policy.grid
    below = moment.frame.base_pos_w[2] - grid.offset_m - moment.heights_w
    clipped = np.minimum(np.maximum(below, grid.clip_m[0]), grid.clip_m[1])
    if grid.samples == 1:
        return clipped
    rows, columns = (count // grid.samples for count in grid.shape)
    return clipped.reshape(rows, grid.samples, columns, grid.samples).mean(axis=(1, 3)).ravel()


COMPUTED: dict[str, ObservedTerm] = {
    "base_lin_vel": ObservedTerm(_three, lambda m: m.frame.base_lin_vel_b),
    "base_ang_vel": ObservedTerm(_three, lambda m: m.frame.base_ang_vel_b),
    "gravity": ObservedTerm(_three, lambda m: -m.to_world[2]),
    "target": ObservedTerm(_three, lambda m: (m.order.target_w - m.frame.base_pos_w) @ m.to_world),
    "time_left": ObservedTerm(lambda policy: 1, lambda m: (min(m.order.time_left_s, m.policy.task.episode_s),)),
    "joint_pos": ObservedTerm(_joints, lambda m: m.frame.joint_pos - m.default),
    "joint_vel": ObservedTerm(_joints, lambda m: m.frame.joint_vel),
    "action": ObservedTerm(_joints, lambda m: m.action),
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
