"""The vectorised environment: one step is a short list of named phases."""

from dataclasses import dataclass, field

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from arrive.config import Config
from arrive.errors import ArriveError, unknown_name
from arrive.physics.engine import Physics, Readings
from arrive.physics.pool import WorldPool
from arrive.robots.robot import Robot
from arrive.task.curriculum import ExplorationSwitch, LevelCurriculum, deal_families
from arrive.task.feet import follow_feet
from arrive.task.heights import HeightGrid, grid_heights
from arrive.task.observations import Observer
from arrive.task.rewards import CRASH_COST, EXPLORATION_REWARDS
from arrive.task.rotation import quat_of_yaw, rotate_inverse, yaw_of
from arrive.task.state import State
from arrive.task.task import Outcome, Start, Task

SPAWN_CLEARANCE = 0.06
"""Robots of ANYmal C's size start this much above standing height: the random start pose may stretch their legs [m]."""
POLICY = "policy"
"""Name of the observation group that actor and critic read."""


@dataclass
class Finished:
    """Episodes that ended in one step; each tensor has one entry per ended episode."""

    env_ids: Tensor
    success: Tensor
    counted: Tensor
    """False for the shortened episodes with which a run begins, those that review an easier level, and diverged
    simulations."""
    levels: Tensor
    """Level they were played on."""
    distance: Tensor
    """How much of the way was left at the end [m]."""
    failures: dict[str, Tensor]
    observation: Tensor | None = None
    """(ended, size) the last observation of each, where `ArriveEnv.final_observations` asks for it."""


@dataclass
class StepLog:
    """What one step has to report."""

    rewards: dict[str, Tensor] = field(default_factory=dict)
    """Weighted reward of each term, (num_envs,)."""
    diverged: int = 0
    """Simulations that left the finite numbers and were reset."""
    success: Tensor | None = None
    """(num_envs,) bool: the episode would be a success if it ended now."""
    finished: Finished | None = None


