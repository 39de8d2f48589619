"""Reward terms. Each is a rate per second: a policy step earns weight * rate * time step.

A term is a function of the state and the task's own command, and a line in `PositionRewards` or `VelocityRewards`. It
names its other inputs as keyword arguments: its own parameters, which stand beside its weight, or fields of the task's
configuration. Rewards and costs are both positive. Costs are named `*_cost` and get negative weights.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor

from arrive.errors import ArriveError
from arrive.fields import NotNegative, NotPositive, Positive, Rule, Share
from arrive.task.rotation import yaw_of
from arrive.task.state import Command, State

STALL_SPEED = 0.1
"""A base slower than this is waiting (paper, eq. 4) [m/s]."""
STALL_DISTANCE = 0.5
"""Waiting farther from the target than this is stalling (paper, eq. 4) [m]."""
PACES = (0.3, 1.5)
"""Slowest and fastest speed that the `pace` reward asks for [m/s]."""
LEAST_ASKED = 0.1
"""Lower bound on the share of its speeds that `approach` asks for near the target."""
LEAST_TIME_S = 0.2
"""Lower bound on the time left in `pace` [s]."""
CRASH_COST = "crash_cost"
"""Name of the term that is paid once, at a crash. A schedule may change its weight."""


@dataclass(frozen=True)
class Reward:
    """A reward without parameters of its own."""

    MAIN: ClassVar[str] = "weight"

    weight: NotNegative = 0.0
    """Weight; 0 leaves the term out."""


@dataclass(frozen=True)
class Cost:
    """A cost without parameters of its own."""

    MAIN: ClassVar[str] = "weight"

    weight: NotPositive = 0.0
    """Weight; 0 leaves the term out."""


@dataclass(frozen=True)
class Approach(Reward):
    """The reward `approach`."""

    speed: Positive = 1.0
    """Speed towards the target at which it saturates [m/s]."""
    max_speed: NotNegative = 0.0
    """Above this speed towards the target the reward falls to 0, by 1 for every `speed` more; 0 for no limit [m/s]."""
    braking: NotNegative = 0.0
    """Within this distance of the target, `speed` and `max_speed` fall in proportion to the distance; 0 for never
    [m]."""
    radius: Positive = 0.5
    """The reward is 1 when the robot is closer to the target than both this and the arrival radius [m]. With the
    arrival radius alone, robots may learn to stop exactly there and miss it by a centimetre."""
    facing: Share = 0.0
    """The reward falls in proportion where the absolute cosine of the angle between the robot's x axis and the
    direction to the target is below this. With 0, the robot may turn as it likes; with 0.7, its front or rear must
    point to the target within 45 degrees."""

    def rules(self) -> tuple[Rule, ...]:
        """Conditions between fields."""
        least = f"0, or at least task.rewards.approach.speed, {self.speed:g}"
        return (Rule("max_speed", least, self.max_speed == 0.0 or self.max_speed >= self.speed),)


@dataclass(frozen=True)
class Stall(Cost):
    """The cost `stall_cost`."""

    speed: Positive = STALL_SPEED
    """A base slower than this is waiting (paper, eq. 4) [m/s]."""


def term(function: Callable[..., Tensor], config: Reward | Cost | None = None) -> Any:
    """A field of a reward table: the function that computes the term, and its parameters if it has any."""
    default = config or (Cost() if function.__name__.endswith("_cost") else Reward())
    meaning = (function.__doc__ or "").strip().splitlines()[0]
    return field(default=default, metadata={"function": function, "meaning": meaning})


def distance_to_target(state: State, command: Command) -> Tensor:
    """(n,) distance between base and target [m]."""
    return (command.target_w - state.base_pos_w).norm(dim=-1)


def in_window(command: Command, window_s: float) -> Tensor:
    """(n,) bool: inside the reward window, t > T - T_r (paper, eq. 1)."""
    return command.time_left_s < window_s


def task(state: State, command: Command, *, reward_window_s: float) -> Tensor:
    """Being at the target during the last T_r seconds: 1/T_r * 1/(1 + |x - x*|^2) (paper, eq. 1).

    Returns:
        (n,) rate [1/s]; its integral over the window is at most 1.
    """
    distance_sq = (command.target_w - state.base_pos_w).square().sum(-1)
    return in_window(command, reward_window_s) / (reward_window_s * (1.0 + distance_sq))


def task_share(state: State, command: Command, *, reward_window_s: float) -> tuple[Tensor, Tensor]:
    """(n,) the task reward over its maximum, 1/(1 + |x - x*|^2), and (n,) bool: inside the reward window."""
    share = 1.0 / (1.0 + distance_to_target(state, command).square())
    return share, in_window(command, reward_window_s)


def exploration(state: State, command: Command) -> Tensor:
    """Cosine between the base's velocity and the direction to the target (paper, eq. 3), (n,) in -1..1."""
    return torch.cosine_similarity(state.base_lin_vel_w, command.target_w - state.base_pos_w, dim=-1)


