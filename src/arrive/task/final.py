"""Final-position tracking: be at the target when the time is up (paper, section Method)."""

from dataclasses import dataclass, fields, replace
from typing import Annotated, ClassVar, Literal, Self

import torch
from torch import Tensor

from arrive.fields import Interval, NotNegative, Positive, Range, Rule, Share
from arrive.robots.robot import Robot
from arrive.task.heights import look_up
from arrive.task.observations import ObservationConfig, ObservationTerm, observation_terms
from arrive.task.rewards import STALL_SPEED, PositionRewards, distance_to_target, task_share
from arrive.task.state import Command, State
from arrive.task.targets import REACH, next_valid, sample_targets
from arrive.task.task import ConstantCommand, Outcome, Start, TaskConfig, TaskContext, Trial

OBSTACLE_HEIGHT = 0.6
"""Ground this much higher than both robot and target, on the line between them, is an obstacle in the way [m]."""
APPROACH = 0.3
"""If a robot came closer to the target by less than this, it did not set out, and no obstacle stopped it [m]."""
LINE_POINTS = 64
"""Number of points on that line whose height is looked up: at most 0.1 m apart."""


@dataclass(frozen=True)
class PositionConfig(TaskConfig):
    """The fields that all position tasks share."""

    name: str = ""
    episode_s: Positive = 6.0
    """Longest episode T [s]."""
    episode_min_s: Positive = 6.0
    """Shortest episode. Lengths are drawn uniformly between this and `episode_s` [s]."""
    arrival_radius: Positive = 0.5
    """A robot has arrived when it is this close to its target at the end of the episode [m]."""
    target_distance: Annotated[Interval, Range(0.0, REACH)] = (1.0, 5.0)
    """Distance of targets from the start, drawn uniformly [m]."""
    target_height: NotNegative = 0.5
    """Height of targets above the ground [m]."""
    crossing_share: Share = 0.0
    """Share of the targets that are only drawn beyond the terrain to be crossed, where success changes the terrain
    level. Without it, many targets need no crossing: among pillars, a straight walk reaches two thirds of them."""
    nearest_share: Share = 0.0
    """Share of those targets that lie just beyond that terrain, so that robots learn to stop with their hind feet near
    an edge."""
    retarget_s: NotNegative = 0.0
    """Mean time after which a robot in training gets a new target and a new time for it within the same episode; 0 for
    never [s]."""
    stop_share: Share = 0.0
    """Share of those new targets that are at the robot's own position, which tells it to stop."""
    rewards: PositionRewards = PositionRewards()

    @property
    def reward_window_s(self) -> float:
        """Duration of the task reward at the end of an episode: all of it [s]."""
        return self.episode_s

    def rules(self) -> tuple[Rule, ...]:
        """Conditions between fields."""
        shortest, longest = self.episode_min_s, self.episode_s
        farthest = self.target_distance[1]
        return (
            Rule("episode_min_s", f"at most task.episode_s, {longest:g}", shortest <= longest),
            Rule("target_distance", "two numbers, the second above 0", farthest > 0.0),
            Rule("stop_share", "0 where task.retarget_s is 0", self.retarget_s > 0.0 or self.stop_share == 0.0),
        )

    def measured(self) -> Self:
        return replace(self, episode_min_s=self.episode_s, retarget_s=0.0, stop_share=0.0)


@dataclass(frozen=True)
class FinalConfig(PositionConfig):
    """Position targets with a deadline."""

    name: Literal["final"] = "final"
    """The task, see `arrive list tasks`."""
    reward_window_s: Positive = 1.0
    """Duration T_r of the task reward at the end of an episode (paper, eq. 1) [s]."""

    def rules(self) -> tuple[Rule, ...]:
        shortest = self.episode_min_s
        window = Rule("reward_window_s", f"at most task.episode_min_s, {shortest:g}", self.reward_window_s <= shortest)
        return (*super().rules(), window)


def arrival_radius(task: TaskConfig) -> float:
    """Distance to the target at which a robot has arrived [m]; the default value for tasks without targets."""
    return task.arrival_radius if isinstance(task, PositionConfig) else PositionConfig.arrival_radius


