"""Velocity tracking, the paper's baseline V: follow a forward speed and a heading.

Commands, rewards, episode and curriculum are those of Rudin et al. 2021 ("Learning to walk in minutes") in its
published code, legged_gym, without sideways commands, as in the paper's section Simulation Experiments. The costs of
motion and their weights are the preset's, the same as for the tasks that send robots to places.
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from arrive.config import Config, TaskConfig
from arrive.robots.robot import Robot
from arrive.task.observations import ObservationTerm, around_command
from arrive.task.rewards import AIR_TIME_S, CRASH_COST, MOTION_COSTS, STALL_SPEED, RewardFunction
from arrive.task.rotation import yaw_of
from arrive.task.state import State
from arrive.task.task import Cruise, Outcome, Start, Trial
from arrive.terrain.rasters import Rasters
from arrive.terrain.tile import RASTER_HALF

EPISODE_S = 20.0
"""Length of an episode [s]."""
COMMAND_S = 10.0
"""A command holds this long [s]."""
MAX_SPEED = 1.0
"""Forward speeds are uniform between minus and plus this [m/s]."""
LEAST_SPEED = 0.2
"""Slower commands become standing still [m/s]."""
MAX_YAW_RATE = 1.0
"""Yaw rates are cut at this [rad/s]."""
HEADING_GAIN = 0.5
"""Yaw rate asked for per heading error [1/s]."""
TRACKING_WIDTH = 0.25
"""The tracking rewards are exp(-error^2 / this); error in m/s and rad/s."""
WALK_TO_RISE = 4.0
"""Who ends farther than this from the start goes up a level: half of legged_gym's tile of 8 m [m]."""
TILE_END = RASTER_HALF - 1.0
"""Beyond this along an axis the episode is over as if time had run out: legged_gym's tiles join, these end [m]."""
PROPORTIONS = {
    "track_speed": 1.0,
    "track_yaw_rate": 0.5,
    "air_time": 1.0,
    "vertical_speed_cost": -2.0,
    "roll_pitch_rate_cost": -0.05,
}
"""legged_gym's weights of the terms that belong to tracking; `configure` scales them together."""


@dataclass
class VelocityCommand:
    """How fast to walk and which way to face."""

    speed: Tensor
    """(n,) along the base's x axis, negative backwards [m/s]."""
    heading: Tensor
    """(n,) in the world frame [rad]."""
    time_left_s: Tensor
    """(n,) until the episode ends [s]."""
    age_s: Tensor
    """(n,) since this command was given [s]."""
    start_w: Tensor
    """(n, 3) where the episode began [m]."""
    farthest_x: Tensor
    """(n,) largest progress along the world's x axis in this episode [m]."""
    outside: Tensor
    """(n,) bool: the robot has left its tile."""


def yaw_rate(state: State, command: VelocityCommand) -> Tensor:
    """(n,) yaw rate that turns the robot to the commanded heading, within `MAX_YAW_RATE` [rad/s]."""
    error = command.heading - yaw_of(state.base_quat_w)
    wrapped = torch.remainder(error + math.pi, 2.0 * math.pi) - math.pi
    return (HEADING_GAIN * wrapped).clamp(-MAX_YAW_RATE, MAX_YAW_RATE)


def track_speed(state: State, command: VelocityCommand, config: TaskConfig) -> Tensor:
    """exp(-|v - v*|^2 / 0.25) of the horizontal velocity in the base frame; v* has no sideways part, (n,) in 0..1."""
    error = (state.base_lin_vel_b[:, 0] - command.speed).square() + state.base_lin_vel_b[:, 1].square()
    return torch.exp(-error / TRACKING_WIDTH)


def track_yaw_rate(state: State, command: VelocityCommand, config: TaskConfig) -> Tensor:
    """exp(-(w - w*)^2 / 0.25) of the yaw rate, (n,) in 0..1."""
    return torch.exp(-(state.base_ang_vel_b[:, 2] - yaw_rate(state, command)).square() / TRACKING_WIDTH)


def air_time(state: State, command: VelocityCommand, config: TaskConfig) -> Tensor:
    """Sum over the feet that have just landed of their time in the air minus 0.5 s, none where told to stand, (n,) [s].

    As in legged_gym it is an event, yet multiplied by the time step like a rate.
    """
    landed = state.foot_landed_s
    return ((landed - AIR_TIME_S) * (landed > 0)).sum(-1) * (command.speed.abs() > 0.1)


def vertical_speed_cost(state: State, command: VelocityCommand, config: TaskConfig) -> Tensor:
    """Squared vertical velocity of the base in its frame, (n,) [m^2/s^2]."""
    return state.base_lin_vel_b[:, 2].square()


def roll_pitch_rate_cost(state: State, command: VelocityCommand, config: TaskConfig) -> Tensor:
    """Squared roll and pitch rates of the base, (n,) [rad^2/s^2]."""
    return state.base_ang_vel_b[:, :2].square().sum(-1)