def stall_cost(state: State, command: Command, *, speed: float) -> Tensor:
    """1 while waiting (slower than `speed`) farther than 0.5 m from the target (paper, eq. 4), (n,)."""
    slow = state.base_lin_vel_w.norm(dim=-1) < speed
    return (slow & (distance_to_target(state, command) > STALL_DISTANCE)).float()


def joint_acc_cost(state: State, command: Command) -> Tensor:
    """Sum of squared joint accelerations (paper, eq. 2), (n,) [rad^2/s^4]."""
    return state.joint_acc.square().sum(-1)


def torque_cost(state: State, command: Command) -> Tensor:
    """Sum of squared joint torques (paper, eq. 2), (n,) [N^2 m^2]."""
    return state.joint_torque.square().sum(-1)


def collision_cost(state: State, command: Command) -> Tensor:
    """Number of thighs and shanks in contact, N_c (paper, eq. 2), (n,)."""
    return state.collision_contacts


def action_rate_cost(state: State, command: Command) -> Tensor:
    """Squared change of the action (paper, eq. 2), (n,) in squared action units."""
    return (state.action - state.previous_action).square().sum(-1)


def foot_acc_cost(state: State, command: Command) -> Tensor:
    """Sum over the feet of their squared acceleration (paper, eq. 2), (n,) [m^2/s^4]."""
    return state.foot_acc_w.square().sum((-2, -1))


def _closing(state: State, command: Command) -> tuple[Tensor, Tensor]:
    """(n,) horizontal speed towards the target [m/s] and (n,) horizontal distance to it [m]."""
    offset = (command.target_w - state.base_pos_w)[:, :2]
    distance = offset.norm(dim=-1)
    return (state.base_lin_vel_w[:, :2] * offset).sum(-1) / distance.clamp(min=1e-6), distance


def _alignment(state: State, command: Command) -> Tensor:
    """(n,) absolute cosine of the horizontal angle between the robot's x axis and the direction to the target."""
    offset = (command.target_w - state.base_pos_w)[:, :2]
    yaw = yaw_of(state.base_quat_w)
    axis = torch.stack([torch.cos(yaw), torch.sin(yaw)], dim=-1)
    return torch.cosine_similarity(offset, axis, dim=-1).abs()


def approach(
    state: State,
    command: Command,
    *,
    speed: float,
    max_speed: float,
    braking: float,
    radius: float,
    facing: float,
    arrival_radius: float,
) -> Tensor:
    """Speed towards the target, up to `speed`; 1 within `radius`. Not in the paper.

    Unlike the cosine of eq. 3 it grows with speed, so that shuffling earns less than walking. If the arrival radius is
    smaller than `radius`, the arrival radius is used. With `max_speed`, robots with time to spare do not run. With
    `braking`, they slow down before they arrive. With `facing`, they meet obstacles head-on.

    Returns:
        (n,) speed as a share of `speed`, -1 to 1.
    """
    closing, distance = _closing(state, command)
    asked = (distance / braking).clamp(min=LEAST_ASKED, max=1.0) if braking else torch.ones_like(distance)
    share = (closing / (speed * asked)).clamp(-1.0, 1.0)
    if max_speed:
        share = torch.minimum(share, (1.0 - (closing - max_speed * asked) / speed).clamp(min=0.0))
    if facing:
        share = share * (_alignment(state, command) / facing).clamp(max=1.0)
    return torch.where(distance < min(radius, arrival_radius), torch.ones_like(share), share)


def pace(state: State, command: Command, *, arrival_radius: float) -> Tensor:
    """Speed towards the target over the speed needed: remaining distance / remaining time. Not in the paper.

    The speed needed is what a joystick's pseudo velocity asks for. The reward grows up to that speed and falls beyond
    it, so that a robot with enough time does not hurry.

    Returns:
        (n,) -1 to 1; 1 within the arrival radius.
    """
    speed, distance = _closing(state, command)
    share = speed / (distance / command.time_left_s.clamp(min=LEAST_TIME_S)).clamp(*PACES)
    share = torch.where(share > 1.0, (2.0 - share).clamp(min=0.0), share.clamp(min=-1.0))
    return torch.where(distance < arrival_radius, torch.ones_like(share), share)


