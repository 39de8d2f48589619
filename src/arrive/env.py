"""The vectorised environment: one step is a short list of named phases."""

from dataclasses import dataclass, field
from typing import Any

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from arrive.config import Config
from arrive.physics.engine import Physics
from arrive.physics.pool import WorldPool
from arrive.robots.robot import Robot
from arrive.task.curriculum import ExplorationSwitch, LevelCurriculum, assign_families
from arrive.task.memory import Memory
from arrive.task.observations import Observer
from arrive.task.randomisation import draw_pushes, start_states
from arrive.task.reading import Reader
from arrive.task.rewards import Rewarder
from arrive.task.state import State
from arrive.task.task import Outcome, Start, Task
from arrive.task.terminations import Endings, end_episodes

POLICY = "policy"
"""Name of the observation group that actor and critic read."""


@dataclass
class Finished:
    """Episodes that ended in one step; each tensor has one entry per ended episode."""

    env_ids: Tensor
    success: Tensor
    counted: Tensor
    """False for a run's shortened first episodes, episodes on an easier level than the robot's own, and diverged
    simulations."""
    levels: Tensor
    """Terrain level of the episode."""
    distance: Tensor
    """Distance left at the end [m]."""
    failures: dict[str, Tensor]
    observation: Tensor | None = None
    """(ended, size) the last observation of each, if `ArriveEnv.final_observations` is set."""


@dataclass
class StepLog:
    """Results of one step, for statistics."""

    rewards: dict[str, Tensor] = field(default_factory=dict)
    """Weighted reward of each term, (num_envs,)."""
    diverged: int = 0
    """Number of simulations that diverged and were reset."""
    success: Tensor | None = None
    """(num_envs,) bool: the episode would be a success if it ended now."""
    finished: Finished | None = None


