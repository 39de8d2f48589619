"""Statistics of the rewards and the recently finished episodes."""

from collections import deque
from typing import Any

import torch
from torch import Tensor

from arrive.env import ArriveEnv, StepLog
from arrive.learning.report import FamilyReport

WINDOW_ITERATIONS = 20
"""The success rate is a moving average over the episodes that finished in this many iterations."""


class TrainingStatistics:
    """Collects rewards and outcomes of an iteration's steps."""

    def __init__(self, env: ArriveEnv):
        self._names = [family.name for family in env.pool.families]
        self._recent: deque[dict[str, list[float]]] = deque(maxlen=WINDOW_ITERATIONS)
        self._recent_ends: deque[tuple[int, int]] = deque(maxlen=WINDOW_ITERATIONS)
        self.diverged = 0
        """Number of simulations that diverged since the run started."""
        self._begin()

    def _begin(self) -> None:
        zeros = [0.0] * len(self._names)
        self._now: dict[str, list[float]] = {"episodes": list(zeros), "success": list(zeros)}
        self._rewards: dict[str, float] = {}
        self._steps = 0
        self._diverged, self._ended = 0, 0

    def take(self, env: ArriveEnv, log: StepLog) -> None:
        """Add one step."""
        self._steps += 1
        self.diverged += log.diverged
        self._diverged += log.diverged
        for name, value in log.rewards.items():
            self._rewards[name] = self._rewards.get(name, 0.0) + float(value.mean())
        if log.finished is None:
            return
        self._ended += len(log.finished.env_ids)
        counted = log.finished.counted
        family = env.family_of_env[log.finished.env_ids]
        for name, mask in {"success": log.finished.success, **log.finished.failures}.items():
            self._add(name, family[mask & counted])
        self._add("episodes", family[counted])

    def _add(self, name: str, families: Tensor) -> None:
        counts = torch.bincount(families, minlength=len(self._names)).tolist()
        row = self._now.setdefault(name, [0.0] * len(self._names))
        self._now[name] = [a + b for a, b in zip(row, counts, strict=True)]

    def finish_iteration(self) -> dict[str, float]:
        """Close the iteration and return the mean weighted reward of each term per step."""
        rewards = {name: total / max(self._steps, 1) for name, total in self._rewards.items()}
        self._recent.append(self._now)
        self._recent_ends.append((self._diverged, self._ended))
        self._begin()
        return rewards

    def _total(self, name: str, family: int | None = None) -> float:
        rows = [row.get(name, [0.0] * len(self._names)) for row in self._recent]
        return sum(sum(row) if family is None else row[family] for row in rows)

    def arrival(self, family: int | None = None) -> float:
        """Success rate of the recent episodes, NaN before the first one."""
        episodes = self._total("episodes", family)
        return self._total("success", family) / episodes if episodes else float("nan")

    def diverged_share(self) -> float:
        """Share of the recent episodes whose simulation diverged; 0 before the first one."""
        diverged, ended = (sum(counts) for counts in zip(*self._recent_ends, strict=True))
        return min(diverged / ended, 1.0) if ended else 0.0

    def failures(self, family: int | None = None) -> dict[str, float]:
        """Share of the recent episodes per cause of failure."""
        episodes = self._total("episodes", family)
        causes = {name for row in self._recent for name in row} - {"episodes", "success"}
        return {name: self._total(name, family) / episodes for name in sorted(causes)} if episodes else {}

    def families(self, env: ArriveEnv) -> dict[str, FamilyReport]:
        """Success rate, levels and failures per terrain family."""
        reports = {}
        for index, name in enumerate(self._names):
            levels = env.curriculum.levels[env.family_of_env == index]
            histogram = torch.bincount(levels, minlength=env.pool.num_levels[index])
            reports[name] = FamilyReport(
                arrival=self.arrival(index),
                mean_level=float(levels.float().mean()),
                levels=tuple(histogram.tolist()),
                failures=self.failures(index),
            )
        return reports

    def state_dict(self) -> dict[str, Any]:
        return {"recent": list(self._recent), "ends": list(self._recent_ends), "diverged": self.diverged}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self._recent = deque(state["recent"], maxlen=WINDOW_ITERATIONS)
        self._recent_ends = deque(state["ends"], maxlen=WINDOW_ITERATIONS)
        self.diverged = state["diverged"]
        self._begin()
