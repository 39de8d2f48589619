"""Velocity tracking, the paper's baseline V: follow a forward speed and a heading.

Commands, rewards, episode and curriculum are those of Rudin et al. 2021 ("Learning to walk in minutes") in its
published code, legged_gym, without sideways commands, as in the paper's section Simulation Experiments. The costs of
motion and their weights come from the preset, as for the position tasks.
"""

import math
from dataclasses import dataclass, fields, replace
from typing import ClassVar, Literal

import torch
from torch import Tensor

from arrive.fields import NotNegative, Positive
from arrive.robots.robot import Robot
from arrive.task import rewards
from arrive.task.observations import ObservationConfig, ObservationTerm, around_command
from arrive.task.rewards import STALL_SPEED, Cost, Reward, term
from arrive.task.rotation import yaw_of
from arrive.task.state import State
from arrive.task.task import ConstantCommand, Outcome, Start, TaskConfig, TaskContext, Trial
from arrive.terrain.tile import RASTER_HALF

WALK_TO_RISE = 4.0
"""A robot that ends farther than this from its start goes up a level: half of legged_gym's 8 m tile [m]."""
TILE_END = RASTER_HALF - 1.0
"""A robot farther than this from the origin along an axis gets a time-out, because a tile ends here; legged_gym's tiles
join [m]."""
PROPORTIONS = {
    "track_speed": 1.0,
    "track_yaw_rate": 0.5,
    "air_time": 1.0,
    "vertical_speed_cost": -2.0,
    "roll_pitch_rate_cost": -0.05,
}
"""legged_gym's weights of the tracking terms. `from_preset` scales them by a common factor."""


@dataclass
class VelocityCommand:
    """A forward speed and a heading."""

    speed: Tensor
    """(n,) along the base's x axis, negative backwards [m/s]."""
    heading: Tensor
    """(n,) in the world frame [rad]."""
    time_left_s: Tensor
    """(n,) until the episode ends [s]."""
    age_s: Tensor
    """(n,) time since this command was given [s]."""
    start_w: Tensor
    """(n, 3) start of the episode [m]."""
    farthest_x: Tensor
    """(n,) largest progress along the world's x axis in this episode [m]."""
    outside: Tensor
    """(n,) bool: the robot has left its tile."""


def yaw_rate(state: State, command: VelocityCommand, heading_gain: float, max_yaw_rate: float) -> Tensor:
    """(n,) yaw rate that turns the robot to the commanded heading, within `max_yaw_rate` [rad/s]."""
    error = command.heading - yaw_of(state.base_quat_w)
    wrapped = torch.remainder(error + math.pi, 2.0 * math.pi) - math.pi
    return (heading_gain * wrapped).clamp(-max_yaw_rate, max_yaw_rate)


def track_speed(state: State, command: VelocityCommand, *, width: float) -> Tensor:
    """exp(-|v - v*|^2 / width), v horizontal velocity in the base frame, v* without sideways part, (n,) in 0..1."""
    error = (state.base_lin_vel_b[:, 0] - command.speed).square() + state.base_lin_vel_b[:, 1].square()
    return torch.exp(-error / width)


def track_yaw_rate(
    state: State, command: VelocityCommand, *, width: float, heading_gain: float, max_yaw_rate: float
) -> Tensor:
    """exp(-(w - w*)^2 / width), w the yaw rate, (n,) in 0..1."""
    wanted = yaw_rate(state, command, heading_gain, max_yaw_rate)
    return torch.exp(-(state.base_ang_vel_b[:, 2] - wanted).square() / width)


def air_time(state: State, command: VelocityCommand, *, least_s: float) -> Tensor:
    """Sum of air time minus `least_s` over the feet that have just landed, 0 if commanded to stand, (n,) [s].

    As in legged_gym, it is paid at an event and still multiplied by the time step, like a rate.
    """
    landed = state.landed_air_s
    return ((landed - least_s) * (landed > 0)).sum(-1) * (command.speed.abs() > 0.1)


def vertical_speed_cost(state: State, command: VelocityCommand) -> Tensor:
    """Squared vertical velocity of the base in its frame, (n,) [m^2/s^2]."""
    return state.base_lin_vel_b[:, 2].square()


def roll_pitch_rate_cost(state: State, command: VelocityCommand) -> Tensor:
    """Squared roll and pitch rates of the base, (n,) [rad^2/s^2]."""
    return state.base_ang_vel_b[:, :2].square().sum(-1)