class VelocityTask:
    """Forward speed and heading to follow, for as long as the episode lasts."""

    sides = (("speed_command", 0), ("yaw_rate_command", 0))
    rewards: dict[str, RewardFunction] = {
        "track_speed": track_speed,
        "track_yaw_rate": track_yaw_rate,
        "air_time": air_time,
        "vertical_speed_cost": vertical_speed_cost,
        "roll_pitch_rate_cost": roll_pitch_rate_cost,
    } | MOTION_COSTS

    def __init__(
        self, config: Config, rasters: Rasters, generator: torch.Generator, trial: Trial | Cruise | None = None
    ):
        """Build the task with no commands yet."""
        self._config, self._trial = config.task, trial
        self._generator = generator
        n, device = config.num_envs, rasters.heights.device
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
    def configure(config: Config) -> Config:
        """The preset with 20 s episodes, bootstrapped time-outs, its costs of motion, and tracking instead of targets.

        Perfect tracking of speed and heading earns per second what the preset's task reward earns on average over an
        episode, weight / T; the other tracking terms keep legged_gym's proportion to it.
        """
        task = config.task
        tracking = PROPORTIONS["track_speed"] + PROPORTIONS["track_yaw_rate"]
        scale = task.rewards.get("task", 0.0) / task.episode_s / tracking
        kept = {name: weight for name, weight in task.rewards.items() if name in MOTION_COSTS or name == CRASH_COST}
        rewards = {name: scale * weight for name, weight in PROPORTIONS.items()} | kept
        changed = replace(task, rewards=rewards, episode_s=EPISODE_S, episode_min_s=EPISODE_S, bootstrap_timeouts=True)
        return replace(config, task=changed)

    @property
    def episode_s(self) -> float:
        return self._config.episode_s if self._trial is None else self._trial.duration_s

    @property
    def command(self) -> VelocityCommand:
        return self._command

    @property
    def destination_w(self) -> Tensor:
        """Where walking as told for the rest of the episode, or of the trial, leads."""
        command = self._command
        way = command.speed * command.time_left_s
        if isinstance(self._trial, Trial):
            way = torch.full_like(way, self._trial.walk)
        direction = torch.stack([command.heading.cos(), command.heading.sin(), torch.zeros_like(way)], dim=-1)
        return command.start_w + way.unsqueeze(-1) * direction

    @staticmethod
    def observation_terms(config: Config, robot: Robot) -> tuple[ObservationTerm, ...]:
        command = (
            ObservationTerm("speed_command", "m/s", "base", ("x",), 2.0, 0.0, ((0, 1.0),), ((0, -1.0),),
                            lambda s, c: c.speed.unsqueeze(-1)),
            ObservationTerm("yaw_rate_command", "rad/s", "base", ("z",), 0.25, 0.0, ((0, -1.0),), ((0, -1.0),),
                            lambda s, c: yaw_rate(s, c).unsqueeze(-1)),
        )  # fmt: skip
        return around_command(robot, config.observation, command)

    def new_command(self, start: Start, first: bool) -> None:
        command, ids = self._command, start.env_ids
        command.start_w[ids] = start.base_pos_w
        for name in ("farthest_x", "outside"):
            getattr(command, name)[ids] = 0
        command.time_left_s[ids] = self.episode_s
        if first:
            # Robots that all began together would end together.
            command.time_left_s[ids] *= self._uniform(len(ids))
        self._draw(ids)

    def _draw(self, ids: Tensor) -> None:
        """New speeds and headings, or the trial's."""
        command = self._command
        command.age_s[ids] = 0.0
        if isinstance(self._trial, Cruise):
            command.speed[ids], command.heading[ids] = self._trial.speed[ids], self._trial.heading[ids]
            return
        if self._trial is not None:
            command.speed[ids], command.heading[ids] = self._trial.speed, 0.0
            return
        speed = MAX_SPEED * (2.0 * self._uniform(len(ids)) - 1.0)
        command.speed[ids] = torch.where(speed.abs() > LEAST_SPEED, speed, 0.0)
        command.heading[ids] = math.pi * (2.0 * self._uniform(len(ids)) - 1.0)

    def _uniform(self, n: int) -> Tensor:
        return torch.rand(n, generator=self._generator, device=self._command.speed.device)

    def follow(self, state: State) -> None:
        command = self._command
        offset = state.base_pos_w - command.start_w
        command.farthest_x = torch.maximum(command.farthest_x, offset[:, 0])
        command.outside = (state.base_pos_w[:, :2].abs() > TILE_END).any(-1)

    def advance(self, dt: float) -> Tensor:
        command = self._command
        if isinstance(self._trial, Cruise):
            return torch.zeros_like(command.outside)
        command.time_left_s -= dt
        command.age_s += dt
        if self._trial is None:
            stale = (command.age_s > COMMAND_S - dt / 2).nonzero().squeeze(-1)
            if len(stale):
                self._draw(stale)
        return (command.time_left_s < dt / 2) | command.outside

    def judge(self, state: State, crashed: Tensor, fell: Tensor) -> Outcome:
        """Levels follow the distance walked (legged_gym); success is half of the commanded distance without a crash.

        In a trial success is having got as far along the x axis as asked, even if the robot crashed afterwards.
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
        share = track_speed(state, self._command, self._config)
        return share, torch.ones_like(share)

    def state_dict(self) -> dict[str, Tensor]:
        return {name: value.clone() for name, value in vars(self._command).items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        for name, value in vars(self._command).items():
            value.copy_(state[name])
