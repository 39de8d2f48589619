"""The training loop: collect, learn, report, and never lose more than the last interval."""

import copy
import time
from collections.abc import Callable
from pathlib import Path

import torch
from tensordict import TensorDict

from arrive.config import Config, from_dict, to_dict
from arrive.env import POLICY, ArriveEnv
from arrive.errors import ArriveError
from arrive.learning.checkpoint import (
    CHECKPOINT_NAME,
    FORMAT,
    POLICY_NAME,
    check_schema,
    load_checked,
    save_atomically,
)
from arrive.learning.guard import NonFiniteError, all_finite, check_losses, check_terms, save_dump
from arrive.learning.interrupt import interruptible
from arrive.learning.ppo import make_ppo
from arrive.learning.report import IterationReport
from arrive.learning.rundir import commit
from arrive.learning.statistics import TrainingStatistics

CHECKPOINT_INTERVAL_S = 120.0
"""Time between checkpoints [s]."""
MAX_RECOVERIES = 3
"""Times that training goes back to the last good state, without a new one, before it gives up."""

Reporter = Callable[[IterationReport], None]


class Trainer:
    """Trains one policy in one environment; its whole state can be saved and loaded bit for bit."""

    def __init__(self, config: Config, env: ArriveEnv, folder: Path):
        """Draw fresh networks from the configuration's seed."""
        torch.manual_seed(config.seed)
        self.config, self.env, self.folder = config, env, folder
        self._observations = env.get_observations()
        self.algorithm = make_ppo(config.ppo, env, self._observations)
        self._statistics = TrainingStatistics(env)
        self.iteration, self.samples, self.elapsed_s = 0, 0, 0.0
        self._recoveries = 0
        self._good = self._snapshot()

    def train(
        self,
        minutes: float | None,
        iterations: int | None,
        report: Reporter,
        save_interval_s: float = CHECKPOINT_INTERVAL_S,
    ) -> None:
        """Train until the budget is spent: minutes or iterations since the run began, whichever comes first.

        Ctrl-C and SIGTERM end it after the iteration in progress. It saves at the start too, so that a run that is
        killed can always be resumed.
        """
        self.save()
        saved_at = time.monotonic()
        with interruptible() as interrupted:
            while self._budget(minutes, iterations) < 1.0 and not interrupted():
                if not self.iterate(report, minutes, iterations):
                    continue
                if time.monotonic() - saved_at > save_interval_s:
                    self.save()
                    saved_at = time.monotonic()
        self.save()

    def iterate(self, report: Reporter, minutes: float | None = None, iterations: int | None = None) -> bool:
        """Collect, learn and report once, of a budget that `train` explains.

        Returns:
            False where a number was none: training went back to the last good state.
        """
        result = self._guarded_iteration()
        if result is not None:
            report(self._report(*result, minutes, iterations))
        return result is not None

    def look(self) -> None:
        """Take the observations from the environment anew, where somebody else has stepped it."""
        self._observations = self.env.get_observations()

    def _budget(self, minutes: float | None, iterations: int | None) -> float:
        """Share of the budget that is spent."""
        by_time = self.elapsed_s / (60.0 * minutes) if minutes else 0.0
        by_count = self.iteration / iterations if iterations else 0.0
        return max(by_time, by_count)

    def _guarded_iteration(self) -> tuple[dict[str, float], dict[str, float], float] | None:
        """One iteration; None where it met a number that is none and went back to the last good state."""
        start = time.monotonic()
        try:
            rewards, losses = self._collect_and_learn()
        except NonFiniteError as error:
            self._recover(error)
            return None
        seconds = time.monotonic() - start
        self.iteration += 1
        self.samples += self.env.num_envs * self.config.ppo.num_steps
        self.elapsed_s += seconds
        return rewards, losses, seconds

    def _collect_and_learn(self) -> tuple[dict[str, float], dict[str, float]]:
        try:
            return self.collect(), self.learn()
        except RuntimeError:
            # Torch refuses to draw actions where a mean or deviation is NaN, before any check of ours.
            check_losses({}, self._parameters())
            raise

    @torch.inference_mode()
    def collect(self) -> dict[str, float]:
        """Act for an iteration's steps; mean weighted reward per step and term."""
        observations = self._observations
        for _ in range(self.config.ppo.num_steps):
            actions = self.algorithm.act(observations)
            observations, rewards, dones, extras = self.env.step(actions)
            self._check_step(observations, rewards)
            self.algorithm.process_env_step(observations, rewards, dones, extras)
            self._statistics.take(self.env, self.env.log)
        self._observations = observations
        self.algorithm.compute_returns(observations)
        return self._statistics.finish_iteration()

    def _check_step(self, observations: TensorDict, rewards: torch.Tensor) -> None:
        if all_finite(observations[POLICY], rewards):
            return
        check_terms("reward", self.env.log.rewards)
        observation = observations[POLICY]
        terms = {row["name"]: observation[:, row["start"] : row["stop"]] for row in self.env.observer.schema()}
        check_terms("observation", terms)

    def learn(self) -> dict[str, float]:
        """Learn from what was collected; the losses and what else the update has to report."""
        config, exploring = self.config.ppo, self.env.exploration.paid
        self.algorithm.entropy_coef = config.entropy_after + exploring * (config.entropy - config.entropy_after)
        losses = self.algorithm.update()
        check_losses(losses, self._parameters())
        std = float(self.algorithm.get_policy().distribution.log_std_param.detach().exp().mean())
        return losses | {"learning_rate": self.algorithm.learning_rate, "action_std": std}

    def _parameters(self) -> dict[str, torch.Tensor]:
        networks = {"actor": self.algorithm.get_policy(), "critic": self.algorithm.critic}
        return {f"{name} {n}": value for name, network in networks.items() for n, value in network.named_parameters()}

    def _recover(self, error: NonFiniteError) -> None:
        """Dump, go back, and draw other random numbers from there."""
        self._recoveries += 1
        path = save_dump(self.folder, self.iteration, error, self._good)
        if self._recoveries > MAX_RECOVERIES:
            raise ArriveError(f"{error}; it came back {MAX_RECOVERIES} times. What was seen is in {path}.") from error
        print(f"{error}. Dumped to {path}; going on from iteration {self._good['iteration']}.")
        self._restore(self._good)
        self.algorithm.storage.clear()
        torch.manual_seed(self.config.seed + 7919 * self._recoveries + self.iteration)

    def _report(
        self,
        rewards: dict[str, float],
        losses: dict[str, float],
        seconds: float,
        minutes: float | None,
        iterations: int | None,
    ) -> IterationReport:
        spent = self._budget(minutes, iterations)
        batch = self.env.num_envs * self.config.ppo.num_steps
        return IterationReport(
            iteration=self.iteration,
            samples=self.samples,
            elapsed_s=self.elapsed_s,
            budget=min(spent, 1.0),
            time_left_s=self.elapsed_s * max(1.0 / spent - 1.0, 0.0) if spent else float("nan"),
            samples_per_s=batch / seconds,
            arrival=self._statistics.arrival(),
            exploration_paid=self.env.exploration_paid,
            task_fraction=self.env.exploration.fraction,
            families=self._statistics.families(self.env),
            rewards=rewards,
            failures=self._statistics.failures(),
            learning=losses | {"diverged": float(self._statistics.diverged)},
        )

    def _snapshot(self) -> dict:
        """Everything that decides how training goes on."""
        return copy.deepcopy(
            {
                "iteration": self.iteration,
                "samples": self.samples,
                "elapsed_s": self.elapsed_s,
                "algorithm": self.algorithm.save(),
                "env": self.env.state_dict(),
                "observations": self._observations[POLICY],
                "statistics": self._statistics.state_dict(),
                "random": torch.get_rng_state(),
            }
        )

    def _restore(self, state: dict) -> None:
        self.iteration, self.samples, self.elapsed_s = state["iteration"], state["samples"], state["elapsed_s"]
        self.algorithm.load(copy.deepcopy(state["algorithm"]), None, True)
        self.env.load_state_dict(state["env"])
        self._observations = TensorDict({POLICY: state["observations"].clone()}, batch_size=[self.env.num_envs])
        self._statistics.load_state_dict(copy.deepcopy(state["statistics"]))
        torch.set_rng_state(state["random"])

    def _description(self) -> dict:
        """What a policy file says of itself."""
        return {
            "format": FORMAT,
            "robot": self.config.robot,
            "config": to_dict(self.config),
            "schema": self.env.observer.schema(),
            "commit": commit(),
            "iteration": self.iteration,
            "samples": self.samples,
        }

    def save(self) -> None:
        """Write checkpoint and policy; this state is then the one to go back to."""
        self._good, self._recoveries = self._snapshot(), 0
        description = self._description()
        save_atomically(description | {"state": self._good}, self.folder / CHECKPOINT_NAME)
        actor = self._good["algorithm"]["actor_state_dict"]
        save_atomically(description | {"actor": actor}, self.folder / POLICY_NAME)

    def load(self) -> None:
        """Go on exactly where the folder's checkpoint stands.

        Raises:
            ArriveError: no readable checkpoint, or one of another robot, observation or configuration.
        """
        path = self.folder / CHECKPOINT_NAME
        content = self._load_matching(path)
        if "state" not in content:
            raise ArriveError(f"{path} is a policy, not a training checkpoint; it cannot be resumed")
        if from_dict(Config, content["config"]) != self.config:  # fields that are newer than the file have defaults
            raise ArriveError(f"{path} was made with another configuration than {self.folder}/config.json")
        try:
            self._restore(content["state"])
        except (KeyError, RuntimeError) as error:
            raise ArriveError(
                f"{path} was written by another version of arrive and cannot be resumed; "
                f"begin a new run with its networks: --start-from {self.folder}. ({error!r})"
            ) from error
        self._good = self._snapshot()

    def warm_start(self, path: Path) -> None:
        """Take networks and optimiser from another run's checkpoint, and nothing else."""
        content = self._load_matching(path)
        try:
            self.algorithm.load(content["state"]["algorithm"], None, True)
        except (KeyError, RuntimeError) as error:
            raise ArriveError(f"the networks in {path} do not fit: choose the same ppo.hidden. ({error})") from error

    def _load_matching(self, path: Path) -> dict:
        content = load_checked(path)
        if content["robot"] != self.config.robot:
            raise ArriveError(f"{path} was trained for the robot {content['robot']!r}, not {self.config.robot!r}")
        check_schema(content["schema"], self.env.observer.schema(), path)
        return content