@dataclass(frozen=True)
class Tracking(Reward):
    """The rewards `track_speed` and `track_yaw_rate`."""

    width: Positive = 0.25
    """The reward is exp(-error^2 / width), with the error in m/s or rad/s."""


@dataclass(frozen=True)
class AirTime(Reward):
    """The reward `air_time`."""

    least_s: NotNegative = 0.5
    """Shortest air time that earns something (legged_gym) [s]."""


@dataclass(frozen=True)
class VelocityRewards:
    """Reward terms of velocity tracking."""

    track_speed: Tracking = term(track_speed, Tracking())
    track_yaw_rate: Tracking = term(track_yaw_rate, Tracking())
    air_time: AirTime = term(air_time, AirTime())
    vertical_speed_cost: Cost = term(vertical_speed_cost)
    roll_pitch_rate_cost: Cost = term(roll_pitch_rate_cost)
    joint_acc_cost: Cost = term(rewards.joint_acc_cost)
    torque_cost: Cost = term(rewards.torque_cost)
    collision_cost: Cost = term(rewards.collision_cost)
    action_rate_cost: Cost = term(rewards.action_rate_cost)
    foot_acc_cost: Cost = term(rewards.foot_acc_cost)
    pose_cost: Cost = term(rewards.pose_cost)
    crash_cost: Cost = term(rewards.crash_cost)


@dataclass(frozen=True)
class VelocityConfig(TaskConfig):
    """A forward speed and a heading to follow."""

    name: Literal["velocity"] = "velocity"
    """The task, see `arrive list tasks`."""
    episode_s: Positive = 20.0
    """Length of an episode [s]."""
    command_s: Positive = 10.0
    """Time after which a new command is drawn [s]."""
    max_speed: NotNegative = 1.0
    """Forward speeds are drawn uniformly between minus and plus this [m/s]."""
    least_speed: NotNegative = 0.2
    """Commands slower than this are set to 0 [m/s]."""
    max_yaw_rate: NotNegative = 1.0
    """Yaw rates are clamped to this [rad/s]."""
    heading_gain: NotNegative = 0.5
    """Commanded yaw rate per heading error [1/s]."""
    rewards: VelocityRewards = VelocityRewards()