class FinalPositionTask:
    """Position targets with a deadline."""

    Config: ClassVar[type[TaskConfig]] = FinalConfig
    ahead = ("target", 0)
    bootstraps = False

    def __init__(self, config: PositionConfig, context: TaskContext, trial: Trial | ConstantCommand | None = None):
        """Build the task with no commands yet."""
        self._config = config
        self._dt = context.control_dt
        self._rasters = context.rasters
        self._generator = context.generator
        self._trial = trial
        device, num_envs = context.rasters.heights.device, context.num_envs
        self._command = Command(
            target_w=torch.zeros(num_envs, 3, device=device),
            time_left_s=torch.zeros(num_envs, device=device),
            start_distance=torch.ones(num_envs, device=device),
            crossing=torch.zeros(num_envs, dtype=torch.bool, device=device),
        )
        self._tile_ids = torch.zeros(num_envs, dtype=torch.long, device=device)
        self._waited_s = torch.zeros(num_envs, device=device)

    @classmethod
    def from_preset(cls, config: TaskConfig) -> TaskConfig:
        """Take the fields and rewards that the preset shares with this task, and defaults for the rest."""
        if isinstance(config, cls.Config):
            return config
        own = cls.Config()
        if not isinstance(config, PositionConfig):
            return own
        names = {row.name for row in fields(own)} & {row.name for row in fields(config)} - {"name", "rewards"}
        rewards = {row.name: getattr(config.rewards, row.name) for row in fields(config.rewards)}
        kept = {name: getattr(config, name) for name in names}
        return replace(own, **kept, rewards=replace(own.rewards, **rewards))

    @property
    def episode_s(self) -> float:
        if self._trial is None:
            return self._config.episode_s
        return self._trial.duration_s + (self._trial.wait_s if isinstance(self._trial, Trial) else 0.0)

    @property
    def command(self) -> Command:
        return self._command

    @property
    def destination_w(self) -> Tensor:
        return self._command.target_w

    @staticmethod
    def observation_terms(
        config: PositionConfig, sensing: ObservationConfig, robot: Robot
    ) -> tuple[ObservationTerm, ...]:
        return observation_terms(robot, sensing, config.episode_s)

    def new_command(self, start: Start, first: bool) -> None:
        config, ids = self._config, start.env_ids
        command = self._command
        self._tile_ids[ids] = start.tile_ids
        targets = self._targets(start)
        crossing = look_up(self._rasters.crossing, start.tile_ids, targets[:, None, :2]).squeeze(1)
        command.target_w[ids] = targets
        command.start_distance[ids] = (targets - start.base_pos_w).norm(dim=-1)
        draw = torch.rand(len(ids), generator=self._generator, device=targets.device)
        if isinstance(self._trial, ConstantCommand):
            command.time_left_s[ids] = self._trial.time_left_s[ids]
            command.crossing[ids] = False
        elif self._trial is not None:
            command.time_left_s[ids] = self._trial.duration_s
            self._waited_s[ids] = 0.0
            command.crossing[ids] = crossing
        elif first:
            # Spreads the ends of the first episodes. Their outcome does not count, because they are shortened.
            command.time_left_s[ids] = config.episode_s * draw
            command.crossing[ids] = False
        else:
            length = config.episode_min_s + (config.episode_s - config.episode_min_s) * draw
            # Whole policy steps, so that the reward window has the same number of steps in every episode.
            command.time_left_s[ids] = (length / self._dt).round() * self._dt
            command.crossing[ids] = crossing

    def _targets(self, start: Start) -> Tensor:
        if self._trial is None:
            return sample_targets(self._rasters, start.tile_ids, start.base_pos_w, self._config, self._generator)
        if isinstance(self._trial, ConstantCommand):
            point = start.base_pos_w[:, :2] + self._trial.offset_w[start.env_ids]
        else:
            target = self._trial.target
            point = target if isinstance(target, Tensor) else torch.tensor(target).expand(len(self._tile_ids), 2)
            point = next_valid(self._rasters, start.tile_ids, point.to(start.base_pos_w.device)[start.env_ids])
        ground = look_up(self._rasters.heights, start.tile_ids, point.unsqueeze(1))
        return torch.cat([point, ground + self._config.target_height], dim=-1)

    def follow(self, state: State) -> None:
        """With a constant command, keep the target ahead of the robot. Otherwise there is nothing to remember."""
        if isinstance(self._trial, ConstantCommand):
            everyone = torch.arange(len(self._tile_ids), device=self._tile_ids.device)
            self._command.target_w = self._targets(Start(everyone, state.base_pos_w, self._tile_ids))

    def retarget(self, state: State) -> None:
        """At random moments a new target replaces the present one.

        If it lies beyond terrain that the robot has already crossed, it does not count for the curriculum.
        """
        if self._trial is not None or self._config.retarget_s <= 0.0:
            return
        draw = torch.rand(len(self._tile_ids), generator=self._generator, device=self._tile_ids.device)
        ids = (draw < self._dt / self._config.retarget_s).nonzero().squeeze(-1)
        if len(ids):
            here, tiles = state.base_pos_w[ids], self._tile_ids[ids]
            self.new_command(Start(ids, here, tiles), first=False)
            self._command.crossing[ids] &= ~look_up(self._rasters.crossing, tiles, here[:, None, :2]).squeeze(1)
            if self._config.stop_share > 0.0:
                self._stop(ids, here)

    def _stop(self, ids: Tensor, here: Tensor) -> None:
        """Tell a share of these robots to stop: their target becomes their own position."""
        draw = torch.rand(len(ids), generator=self._generator, device=ids.device)
        chosen = draw < self._config.stop_share
        ids, here = ids[chosen], here[chosen]
        ground = look_up(self._rasters.heights, self._tile_ids[ids], here[:, None, :2])
        self._command.target_w[ids] = torch.cat([here[:, :2], ground + self._config.target_height], dim=-1)
        self._command.start_distance[ids] = (self._command.target_w[ids] - here).norm(dim=-1)
        self._command.crossing[ids] = False

    def advance(self, dt: float) -> Tensor:
        if isinstance(self._trial, ConstantCommand):
            return torch.zeros_like(self._command.crossing)
        left_s = self._command.time_left_s
        left_s -= dt
        over = left_s < dt / 2
        if isinstance(self._trial, Trial) and self._trial.wait_s > 0.0:
            self._waited_s = torch.where(over | (self._waited_s > 0.0), self._waited_s + dt, 0.0)
            left_s[self._waited_s > 0.0] = self._trial.hold_s
            return self._waited_s > self._trial.wait_s + dt / 2
        return over

    def judge(self, state: State, crashed: Tensor, fell: Tensor) -> Outcome:
        """Success is being within the arrival radius without a crash.

        Levels change only for targets beyond the terrain (`Command.crossing`).
        """
        distance = distance_to_target(state, self._command)
        failed = crashed | fell
        success = (distance < self._config.arrival_radius) & ~failed
        slow = state.base_lin_vel_w.norm(dim=-1) < STALL_SPEED
        missed = ~success & ~failed
        apart = self._apart(state, missed)
        return Outcome(
            success=success,
            promote=success & self._command.crossing,
            demote=~success & self._command.crossing,
            failures={
                "crash": crashed & ~fell,
                "fell": fell,
                "wrong_side": missed & apart,
                "stalled": missed & ~apart & slow,
                "late": missed & ~apart & ~slow,
            },
            remaining=distance,
        )

    def _apart(self, state: State, missed: Tensor) -> Tensor:
        """(n,) bool: the episode ends now, and the robot set out but the terrain still separates it from its target.

        Either the target lies beyond the terrain and the robot does not, on terrain where this separates them (a gap, a
        wall, stairs), or a high obstacle stands on the straight line between them.
        """
        apart = torch.zeros_like(missed)
        came = self._command.start_distance - distance_to_target(state, self._command) > APPROACH
        ids = (missed & came & (self._command.time_left_s <= 0.01)).nonzero().squeeze(-1)
        if not len(ids):
            return apart
        tiles, here, there = self._tile_ids[ids], state.base_pos_w[ids, :2], self._command.target_w[ids, :2]
        before = self._command.crossing[ids] & self._rasters.separates[tiles]
        before &= ~look_up(self._rasters.crossing, tiles, here[:, None]).squeeze(1)
        along = torch.linspace(0.0, 1.0, LINE_POINTS, device=here.device)[:, None]
        heights = look_up(self._rasters.heights, tiles, torch.lerp(here[:, None], there[:, None], along))
        blocked = heights.amax(-1) > torch.maximum(heights[:, 0], heights[:, -1]) + OBSTACLE_HEIGHT
        apart[ids] = before | blocked
        return apart

    def task_share(self, state: State, failed: Tensor) -> tuple[Tensor, Tensor]:
        share, paid = task_share(state, self._command, reward_window_s=self._config.reward_window_s)
        left_s = self._command.time_left_s.clamp(max=self._config.reward_window_s)
        return share * ~failed, torch.where(failed, left_s / self._dt, paid.float())

    def state_dict(self) -> dict[str, Tensor]:
        return {name: value.clone() for name, value in self._memory().items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        for name, value in self._memory().items():
            value.copy_(state[name])

    def _memory(self) -> dict[str, Tensor]:
        command = dict(vars(self._command))
        # The key that checkpoints have for it.
        return command | {"counts": command.pop("crossing"), "tile_ids": self._tile_ids}