class ArriveEnv(VecEnv):
    """Robots that must reach places by given times, each on a tile of its own."""

    def __init__(
        self,
        config: Config,
        robot: Robot,
        pool: WorldPool,
        physics: Physics,
        task: Task,
        generator: torch.Generator,
        assignment: tuple[Tensor, Tensor] | None = None,
    ):
        """Start every robot's first episode.

        Args:
            assignment: (num_envs,) family and (num_envs,) level of each robot, to stay there. Without it robots are
                dealt to the families in equal parts, levels follow success, and the first episodes are shortened to
                spread their ends.
        """
        self.config, self.cfg = config, config
        self.robot, self.pool, self.physics, self.task = robot, pool, physics, task
        self.num_envs, self.num_actions = physics.num_envs, len(robot.joint_names)
        self.device = physics.device
        self.control_dt = config.physics.control_dt
        self.max_episode_length = round(task.episode_s / self.control_dt)
        self.episode_length_buf = torch.zeros(self.num_envs, dtype=torch.long, device=self.device)
        self._generator = generator
        self._assignment, self._learning = assignment, assignment is None
        self.review = config.terrain.review
        """Share of the episodes on an easier level than the robot's own; a schedule may change it."""
        self.crash_cost = config.task.rewards.get(CRASH_COST, 0.0)
        """Weight of a crash; a schedule may change it."""
        self.final_observations = False
        """Whether to take down the last observation of every episode, which costs a second look at all robots."""
        self._terms = _weighted_terms(task, config.task.rewards)
        self._grid = HeightGrid(config.observation).points.to(self.device)
        sensing = config.observation
        self.observer = Observer(task.observation_terms(config, robot), sensing.noise, self.device, sensing.noise_least)
        self._default_joint_pos = torch.tensor(robot.default_joint_pos, device=self.device)
        self._down = torch.tensor([0.0, 0.0, -1.0], device=self.device).expand(self.num_envs, 3)
        dealt = deal_families(self.num_envs, config.terrain).to(self.device)
        self.family_of_env = dealt if assignment is None else assignment[0]
        self.log = StepLog()
        self._allocate()
        self._start_curriculum()
        self.restart()

    def restart(self, seed: int | None = None) -> None:
        """Start every robot's first episode again.

        Args:
            seed: the generator starts from it, and levels and exploration reward as in a new environment; None goes
                on from where they are.
        """
        if seed is not None:
            self._generator.manual_seed(seed)
            self._start_curriculum()
        self._reset(torch.arange(self.num_envs, device=self.device), first=self._learning)
        self._read()

    def _start_curriculum(self) -> None:
        num_levels = torch.tensor(self.pool.num_levels, device=self.device)[self.family_of_env]
        self.curriculum = LevelCurriculum(num_levels, self.config.terrain.start_level, self._generator)
        if self._assignment is not None:
            self.curriculum.levels = self._assignment[1]
        self.exploration = ExplorationSwitch(self.config.task, self.family_of_env)

    def settle(self, levels: dict[str, Tensor]) -> None:
        """Start every robot's first episode again, at levels that were reached before.

        Args:
            levels: of robots, by terrain family: 0 for the easiest to 1 for the hardest, in any number. The robots of a
                family that is not among them stay on their level.
        """
        for index, family in enumerate(self.pool.families):
            if family.name in levels:
                ids = (self.family_of_env == index).nonzero().squeeze(-1)
                reached = levels[family.name].to(self.device)
                drawn = reached[(self._uniform(len(ids)) * len(reached)).long()]
                self.curriculum.levels[ids] = (drawn * (self.pool.num_levels[index] - 1)).round().long()
        self.restart()

    def _allocate(self) -> None:
        n, joints, feet = self.num_envs, self.num_actions, len(self.robot.foot_sites)
        zeros = lambda *shape: torch.zeros(*shape, device=self.device)  # noqa: E731
        self._buffers = {
            "action": zeros(n, joints),
            "previous_action": zeros(n, joints),
            "joint_vel": zeros(n, joints),
            "foot_vel": zeros(n, feet, 3),
            "foot_air_s": zeros(n, feet),
            "foot_touched": torch.zeros(n, feet, dtype=torch.bool, device=self.device),
            "fresh": torch.ones(n, dtype=torch.bool, device=self.device),
            "moved": torch.zeros(n, dtype=torch.bool, device=self.device),
            "shortened": torch.zeros(n, dtype=torch.bool, device=self.device),
            "retired": torch.zeros(n, dtype=torch.bool, device=self.device),
            "tile": torch.zeros(n, dtype=torch.long, device=self.device),
            "level": torch.zeros(n, dtype=torch.long, device=self.device),
        }

    @property
    def tile_of_env(self) -> Tensor:
        """(num_envs,) index into the pool's tiles of the tile each robot stands on."""
        return self._buffers["tile"]

    @property
    def retired(self) -> Tensor:
        """(num_envs,) bool: robots that were taken out of the simulation."""
        return self._buffers["retired"]

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict]:
        """Advance every robot by one policy step; robots whose episode ended start the next one.

        Args:
            actions: (num_envs, joints) joint targets relative to the default pose, in units of the action scale.

        Returns:
            observations after the step (of the next episode where one ended), rewards (num_envs,), dones (num_envs,)
            and rsl_rl's extras.
        """
        self._act(actions)
        self._simulate()
        state = self._read()
        self._remember(state)
        outcome, time_out = self._terminate(state)
        rewards = self._reward(state)
        self._record(outcome)
        self._restart()
        self._push()
        self._look_again()
        return self.get_observations(), rewards, self._ended.long(), self._extras(time_out)

    def get_observations(self) -> TensorDict:
        """The current observations, with fresh noise."""
        return TensorDict({POLICY: self._observe()}, batch_size=[self.num_envs], device=self.device)

    def _observe(self) -> Tensor:
        return self.observer.observe(self.state, self.task.command, self._generator)

    def joint_targets(self, actions: Tensor) -> Tensor:
        """What actions mean: (num_envs, joints) [rad]."""
        return self._default_joint_pos + self.robot.action_scale * actions

    def retire(self, env_ids: Tensor) -> None:
        """Take robots out of the simulation for good: an evaluation has seen what it wanted of them."""
        self._buffers["retired"][env_ids] = True
        self.physics.retire(env_ids)

    # The phases of a step, in order.

    def _act(self, actions: Tensor) -> None:
        self._buffers["previous_action"].copy_(self._buffers["action"])
        self._buffers["action"].copy_(actions)

    def _simulate(self) -> None:
        self.physics.step(self.joint_targets(self._buffers["action"]))
        self.episode_length_buf += 1

    def _read(self) -> State:
        """Take the robots' state from physics."""
        readings = self.physics.read()
        self._finite = readings.finite
        if not bool(readings.finite.all()):
            readings = _silence(readings)
        self.state = self._state(readings, self._buffers)
        self._buffers["moved"].zero_()
        return self.state

    def _remember(self, state: State) -> None:
        """Keep what the next step is compared with."""
        buffers = self._buffers
        buffers["joint_vel"].copy_(state.joint_vel)
        buffers["foot_vel"].copy_(state.foot_vel_w)
        touches = state.foot_contacts > 0
        in_air_s, _ = follow_feet(buffers["foot_air_s"], buffers["foot_touched"], touches, self.control_dt)
        buffers["foot_air_s"].copy_(in_air_s)
        buffers["foot_touched"].copy_(touches)
        buffers["fresh"].zero_()

    def _look_again(self) -> None:
        """Read the robots that were reset or pushed since the others were read."""
        ids = self._buffers["moved"].nonzero().squeeze(-1)
        if not len(ids):
            return
        buffers = {name: value[ids] for name, value in self._buffers.items()}
        for name, value in vars(self._state(self.physics.read(ids), buffers)).items():
            getattr(self.state, name)[ids] = value
        self._buffers["moved"].zero_()

    def _state(self, readings: Readings, buffers: dict[str, Tensor]) -> State:
        """The state of robots from their readings and their rows of the buffers."""
        quat, moving = readings.base_quat_w, (~buffers["fresh"]).float()
        rasters, tiles = self.pool.rasters, buffers["tile"]
        touches = readings.foot_contacts > 0
        _, landed_s = follow_feet(buffers["foot_air_s"], buffers["foot_touched"], touches, self.control_dt)
        heights_w = grid_heights(rasters.heights, tiles, self._grid, readings.base_pos_w, yaw_of(quat))
        return State(
            base_pos_w=readings.base_pos_w,
            base_quat_w=quat,
            base_lin_vel_w=readings.base_lin_vel_w,
            base_lin_vel_b=rotate_inverse(quat, readings.base_lin_vel_w),
            base_ang_vel_b=readings.base_ang_vel_b,
            gravity_b=rotate_inverse(quat, self._down[: len(quat)]),
            joint_pos=readings.joint_pos,
            joint_offset=readings.joint_pos - self._default_joint_pos,
            joint_vel=readings.joint_vel,
            joint_acc=(readings.joint_vel - buffers["joint_vel"]) / self.control_dt,
            joint_torque=readings.joint_torque,
            foot_vel_w=readings.foot_vel_w,
            foot_acc_w=(readings.foot_vel_w - buffers["foot_vel"]) * (moving / self.control_dt)[:, None, None],
            foot_landed_s=landed_s,
            action=buffers["action"],
            previous_action=buffers["previous_action"],
            crash_contacts=readings.crash_contacts,
            collision_contacts=readings.collision_contacts,
            foot_contacts=readings.foot_contacts,
            heights_w=heights_w,
            fall_height=rasters.fall_height[tiles],
        )

    def _terminate(self, state: State) -> tuple[Outcome, Tensor]:
        self.task.follow(state)
        time_out = self.task.advance(self.control_dt)
        fell = state.base_pos_w[:, 2] < state.fall_height
        crashed = (state.crash_contacts > 0) | ~self._finite
        self._failed = crashed | fell
        self._ended = (time_out | self._failed) & ~self._buffers["retired"]
        reviewing = self._buffers["level"] < self.curriculum.levels
        self._counted = self._finite & ~self._buffers["shortened"] & ~reviewing
        outcome = self.task.judge(state, crashed, fell)
        return outcome, time_out & ~self._failed

    def _reward(self, state: State) -> Tensor:
        command, dt = self.task.command, self.control_dt
        terms: dict[str, Tensor] = {}
        exploration = self.exploration.factor
        for name, (function, weight) in self._terms.items():
            factor = exploration if name in EXPLORATION_REWARDS else 1.0
            terms[name] = function(state, command, self.config.task) * (weight * factor * dt)
        if CRASH_COST in self.config.task.rewards:
            terms[CRASH_COST] = self._failed * self.crash_cost
        if not bool(self._finite.all()):
            terms = {name: torch.where(self._finite, value, 0.0) for name, value in terms.items()}
        share, weight = self.task.task_share(state, self._failed)
        self.exploration.record(share, weight * self._counted)
        self.log = StepLog(rewards=terms, diverged=int((~self._finite).sum()))
        return torch.stack(list(terms.values())).sum(0)

    def _record(self, outcome: Outcome) -> None:
        self.log.success = outcome.success
        ids = self._ended.nonzero().squeeze(-1)
        if not len(ids):
            return
        self.log.finished = Finished(
            env_ids=ids,
            success=outcome.success[ids],
            counted=self._counted[ids],
            levels=self._buffers["level"][ids],
            distance=outcome.remaining[ids],
            failures={cause: mask[ids] for cause, mask in outcome.failures.items()},
            observation=self._observe()[ids] if self.final_observations else None,
        )
        if self._learning:
            counted, share = self._ended & self._counted, self.config.task.demotion_share
            self.curriculum.update(counted, outcome.promote, outcome.demote, share)

    def _restart(self) -> None:
        ids = self._ended.nonzero().squeeze(-1)
        if len(ids):
            self._reset(ids, first=False)

    def _reset(self, ids: Tensor, first: bool) -> None:
        levels = self.curriculum.deal(ids, self.review if self._learning else 0.0)
        self._buffers["level"][ids] = levels
        worlds = self._choose_worlds(ids, levels)
        self.physics.place(ids, worlds)
        self._buffers["tile"][ids] = self.pool.tile_of_world.to(self.device)[worlds]
        qpos, qvel = self._start_states(len(ids))
        self.physics.reset(ids, qpos, qvel)
        for name in ("action", "previous_action", "foot_vel", "foot_air_s", "foot_touched"):
            self._buffers[name][ids] = 0
        self._buffers["joint_vel"][ids] = qvel[:, 6:].float()
        self._buffers["fresh"][ids] = True
        self._buffers["moved"][ids] = True
        self._buffers["shortened"][ids] = first
        self.episode_length_buf[ids] = 0
        self.task.new_command(Start(ids, qpos[:, :3].float(), self._buffers["tile"][ids]), first)

    def _choose_worlds(self, ids: Tensor, levels: Tensor) -> Tensor:
        variant = (self._uniform(len(ids)) * self.config.terrain.variants).long()
        return self.pool.world_index.to(self.device)[self.family_of_env[ids], levels, variant]

    def _start_states(self, n: int) -> tuple[Tensor, Tensor]:
        """Random poses and velocities around standing at the tile's origin, in MuJoCo's order, float64."""
        config = self.config.randomisation
        signed = lambda *shape: 2.0 * self._uniform(*shape) - 1.0  # noqa: E731
        position = torch.zeros(n, 3, device=self.device)
        position[:, :2] = config.start_offset * signed(n, 2)
        position[:, 2] = self.robot.standing_height + SPAWN_CLEARANCE * self.robot.size
        quat = quat_of_yaw(config.start_yaw_rad * signed(n))
        joints = self._default_joint_pos * (1.0 + config.start_joint_scale * signed(n, self.num_actions))
        velocity = torch.zeros(n, 6 + self.num_actions, device=self.device)
        velocity[:, :6] = config.start_speed * signed(n, 6)
        return torch.cat([position, quat, joints], dim=-1).double(), velocity.double()

    def _push(self) -> None:
        """Shove robots at random moments, `push_interval_s` apart on average."""
        config = self.config.randomisation
        if config.push_speed <= 0.0:
            return
        pushed = self._uniform(self.num_envs) < self.control_dt / config.push_interval_s
        ids = (pushed & ~self._buffers["fresh"]).nonzero().squeeze(-1)
        if len(ids):
            velocity = torch.zeros(len(ids), 3, dtype=torch.double, device=self.device)
            velocity[:, :2] = config.push_speed * (2.0 * self._uniform(len(ids), 2) - 1.0)
            self.physics.push(ids, velocity)
            self._buffers["moved"][ids] = True

    @property
    def exploration_paid(self) -> float:
        """Share of the robots to which an exploration reward is still paid in full."""
        return self.exploration.paid if any(name in self._terms for name in EXPLORATION_REWARDS) else 0.0

    def _extras(self, time_out: Tensor) -> dict:
        return {"time_outs": time_out.float()} if self.config.task.bootstrap_timeouts else {}

    def _uniform(self, *shape: int) -> Tensor:
        return torch.rand(*shape, generator=self._generator, device=self.device)

    # Exact continuation.

    def state_dict(self) -> dict:
        """Everything that decides the future of this environment."""
        return {
            "physics": self.physics.state_dict(),
            "task": self.task.state_dict(),
            "buffers": {name: value.clone() for name, value in self._buffers.items()},
            "levels": self.curriculum.levels.clone(),
            "exploration": self.exploration.state_dict(),
            "episode_length": self.episode_length_buf.clone(),
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, state: dict) -> None:
        """Go on exactly from a `state_dict` of an environment of the same configuration."""
        self.physics.load_state_dict(state["physics"])
        self.task.load_state_dict(state["task"])
        for name, value in self._buffers.items():
            value.copy_(state["buffers"][name])
        self.curriculum.levels = state["levels"].to(self.device, copy=True)
        self.exploration.load_state_dict(state["exploration"])
        self.episode_length_buf.copy_(state["episode_length"])
        self._generator.set_state(state["generator"])
        self._read()


def _weighted_terms(task: Task, weights: dict[str, float]) -> dict:
    """Reward terms with a weight other than zero; a weight without a term is an error."""
    for name in weights:
        if name not in task.rewards and name != CRASH_COST:
            raise unknown_name("reward", name, [*task.rewards, CRASH_COST])
    terms = {name: (task.rewards[name], weight) for name, weight in weights.items() if weight and name != CRASH_COST}
    if not terms:
        raise ArriveError("task.rewards has no reward with a weight other than zero")
    return terms


def _silence(readings: Readings) -> Readings:
    """Readings with diverged robots' values replaced by zeros, so that they cannot spoil sums over all robots."""
    values = {}
    for name, value in vars(readings).items():
        mask = readings.finite.view(-1, *[1] * (value.ndim - 1))
        values[name] = value if name == "finite" else torch.where(mask, value, 0.0)
    upright = torch.tensor([1.0, 0.0, 0.0, 0.0], device=readings.finite.device)
    values["base_quat_w"] = torch.where(readings.finite.unsqueeze(-1), values["base_quat_w"], upright)
    return Readings(**values)