class VelocityTask:
    """Forward speed and heading to follow until the episode ends."""

    Config: ClassVar[type[TaskConfig]] = VelocityConfig
    ahead = ("speed_command", 0)
    bootstraps = True

    def __init__(self, config: VelocityConfig, context: TaskContext, trial: Trial | ConstantCommand | None = None):
        """Build the task with no commands yet."""
        self._config, self._trial = config, trial
        self._generator = context.generator
        n, device = context.num_envs, context.rasters.heights.device
        self._command = VelocityCommand(
            speed=torch.zeros(n, device=device),
            heading=torch.zeros(n, device=device),
            time_left_s=torch.zeros(n, device=device),
            age_s=torch.zeros(n, device=device),
            start_w=torch.zeros(n, 3, device=device),
            farthest_x=torch.zeros(n, device=device),
            outside=torch.zeros(n, dtype=torch.bool, device=device),
        )

    @staticmethod
    def from_preset(config: TaskConfig) -> TaskConfig:
        """The preset's costs of motion, with tracking rewards in place of position rewards.

        Perfect tracking of speed and heading earns per second the average of the preset's task reward over an episode,
        weight / T. The other tracking terms keep legged_gym's proportions.
        """
        if isinstance(config, VelocityConfig):
            return config
        tracking = PROPORTIONS["track_speed"] + PROPORTIONS["track_yaw_rate"]
        scale = config.rewards.task.weight / config.episode_s / tracking
        own = VelocityRewards()
        tracked = {name: replace(getattr(own, name), weight=scale * weight) for name, weight in PROPORTIONS.items()}
        kept = {row.name: getattr(config.rewards, row.name) for row in fields(own) if row.name not in PROPORTIONS}
        return VelocityConfig(rewards=VelocityRewards(**tracked, **kept))

    @property
    def episode_s(self) -> float:
        return self._config.episode_s if self._trial is None else self._trial.duration_s

    @property
    def command(self) -> VelocityCommand:
        return self._command

    @property
    def destination_w(self) -> Tensor:
        """Start of the episode plus commanded velocity times time left, or plus the trial's distance."""
        command = self._command
        way = command.speed * command.time_left_s
        if isinstance(self._trial, Trial):
            way = torch.full_like(way, self._trial.walk)
        direction = torch.stack([command.heading.cos(), command.heading.sin(), torch.zeros_like(way)], dim=-1)
        return command.start_w + way.unsqueeze(-1) * direction

    @staticmethod
    def observation_terms(
        config: VelocityConfig, sensing: ObservationConfig, robot: Robot
    ) -> tuple[ObservationTerm, ...]:
        command = (
            ObservationTerm("speed_command", ("x",), 2.0, 0.0, ((0, -1.0),),
                            lambda s, c: c.speed.unsqueeze(-1)),
            ObservationTerm("yaw_rate_command", ("z",), 0.25, 0.0, ((0, -1.0),),
                            lambda s, c: yaw_rate(s, c, config.heading_gain, config.max_yaw_rate).unsqueeze(-1)),
        )  # fmt: skip
        return around_command(robot, sensing, command)

    def new_command(self, start: Start, first: bool) -> None:
        command, ids = self._command, start.env_ids
        command.start_w[ids] = start.base_pos_w
        for name in ("farthest_x", "outside"):
            getattr(command, name)[ids] = 0
        command.time_left_s[ids] = self.episode_s
        if first:
            # Spreads the ends of the first episodes.
            command.time_left_s[ids] *= self._uniform(len(ids))
        self._draw(ids)

    def _draw(self, ids: Tensor) -> None:
        """Draw new speeds and headings, or take the trial's."""
        command = self._command
        command.age_s[ids] = 0.0
        if isinstance(self._trial, ConstantCommand):
            command.speed[ids], command.heading[ids] = self._trial.speed[ids], self._trial.heading[ids]
            return
        if self._trial is not None:
            command.speed[ids], command.heading[ids] = self._trial.speed, 0.0
            return
        speed = self._config.max_speed * (2.0 * self._uniform(len(ids)) - 1.0)
        command.speed[ids] = torch.where(speed.abs() > self._config.least_speed, speed, 0.0)
        command.heading[ids] = math.pi * (2.0 * self._uniform(len(ids)) - 1.0)

    def _uniform(self, n: int) -> Tensor:
        return torch.rand(n, generator=self._generator, device=self._command.speed.device)

    def follow(self, state: State) -> None:
        command = self._command
        offset = state.base_pos_w - command.start_w
        command.farthest_x = torch.maximum(command.farthest_x, offset[:, 0])
        command.outside = (state.base_pos_w[:, :2].abs() > TILE_END).any(-1)

    def retarget(self, state: State) -> None:
        """Nothing: commands change with time alone, see `advance`."""

    def advance(self, dt: float) -> Tensor:
        command = self._command
        if isinstance(self._trial, ConstantCommand):
            return torch.zeros_like(command.outside)
        command.time_left_s -= dt
        command.age_s += dt
        if self._trial is None:
            stale = (command.age_s > self._config.command_s - dt / 2).nonzero().squeeze(-1)
            if len(stale):
                self._draw(stale)
        return (command.time_left_s < dt / 2) | command.outside

    def judge(self, state: State, crashed: Tensor, fell: Tensor) -> Outcome:
        """Levels follow the distance walked (legged_gym).

        Success is half of the commanded distance, or more than `WALK_TO_RISE`, without a crash. In a trial, success is
        reaching the required distance along the x axis, even if the robot crashes afterwards.
        """
        walked = (state.base_pos_w - self._command.start_w)[:, :2].norm(dim=-1)
        commanded = self._command.speed.abs() * self._config.episode_s
        failed = crashed | fell
        promote = walked > WALK_TO_RISE
        demote = (walked < 0.5 * commanded) & ~promote
        if not isinstance(self._trial, Trial):
            success, remaining = ~demote & ~failed, (0.5 * commanded - walked).clamp(min=0.0)
        else:
            success = self._command.farthest_x > self._trial.walk
            remaining = (self._trial.walk - self._command.farthest_x).clamp(min=0.0)
        slow = state.base_lin_vel_w.norm(dim=-1) < STALL_SPEED
        return Outcome(
            success=success,
            promote=promote,
            demote=demote,
            failures={
                "crash": ~success & crashed & ~fell,
                "fell": ~success & fell,
                "stalled": ~success & ~failed & slow,
                "late": ~success & ~failed & ~slow,
            },
            remaining=remaining,
        )

    def task_share(self, state: State, failed: Tensor) -> tuple[Tensor, Tensor]:
        share = track_speed(state, self._command, width=self._config.rewards.track_speed.width)
        return share, torch.ones_like(share)

    def state_dict(self) -> dict[str, Tensor]:
        return {name: value.clone() for name, value in vars(self._command).items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        for name, value in vars(self._command).items():
            value.copy_(state[name])
