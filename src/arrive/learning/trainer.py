"""The training loop: collect, learn, report, save. A crash loses at most the time since the last checkpoint."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from rsl_rl.algorithms import PPO
from tensordict import TensorDict

from arrive.config import Config
from arrive.env import POLICY, ArriveEnv
from arrive.learning.guard import NonFiniteError, all_finite, check_losses, check_terms
from arrive.learning.interrupt import interruptible
from arrive.learning.networks import Network
from arrive.learning.policy import Policy
from arrive.learning.ranks import ALONE, Ranks
from arrive.learning.recovery import Recovery
from arrive.learning.report import IterationReport
from arrive.learning.run_files import resume_run, save_run
from arrive.learning.schedule import Settings, settings_at
from arrive.learning.state import TrainingState
from arrive.learning.threads import one_torch_thread
from arrive.learning.warm_start import warm_start
from arrive.learning.watch import find_warnings

CHECKPOINT_INTERVAL_S = 120.0
"""Time between checkpoints [s]."""

Reporter = Callable[[IterationReport], None]


@dataclass(frozen=True)
class Budget:
    """How long to train, measured from the start of the run. None means no limit."""

    minutes: float | None = None
    iterations: int | None = None
    samples: float | None = None
    """Policy steps of all robots."""

    def spent(self, state: TrainingState) -> float:
        """Spent share of the budget; 1 or more when it is used up."""
        by_time = state.elapsed_s / (60.0 * self.minutes) if self.minutes else 0.0
        by_count = state.iteration / self.iterations if self.iterations else 0.0
        by_samples = state.samples / self.samples if self.samples else 0.0
        return max(by_time, by_count, by_samples)


@dataclass(frozen=True)
class _Iteration:
    """Results of one iteration."""

    rewards: dict[str, float]
    losses: dict[str, float]
    seconds: float


class Trainer:
    """Trains one policy in one environment. Its state can be saved and restored bit for bit."""

    def __init__(self, config: Config, env: ArriveEnv, folder: Path, ranks: Ranks = ALONE):
        """Initialise networks from the configuration's seed.

        Args:
            folder: the run folder, for checkpoints.
            ranks: the processes that train together, each with its own environment.
        """
        self.config, self.env, self.folder, self.ranks = config, env, folder, ranks
        self.state = TrainingState(config, env, ranks)
        self.recovery = Recovery(self.state, config.seed + ranks.seed_offset, folder, ranks)
        self.interrupted = False
        """Whether a signal, such as that of Ctrl-C, ended the training before its budget was spent."""

    @property
    def algorithm(self) -> PPO:
        """rsl_rl's PPO with its networks."""
        return self.state.algorithm

    def train(
        self,
        budget: Budget,
        report: Reporter,
        before_save: Callable[[], None] = lambda: None,
        save_interval_s: float = CHECKPOINT_INTERVAL_S,
    ) -> None:
        """Train until the budget is spent.

        All processes stop and save together, as soon as one of them should. Ctrl-C, SIGTERM and SIGHUP end training
        after the current iteration. A checkpoint is saved at the start too, so that a killed run can always be resumed.

        Args:
            before_save: called before each checkpoint, to write other files to disk that must not be older than it.
        """

        def save() -> float:
            before_save()
            self.save()
            return time.monotonic()

        saved_at = save()
        with interruptible() as interrupted:
            while not self.ranks.any(self._spent(budget) >= 1.0 or interrupted()):
                if not self.iterate(report, budget):
                    continue
                if self.ranks.any(time.monotonic() - saved_at > save_interval_s):
                    saved_at = save()
            save()
            self.interrupted = interrupted() and self._spent(budget) < 1.0

    def iterate(self, report: Reporter, budget: Budget = Budget()) -> bool:
        """Collect, learn and report once.

        Returns:
            False if a value was not finite and training went back to the last good state.
        """
        start = time.monotonic()
        settings = self._follow_schedule(min(self._spent(budget), 1.0))
        try:
            rewards, losses = self._collect_and_learn(settings)
        except NonFiniteError as error:
            self.recovery.go_back(error)
            return False
        result = _Iteration(rewards, losses, time.monotonic() - start)
        state = self.state
        state.iteration += 1
        state.samples += self.batch
        state.elapsed_s += result.seconds
        report(self._report(result, budget))
        return True

    def save(self) -> None:
        """Write checkpoint and policy. This state becomes the last good one."""
        self.recovery.keep()
        save_run(self.state, self.recovery.good, self.config, self.folder, self.ranks)

    def load(self) -> None:
        """Resume exactly from the folder's checkpoint; see `resume_run`."""
        resume_run(self.state, self.config, self.folder, self.ranks)
        self.recovery.keep()

    def warm_start(self, start: Path | Policy) -> int:
        """Start from the networks of another run or policy; see `warm_start`."""
        samples = warm_start(self.state, self.config, start)
        self.recovery.keep()
        return samples

    def look(self) -> None:
        """Read the observations from the environment again, after other code has stepped it."""
        self.state.observations = self.env.get_observations()

    def _spent(self, budget: Budget) -> float:
        return budget.spent(self.state)

    @property
    def batch(self) -> int:
        """Policy steps per iteration, of all processes."""
        return self.env.num_envs * self.config.ppo.num_steps * self.ranks.count

    def _follow_schedule(self, spent: float) -> Settings:
        """Apply the schedule's values for the next iteration to the environment."""
        settings = settings_at(self.config, spent, self.env.exploration.paid)
        self.env.review, self.env.rewarder.crash_cost = settings.review, -settings.crash_cost
        self.env.calm = settings.calm
        self.env.physics.set_decimation(settings.decimation)
        return settings

    def _collect_and_learn(self, settings: Settings) -> tuple[dict[str, float], dict[str, float]]:
        rewards = self.recovery.together(self.collect)
        self.env.exploration.agree(self.ranks.any_of)
        return rewards, self.recovery.together(lambda: self.learn(settings))

    @one_torch_thread()
    @torch.inference_mode()
    def collect(self) -> dict[str, float]:
        """Collect one rollout. Returns the mean weighted reward of each term per step."""
        state, actor = self.state, self.algorithm.get_policy()
        assert isinstance(actor, Network)
        observations = state.observations
        for _ in range(self.config.ppo.num_steps):
            actions = self.algorithm.act(actor.reflect_once(observations))
            observations, rewards, dones, extras = self.env.step(actions)
            self._check_step(observations, rewards)
            self.algorithm.process_env_step(observations, rewards, dones, extras)
            state.statistics.take(self.env, self.env.log)
        state.observations = observations
        self.algorithm.compute_returns(actor.reflect_once(observations))
        return state.statistics.finish_iteration()

    def _check_step(self, observations: TensorDict, rewards: torch.Tensor) -> None:
        if all_finite(observations[POLICY], rewards):
            return
        check_terms("reward", self.env.log.rewards)
        observation = observations[POLICY]
        terms = {row["name"]: observation[:, row["start"] : row["stop"]] for row in self.env.observer.schema()}
        check_terms("observation", terms)

    def learn(self, settings: Settings) -> dict[str, float]:
        """Update the networks from the rollout. Returns losses and other learning metrics."""
        self.algorithm.entropy_coef = settings.entropy
        self.algorithm.desired_kl = settings.desired_kl or None
        explained = explained_variance(self.algorithm.storage.values, self.algorithm.storage.returns)
        losses = self.algorithm.update() | {"explained_variance": explained}
        check_losses(losses, self.state.parameters())
        log_std = self.algorithm.get_policy().distribution.log_std_param.data.clamp_(max=math.log(settings.max_std))
        schedule = {"crash_cost": settings.crash_cost, "review": settings.review, "entropy_bonus": settings.entropy}
        std = float(log_std.exp().mean())
        return losses | {"learning_rate": self.algorithm.learning_rate, "action_std": std} | schedule

    def _report(self, result: _Iteration, budget: Budget) -> IterationReport:
        state, statistics, spent = self.state, self.state.statistics, self._spent(budget)
        report = IterationReport(
            iteration=state.iteration,
            samples=state.samples,
            elapsed_s=state.elapsed_s,
            budget=min(spent, 1.0),
            time_left_s=state.elapsed_s * max(1.0 / spent - 1.0, 0.0) if spent else float("nan"),
            samples_per_s=self.batch / result.seconds,
            arrival=statistics.arrival(),
            diverged_share=statistics.diverged_share(),
            exploration_paid=self.env.exploration_paid,
            task_fraction=self.env.exploration.fraction,
            families=statistics.families(self.env),
            rewards=result.rewards,
            failures=statistics.failures(),
            learning=result.losses | {"diverged": float(statistics.diverged)},
        )
        return find_warnings(report)


def explained_variance(values: torch.Tensor, returns: torch.Tensor) -> float:
    """1 - Var(returns - values) / Var(returns): 1 for a perfect critic, 0 for one that predicts the mean.

    It is computed on a rollout before the critic has learnt from it. It is 0 if all returns are equal.
    """
    spread = returns.var()
    return float(1.0 - (returns - values).var() / spread) if spread > 0.0 else 0.0