class ArriveEnv(VecEnv):
    """Robots that must reach targets by given times, each on its own tile."""

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
            assignment: (num_envs,) fixed family and (num_envs,) fixed level of each robot. Without it, robots are
                distributed equally over the families, levels follow success, and the first episodes are shortened to
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
        self.review = 0.0
        """Share of the episodes on an easier level than the robot's own. A schedule may change it."""
        self.calm = False
        """Whether there are neither pushes nor new targets within an episode. A schedule may change it."""
        self.final_observations = False
        """Whether to record the last observation of every episode, which computes all observations a second time."""
        sensing = config.observation
        terms = task.observation_terms(config.task, sensing, robot)
        self.observer = Observer(terms, sensing.noise, self.device, sensing.noise_least)
        self.rewarder = Rewarder(config.task, self.control_dt, crash_cost_rises=config.schedule.enabled)
        self._reader = Reader(robot, pool.rasters, sensing.heights, self.control_dt)
        self._default_joint_pos = torch.tensor(robot.default_joint_pos, device=self.device)
        assigned = assign_families(self.num_envs, len(pool.families)).to(self.device)
        self.family_of_env = assigned if assignment is None else assignment[0]
        self.memory = Memory.blank(self.num_envs, robot, self.device)
        self.log = StepLog()
        self._start_curriculum()
        self.restart()

    def restart(self, seed: int | None = None) -> None:
        """Start every robot's first episode again.

        Args:
            seed: seeds the generator and resets levels and exploration reward; None keeps all three.
        """
        if seed is not None:
            self._generator.manual_seed(seed)
            self._start_curriculum()
        self._reset(torch.arange(self.num_envs, device=self.device), first=self._learning)
        self._read()

    def _start_curriculum(self) -> None:
        num_levels = torch.tensor(self.pool.num_levels, device=self.device)[self.family_of_env]
        self.curriculum = LevelCurriculum(num_levels, self._generator)
        if self._assignment is not None:
            self.curriculum.levels = self._assignment[1]
        self.exploration = ExplorationSwitch(self.family_of_env, self.max_episode_length)

    def start_at_levels(self, levels: dict[str, Tensor]) -> None:
        """Start every robot's first episode again, at levels drawn from those of an earlier run.

        Args:
            levels: by terrain family, any number of levels between 0 (easiest) and 1 (hardest). Robots of other
                families stay on their level.
        """
        for index, family in enumerate(self.pool.families):
            if family.name in levels:
                ids = (self.family_of_env == index).nonzero().squeeze(-1)
                reached = levels[family.name].to(self.device)
                drawn = reached[(self._uniform(len(ids)) * len(reached)).long()]
                self.curriculum.levels[ids] = (drawn * (self.pool.num_levels[index] - 1)).round().long()
        self.restart()

    @property
    def tile_of_env(self) -> Tensor:
        """(num_envs,) index of each robot's tile in the pool."""
        return self.memory.tile

    @property
    def inactive(self) -> Tensor:
        """(num_envs,) bool: robots that are no longer simulated."""
        return self.memory.inactive

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Tensor]]:
        """Advance every robot by one policy step. Robots whose episode ended start the next one.

        Args:
            actions: (num_envs, joints) joint targets relative to the default pose, in units of the action scale.

        Returns:
            Observations after the step (after an episode's end, the first of the next episode), rewards (num_envs,),
            dones (num_envs,), and rsl_rl's extras.
        """
        self.memory.act(actions)
        self._simulate()
        state = self._read()
        self.memory.keep(state, self.control_dt)
        endings = self._terminate(state)
        rewards = self._reward(state, endings)
        self._record(state, endings)
        self._restart(endings)
        self._push()
        self._look_again()
        return self.get_observations(), rewards, endings.ended.long(), self._extras(endings)

    def get_observations(self) -> TensorDict:
        """The current observations, with fresh noise."""
        return TensorDict({POLICY: self._observe()}, batch_size=[self.num_envs], device=self.device)

    def _observe(self) -> Tensor:
        return self.observer.observe(self.state, self.task.command, self._generator)

    def joint_targets(self, actions: Tensor) -> Tensor:
        """(num_envs, joints) joint targets of actions [rad]."""
        return self._default_joint_pos + self.robot.action_scale * actions

    def begin_episodes(self, env_ids: Tensor) -> None:
        """End these robots' episodes without a result, and start the next ones."""
        self._reset(env_ids, first=False)
        self._look_again()

    def deactivate(self, env_ids: Tensor) -> None:
        """Stop simulating these robots, because an evaluation does not need them any more."""
        self.memory.inactive[env_ids] = True
        self.physics.deactivate(env_ids)

    # The phases of a step, in order.

    def _simulate(self) -> None:
        self.physics.step(self.joint_targets(self.memory.action))
        self.episode_length_buf += 1

    def _read(self) -> State:
        """Take all robots' state from physics."""
        self.state = self._reader.read(self.physics.read(), self.memory)
        self.memory.moved.zero_()
        return self.state

    def _terminate(self, state: State) -> Endings:
        self.task.follow(state)
        if not self.calm:
            self.task.retarget(state)
        time_over = self.task.advance(self.control_dt)
        return end_episodes(state, self.memory, time_over, self.curriculum.levels)

    def _reward(self, state: State, endings: Endings) -> Tensor:
        terms = self.rewarder.pay(state, self.task.command, endings.failed, self.exploration.factor)
        share, weight = self.task.task_share(state, endings.failed)
        self.exploration.record(share, weight * endings.counted)
        self.log = StepLog(rewards=terms, diverged=int((~state.finite).sum()))
        return torch.stack(list(terms.values())).sum(0)

    def _record(self, state: State, endings: Endings) -> None:
        outcome = self.task.judge(state, endings.crashed, endings.fell)
        outcome.check(self.num_envs)
        self.log.success = outcome.success
        ids = endings.ended.nonzero().squeeze(-1)
        if not len(ids):
            return
        self.log.finished = self._finished(ids, outcome, endings)
        if self._learning:
            counted = endings.ended & endings.counted
            self.curriculum.update(counted, outcome.promote, outcome.demote, self.config.terrain.demotion_share)

    def _finished(self, ids: Tensor, outcome: Outcome, endings: Endings) -> Finished:
        return Finished(
            env_ids=ids,
            success=outcome.success[ids],
            counted=endings.counted[ids],
            levels=self.memory.level[ids],
            distance=outcome.remaining[ids],
            failures={cause: mask[ids] for cause, mask in outcome.failures.items()},
            observation=self._observe()[ids] if self.final_observations else None,
        )

    def _restart(self, endings: Endings) -> None:
        ids = endings.ended.nonzero().squeeze(-1)
        if len(ids):
            self._reset(ids, first=False)

    def _reset(self, ids: Tensor, first: bool) -> None:
        levels = self.curriculum.next_levels(ids, self.review if self._learning else 0.0)
        worlds = self._choose_worlds(ids, levels)
        tiles = self.pool.tile_of_world.to(self.device)[worlds]
        self.physics.place(ids, worlds)
        qpos, qvel = start_states(len(ids), self.robot, self.config.randomisation, self._generator)
        self.physics.reset(ids, qpos, qvel)
        self.memory.reset(ids, qvel[:, 6:].float(), levels, tiles, first)
        self.episode_length_buf[ids] = 0
        self.task.new_command(Start(ids, qpos[:, :3].float(), tiles), first)

    def _choose_worlds(self, ids: Tensor, levels: Tensor) -> Tensor:
        variant = (self._uniform(len(ids)) * self.config.terrain.variants).long()
        return self.pool.world_index.to(self.device)[self.family_of_env[ids], levels, variant]

    def _push(self) -> None:
        if self.calm:
            return
        ids, change_w = draw_pushes(self.memory.fresh, self.config.randomisation, self.control_dt, self._generator)
        if len(ids):
            self.physics.push(ids, change_w)
            self.memory.moved[ids] = True

    def _look_again(self) -> None:
        """Read the state again of robots that were reset or pushed since the last reading."""
        ids = self.memory.moved.nonzero().squeeze(-1)
        if not len(ids):
            return
        state = self._reader.read(self.physics.read(ids), self.memory.rows(ids))
        for name, value in vars(state).items():
            getattr(self.state, name)[ids] = value
        self.memory.moved.zero_()

    @property
    def exploration_paid(self) -> float:
        """Share of the robots that still get the exploration reward; 0 if no term guides them to the target."""
        return self.exploration.paid if self.rewarder.leads else 0.0

    def _extras(self, endings: Endings) -> dict[str, Tensor]:
        return {"time_outs": endings.timed_out.float()} if self.task.bootstraps else {}

    def _uniform(self, *shape: int) -> Tensor:
        return torch.rand(*shape, generator=self._generator, device=self.device)

    # Exact resume.

    def state_dict(self) -> dict[str, Any]:
        """Everything that an exact resume needs."""
        return {
            "physics": self.physics.state_dict(),
            "task": self.task.state_dict(),
            "memory": self.memory.state_dict(),
            "levels": self.curriculum.levels.clone(),
            "exploration": self.exploration.state_dict(),
            "episode_length": self.episode_length_buf.clone(),
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume exactly from the `state_dict` of an environment with the same configuration."""
        self.physics.load_state_dict(state["physics"])
        self.task.load_state_dict(state["task"])
        self.memory.load_state_dict(state["memory"])
        self.curriculum.levels = state["levels"].to(self.device, copy=True)
        self.exploration.load_state_dict(state["exploration"])
        self.episode_length_buf.copy_(state["episode_length"])
        self._generator.set_state(state["generator"])
        self._read()
