"""The training loop: collect, learn, report, and never lose more than the last interval."""

import copy
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import torch
from tensordict import TensorDict

from arrive.config import Config, from_dict, to_dict
from arrive.env import POLICY, ArriveEnv
from arrive.errors import ArriveError
from arrive.learning.average import WeightAverage
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
from arrive.learning.ranks import ALONE, Ranks
from arrive.learning.report import IterationReport
from arrive.learning.rundir import commit
from arrive.learning.schedule import Settings, settings
from arrive.learning.statistics import TrainingStatistics
from arrive.learning.threads import one_torch_thread
from arrive.task.curriculum import deal_families

CHECKPOINT_INTERVAL_S = 120.0
"""Time between checkpoints [s]."""
MAX_RECOVERIES = 3
"""Times that training goes back to the last good state, without a new one, before it gives up."""

OWN_STATE = ("env", "observations", "statistics", "random", "random_cuda")
"""The parts of the state that each process has of its own."""

Reporter = Callable[[IterationReport], None]
Result = TypeVar("Result")


class Trainer:
    """Trains one policy in one environment; its whole state can be saved and loaded bit for bit."""

    def __init__(self, config: Config, env: ArriveEnv, folder: Path, ranks: Ranks = ALONE):
        """Draw fresh networks from the configuration's seed: the same in every process, which then part.

        Args:
            ranks: the processes that train together, each with an environment of its own.
        """
        torch.manual_seed(config.seed)
        self.config, self.env, self.folder, self.ranks = config, env, folder, ranks
        self._observations = env.get_observations()
        self.algorithm = make_ppo(config.ppo, env, self._observations, ranks)
        self._average = WeightAverage(self.algorithm.get_policy(), config.ppo.averaged_iterations)
        if not ranks.leads:
            torch.manual_seed(config.seed + ranks.seed_offset)
        self._statistics = TrainingStatistics(env)
        self.iteration, self.samples, self.elapsed_s = 0, 0, 0.0
        self._recoveries = 0
        self._settings: Settings | None = None
        self._good = self._snapshot()

    def train(
        self,
        minutes: float | None,
        iterations: int | None,
        report: Reporter,
        save_interval_s: float = CHECKPOINT_INTERVAL_S,
    ) -> None:
        """Train until the budget is spent: minutes or iterations since the run began, whichever comes first.

        All processes stop and save together, when the first of them would. Ctrl-C and SIGTERM end it after the
        iteration in progress. It saves at the start too, so that a run that is killed can always be resumed.
        """
        self.save()
        saved_at = time.monotonic()
        with interruptible() as interrupted:
            while not self.ranks.any(self._budget(minutes, iterations) >= 1.0 or interrupted()):
                if not self.iterate(report, minutes, iterations):
                    continue
                if self.ranks.any(time.monotonic() - saved_at > save_interval_s):
                    self.save()
                    saved_at = time.monotonic()
        self.save()

    def iterate(self, report: Reporter, minutes: float | None = None, iterations: int | None = None) -> bool:
        """Collect, learn and report once, of a budget that `train` explains.

        Returns:
            False where a number was none: training went back to the last good state.
        """
        self._follow_schedule(min(self._budget(minutes, iterations), 1.0))
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
        self._average.take()
        self.iteration += 1
        self.samples += self.batch
        self.elapsed_s += seconds
        return rewards, losses, seconds

    @property
    def batch(self) -> int:
        """Policy steps per iteration, of all processes."""
        return self.env.num_envs * self.config.ppo.num_steps * self.ranks.count

    def _collect_and_learn(self) -> tuple[dict[str, float], dict[str, float]]:
        rewards = self._together(self.collect)
        exploration = self.env.exploration
        exploration.active = ~self.ranks.any_of(~exploration.active)
        return rewards, self._together(self.learn)

    def _together(self, phase: Callable[[], Result]) -> Result:
        """Run a phase; where one process meets a number that is none, all go back.

        Raises:
            NonFiniteError: this process or another one met it.
        """
        result, failure = None, None
        try:
            result = phase()
        except NonFiniteError as error:
            failure = error
        except RuntimeError as error:
            failure = self._broken_networks(error)
        if self.ranks.any(failure is not None):
            raise failure or NonFiniteError("another process met a non-finite number", {})
        return result

    def _broken_networks(self, error: RuntimeError) -> NonFiniteError:
        """Why torch refused to draw actions, which it does where a mean or deviation is NaN, before our checks."""
        try:
            check_losses({}, self._parameters())
        except NonFiniteError as broken:
            return broken
        raise error

    @one_torch_thread()
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
        if self._settings is not None:
            self.algorithm.entropy_coef = self._settings.entropy
            self.algorithm.desired_kl = self._settings.desired_kl
        losses = self.algorithm.update()
        check_losses(losses, self._parameters())
        log_std = self.algorithm.get_policy().distribution.log_std_param
        if self._settings is not None and math.isfinite(self._settings.max_std):
            log_std.data.clamp_(max=math.log(self._settings.max_std))
        std = float(log_std.detach().exp().mean())
        return losses | {"learning_rate": self.algorithm.learning_rate, "action_std": std}

    def _follow_schedule(self, spent: float) -> None:
        """Set what the schedule says for the next iteration."""
        if not self.config.schedule.enabled:
            return
        self._settings = settings(self.config, spent, self.env.exploration.paid)
        self.env.review = self._settings.review
        self.env.crash_cost = -self._settings.crash_cost

    def _parameters(self) -> dict[str, torch.Tensor]:
        networks = {"actor": self.algorithm.get_policy(), "critic": self.algorithm.critic}
        return {f"{name} {n}": value for name, network in networks.items() for n, value in network.named_parameters()}

    def _recover(self, error: NonFiniteError) -> None:
        """Dump, go back, and draw other random numbers from there."""
        self._recoveries += 1
        folder = self.folder if self.ranks.leads else self.folder / f"rank{self.ranks.rank}"
        path = save_dump(folder, self.iteration, error, self._good)
        if self._recoveries > MAX_RECOVERIES:
            raise ArriveError(f"{error}; it came back {MAX_RECOVERIES} times. What was seen is in {path}.") from error
        print(f"{error}. Dumped to {path}; going on from iteration {self._good['iteration']}.")
        self._restore(self._good)
        self.algorithm.storage.clear()
        torch.manual_seed(self.config.seed + self.ranks.seed_offset + 7919 * self._recoveries + self.iteration)

    def _report(
        self,
        rewards: dict[str, float],
        losses: dict[str, float],
        seconds: float,
        minutes: float | None,
        iterations: int | None,
    ) -> IterationReport:
        spent = self._budget(minutes, iterations)
        return IterationReport(
            iteration=self.iteration,
            samples=self.samples,
            elapsed_s=self.elapsed_s,
            budget=min(spent, 1.0),
            time_left_s=self.elapsed_s * max(1.0 / spent - 1.0, 0.0) if spent else float("nan"),
            samples_per_s=self.batch / seconds,
            arrival=self._statistics.arrival(),
            exploration_paid=self.env.exploration_paid,
            task_fraction=self.env.exploration.fraction,
            families=self._statistics.families(self.env),
            rewards=rewards,
            failures=self._statistics.failures(),
            learning=losses | {"diverged": float(self._statistics.diverged)},
        )

    def _snapshot(self) -> dict:
        """Everything that decides how training goes on in this process."""
        return copy.deepcopy(
            {
                "iteration": self.iteration,
                "samples": self.samples,
                "elapsed_s": self.elapsed_s,
                "algorithm": self.algorithm.save(),
                "average": self._average.state_dict(),
                "device": self.env.device.type,
                "env": self.env.state_dict(),
                "observations": self._observations[POLICY],
                "statistics": self._statistics.state_dict(),
                "random": torch.get_rng_state(),
                "random_cuda": torch.cuda.get_rng_state(self.env.device) if self.env.device.type == "cuda" else None,
            }
        )

    def _restore(self, state: dict) -> None:
        self.iteration, self.samples, self.elapsed_s = state["iteration"], state["samples"], state["elapsed_s"]
        self.algorithm.load(copy.deepcopy(state["algorithm"]), None, True)
        if "average" in state:
            self._average.load_state_dict(state["average"])
        else:  # a checkpoint from before averages were kept
            self._average.restart()
        self.env.load_state_dict(state["env"])
        observations = state["observations"].to(self.env.device, copy=True)
        self._observations = TensorDict({POLICY: observations}, batch_size=[self.env.num_envs])
        self._statistics.load_state_dict(copy.deepcopy(state["statistics"]))
        torch.set_rng_state(state["random"])
        if self.env.device.type == "cuda":
            torch.cuda.set_rng_state(state["random_cuda"], self.env.device)

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
        """Write checkpoint and policy; this state is then the one to go back to.

        The first process writes, with what the others' environments need to go on.
        """
        self._good, self._recoveries = self._snapshot(), 0
        own = {name: self._good[name] for name in OWN_STATE}
        others = self.ranks.gather(own)[1:]
        if not self.ranks.leads:
            return
        description = self._description()
        save_atomically(description | {"state": self._good | {"others": others}}, self.folder / CHECKPOINT_NAME)
        save_atomically(description | {"actor": self._average.weights()}, self.folder / POLICY_NAME)

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
        state = self._own_part(content["state"], path)
        try:
            self._restore(state)
        except (KeyError, RuntimeError) as error:
            raise ArriveError(
                f"{path} was written by another version of arrive and cannot be resumed; "
                f"begin a new run with its networks: --start-from {self.folder}. ({error!r})"
            ) from error
        self._good = self._snapshot()

    def _own_part(self, state: dict, path: Path) -> dict:
        """A checkpoint's state with this process's environment in it.

        Raises:
            ArriveError: it was made by another number of processes or on another kind of device.
        """
        others, device = state.get("others", []), state.get("device", "cpu")
        if len(others) + 1 != self.ranks.count:
            raise ArriveError(f"{path} was made by {len(others) + 1} processes: resume it with as many")
        if device != self.env.device.type:
            raise ArriveError(
                f"{path} was made with --device {device}: resume it so, or start a "
                f"new run with --start-from {path.parent}"
            )
        return state if self.ranks.leads else state | others[self.ranks.rank - 1]

    def warm_start(self, path: Path) -> int:
        """Take networks and optimiser from another run's checkpoint, and the levels of the families that both have.

        The networks are its last ones, not their mean; the action noise too, where `ppo.warm_std` gives no other.

        Returns:
            Policy steps that the other run has made.
        """
        content = self._load_matching(path)
        try:
            self.algorithm.load(content["state"]["algorithm"], None, True)
        except (KeyError, RuntimeError) as error:
            raise ArriveError(f"the networks in {path} do not fit: choose the same ppo.hidden. ({error})") from error
        if self.config.ppo.warm_std > 0.0:
            self.algorithm.get_policy().distribution.log_std_param.data.fill_(math.log(self.config.ppo.warm_std))
        self._average.restart()
        self.env.settle(_reached_levels(content))
        self.look()
        return content["samples"]

    def _load_matching(self, path: Path) -> dict:
        content = load_checked(path)
        if content["robot"] != self.config.robot:
            raise ArriveError(f"{path} was trained for the robot {content['robot']!r}, not {self.config.robot!r}")
        check_schema(content["schema"], self.env.observer.schema(), path)
        return content


def _reached_levels(content: dict) -> dict[str, torch.Tensor]:
    """Levels of a checkpoint's robots by terrain family, 0 for the easiest to 1 for the hardest."""
    terrain, state = from_dict(Config, content["config"]).terrain, content["state"]
    parts = [state["env"]["levels"], *(other["env"]["levels"] for other in state.get("others", ()))]
    levels = torch.cat(parts) / max(terrain.levels - 1, 1)
    family = torch.cat([deal_families(len(part), terrain) for part in parts])
    return {name: levels[family == index] for index, name in enumerate(terrain.families)}