def stand(state: State, command: Command, *, reward_window_s: float, arrival_radius: float) -> Tensor:
    """Standing still at the target during the reward window. Not in the paper.

    Returns:
        (n,) rate [1/s]: 1/T_r * exp(-2 |v|) within the arrival radius, where v is the base velocity. Its integral is
        at most 1.
    """
    here = (distance_to_target(state, command) < arrival_radius) & in_window(command, reward_window_s)
    return here * torch.exp(-2.0 * state.base_lin_vel_w.norm(dim=-1)) / reward_window_s


def pose_cost(state: State, command: Command) -> Tensor:
    """Sum of squared joint positions relative to the default pose, (n,) [rad^2]. Not in the paper.

    Without it, nothing makes a robot that has stopped put its feet back under its hips.
    """
    return state.joint_offset.square().sum(-1)


def crash_cost(failed: Tensor) -> Tensor:
    """1 where the robot has just crashed or fallen, (n,). Paid once: its weight is not multiplied by the time step."""
    return failed.float()


@dataclass(frozen=True)
class PositionRewards:
    """Reward terms of the position tasks."""

    task: Reward = term(task)
    exploration: Reward = term(exploration)
    stall_cost: Stall = term(stall_cost, Stall())
    joint_acc_cost: Cost = term(joint_acc_cost)
    torque_cost: Cost = term(torque_cost)
    collision_cost: Cost = term(collision_cost)
    action_rate_cost: Cost = term(action_rate_cost)
    foot_acc_cost: Cost = term(foot_acc_cost)
    approach: Approach = term(approach, Approach())
    stand: Reward = term(stand)
    pace: Reward = term(pace)
    pose_cost: Cost = term(pose_cost)
    crash_cost: Cost = term(crash_cost)


def functions(rewards: Any) -> dict[str, Callable[..., Tensor]]:
    """The function of every term of a reward table, by name."""
    return {row.name: row.metadata["function"] for row in fields(rewards)}


LEADING_REWARDS = ("exploration", "approach", "pace")
"""Terms that guide robots towards the target."""


class Rewarder:
    """Computes the weighted rewards of a task's terms, as the `Observer` computes the observation."""

    def __init__(self, task: Any, control_dt: float, crash_cost_rises: bool = False):
        """Bind every term with a weight to its parameters.

        Args:
            task: the task's configuration, with its `rewards`.
            control_dt: length of a policy step [s].
            crash_cost_rises: include `crash_cost` even if its weight is 0, because a schedule will raise it.

        Raises:
            ArriveError: no term has a weight.
        """
        weights = {name: getattr(task.rewards, name).weight for name in functions(task.rewards)}
        self.crash_cost = weights.pop(CRASH_COST)
        """Weight of a crash; a schedule may change it."""
        self._pays_crashes = bool(self.crash_cost) or crash_cost_rises
        self.terms = {name: bound(name, task) for name, weight in weights.items() if weight}
        if not self.terms:
            raise ArriveError("task.rewards has no reward with a weight other than zero")
        self._weights, self._dt = weights, control_dt

    @property
    def leads(self) -> bool:
        """Whether a term guides robots towards the target."""
        return any(name in self.terms for name in LEADING_REWARDS)

    def pay(self, state: State, command: Any, failed: Tensor, exploration: Tensor) -> dict[str, Tensor]:
        """Rewards of one policy step by term, (num_envs,) each. Diverged robots get 0.

        Args:
            failed: (num_envs,) bool: the robot has just crashed or fallen.
            exploration: (num_envs,) factor on the exploration reward.
        """
        terms: dict[str, Tensor] = {}
        for name, function in self.terms.items():
            weight = self._weights[name] * (exploration if name == "exploration" else 1.0) * self._dt
            terms[name] = _per_robot(name, function(state, command), state.finite) * weight
        if self._pays_crashes:
            terms[CRASH_COST] = crash_cost(failed) * self.crash_cost
        if not bool(state.finite.all()):
            terms = {name: torch.where(state.finite, value, 0.0) for name, value in terms.items()}
        return terms


def _per_robot(name: str, value: Any, robots: Tensor) -> Tensor:
    """What a term's function returned, if it is one number per robot."""
    if not isinstance(value, Tensor) or value.shape != robots.shape:
        found = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
        raise ArriveError(f"the reward {name!r} must return a tensor of the shape {tuple(robots.shape)}, not {found}")
    return value


def bound(name: str, task: Any) -> Callable[[State, Any], Tensor]:
    """A term's function with its parameters bound, taken from the term's own fields or else from the task's."""
    function, own = functions(task.rewards)[name], getattr(task.rewards, name)
    asked = [p.name for p in inspect.signature(function).parameters.values() if p.kind is p.KEYWORD_ONLY]
    return partial(function, **{p: getattr(own, p) if hasattr(own, p) else getattr(task, p) for p in asked})
