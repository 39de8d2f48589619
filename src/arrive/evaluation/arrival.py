"""How often a policy arrives: fixed terrain, one episode per robot, no exploration noise."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from arrive.build import OnProgress, Placement, build_env
from arrive.config import Config, RandomisationConfig
from arrive.env import ArriveEnv
from arrive.errors import ArriveError
from arrive.evaluation.episode import Episode
from arrive.evaluation.playing import Pilot, Played, episode, in_part, play
from arrive.evaluation.wilson import wilson_interval
from arrive.learning.policy import Policy
from arrive.memory import check_room
from arrive.task.task import Trial
from arrive.terrain import Family, Layout, parse_families
from arrive.terrain.ground import ground_of
from arrive.terrain.levels import EVALUATION_SEED_OFFSET, level_values

MAX_ENVS = 2000
"""Robots simulated at a time."""
EPISODE_BYTES = 12_000
"""Memory for an episode of 8 s: its positions at each step, and its outcome."""


@dataclass(frozen=True)
class Cell:
    """One family at one value of its parameter."""

    family: Family
    level: int | None
    """Of the policy's own levels, or of a measurement's; None where the value itself was chosen."""
    value: float
    """The terrain's parameter."""
    target: tuple[float, float] | None = None
    """Where a trial sends these robots, in the tile's frame; None for where it sends all [m]."""

    @property
    def caption(self) -> str:
        """The family with its parameter, for people."""
        varies = self.family.lowest != self.family.highest
        return f"{self.family.name} {self.value:.2f} {self.family.unit}" if varies else self.family.name


@dataclass(frozen=True)
class CellResult:
    """How the episodes on one cell went."""

    cell: Cell
    episodes: int
    arrived: int
    median_distance: float
    """Median distance to the target at the end [m]."""
    failures: dict[str, int] = field(default_factory=dict)
    """Episodes per cause of failure."""

    @property
    def success(self) -> float:
        """Share of the episodes that arrived."""
        return self.arrived / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of the success."""
        return wilson_interval(self.arrived, self.episodes)

    @property
    def rate(self) -> str:
        """The success with its interval, for people."""
        low, high = self.interval
        return f"{self.success:.1%} of {self.episodes} ({low:.1%} to {high:.1%})"

    def content(self) -> dict[str, Any]:
        """The result as JSON data."""
        return {
            "value": self.cell.value,
            "episodes": self.episodes,
            "success": self.success,
            "interval": list(self.interval),
            "failures": dict(sorted(self.failures.items())),
        }


@dataclass(frozen=True)
class Conditions:
    """How the episodes of an evaluation differ from those of training."""

    layout: Layout = "training"
    trial: Trial | None = None
    """The same command for every robot; None for the task's own commands."""
    randomise: Callable[[RandomisationConfig], RandomisationConfig] = lambda config: config
    variants: int | None = None
    """Worlds per value of a family's parameter; None for as many as in training."""
    record: bool = True
    """Whether an episode per cell is recorded for pictures."""


@dataclass(frozen=True)
class Arrival:
    """The evaluation's answer."""

    results: list[CellResult]
    cell_of_episode: Tensor
    """(episodes,) index into `results`."""
    played: list[Played]
    """All episodes, in parts."""
    episodes: list[Episode]
    """One recorded episode per cell, for pictures."""


def cells_of(config: Config, families: Sequence[Family], level: int | None = None) -> list[Cell]:
    """The families' cells at one level, or at all for None.

    Raises:
        ArriveError: the level is out of range.
    """
    cells = []
    for family in families:
        values = level_values(family, config.terrain.levels)
        chosen = range(len(values)) if level is None else [_checked(level, family, config.terrain.levels, len(values))]
        cells += [Cell(family, i, values[i]) for i in chosen]
    return cells


def choose_cells(
    config: Config, terrain: str | None, level: int | None = None, value: float | None = None
) -> list[tuple[Family, Cell | None]]:
    """The families that a person names on the command line, each with the one cell that was chosen, if any.

    Args:
        terrain: families joined by commas, each as NAME or NAME=VALUE, or `all`; None for those of the training.
        level: one of the policy's own levels, of every family without a value.
        value: of the only family's parameter.

    Raises:
        ArriveError: no such family or level, a value out of range, or several of these at once.
    """
    listed = ",".join(config.terrain.families) if terrain is None else terrain
    if value is not None:
        if "," in listed or "=" in listed or listed.strip() == "all":
            raise ArriveError(f"--value is of one terrain; write --terrain NAME=VALUE for each, not {listed} --value")
        listed = f"{listed}={value:g}"
    families = parse_families(",".join(item.partition("=")[0] for item in listed.split(",")))
    items = [family.name for family in families] if listed.strip() == "all" else listed.split(",")
    chosen: list[tuple[Family, Cell | None]] = []
    for family, item in zip(families, items, strict=True):
        if "=" in item:
            chosen.append((family, Cell(family, None, ground_of(item, level).value)))
        else:
            chosen.append((family, None if level is None else cells_of(config, [family], level)[0]))
    return chosen


def _checked(level: int, family: Family, num_levels: int, available: int) -> int:
    """The level, or the only one of a family that has no other."""
    if not 0 <= level < num_levels:
        raise ArriveError(f"level {level} of {family.name} is out of range: levels are 0 to {num_levels - 1}")
    return min(level, available - 1)


def evaluate(
    policy: Policy,
    cells: Sequence[Cell],
    episodes: int,
    seed: int,
    threads: int = 0,
    progress: OnProgress = lambda done, total: None,
    setting: Conditions = Conditions(),
    pilot: Callable[[ArriveEnv], Pilot] | None = None,
) -> Arrival:
    """Measure the success rate on terrain that the policy was not trained on.

    But for the setting, commands, friction, payload and pushes are those of its training; every episode has the full
    noise, the full length and one target.

    Args:
        episodes: per cell.
        progress: called with the policy steps done so far and their total.
        pilot: makes what acts for the robots of an environment in the policy's place.

    Raises:
        ArriveError: nothing to measure, or a policy of another robot or observation.
    """
    if episodes < 1:
        raise ArriveError(f"episodes must be at least 1, not {episodes}")
    check_room(len(cells) * episodes, EPISODE_BYTES, "episodes", "--episodes")
    cell_of_episode = torch.arange(len(cells)).repeat_interleave(episodes)
    parts = cell_of_episode.split(MAX_ENVS)
    played: list[Played] = []
    pictures: dict[int, Episode] = {}
    for index, part in enumerate(parts):
        env = _environment(policy, cells, part, _part_seed(seed, index), threads, setting)
        policy.check(env)
        watched = _one_per_cell(part, pictures) if setting.record else torch.tensor([], dtype=torch.long)
        acting = policy if pilot is None else pilot(env)
        played.append(play(env, acting, watched, in_part(progress, index, len(parts))))
        for column, env_id in enumerate(watched.tolist()):
            cell = int(part[env_id])
            pictures[cell] = episode(env, played[-1], column, cells[cell].caption)
    return Arrival(_tabulate(cells, cell_of_episode, played), cell_of_episode, played, list(pictures.values()))


def _part_seed(seed: int, index: int) -> int:
    """Seed of one part of an evaluation; neighbouring seeds share no part."""
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0])


def _environment(
    policy: Policy, cells: Sequence[Cell], part: Tensor, seed: int, threads: int, setting: Conditions
) -> ArriveEnv:
    """Robots that stay on their assigned cells, on the policy's device."""
    config = policy.config
    present = sorted(set(part.tolist()))
    families = list(dict.fromkeys(cells[i].family.name for i in present))
    values = {
        name: list(dict.fromkeys(cells[i].value for i in present if cells[i].family.name == name)) for name in families
    }
    family = torch.tensor([families.index(cells[i].family.name) for i in part.tolist()])
    level = torch.tensor([values[cells[i].family.name].index(cells[i].value) for i in part.tolist()])
    config = replace(
        config,
        num_envs=len(part),
        seed=seed,
        terrain=replace(config.terrain, families=tuple(families), variants=setting.variants or config.terrain.variants),
        observation=replace(config.observation, noise_least=1.0),
        randomisation=setting.randomise(config.randomisation),
        task=config.task.measured(),
    )
    placement = Placement(
        layout=setting.layout,
        trial=_trial(setting.trial, [cells[i] for i in part.tolist()]),
        values=tuple(tuple(values[name]) for name in families),
        seed_offset=EVALUATION_SEED_OFFSET,
        assignment=(family.to(policy.device), level.to(policy.device)),
    )
    return build_env(config, placement, threads)


def _trial(trial: Trial | None, cells: Sequence[Cell]) -> Trial | None:
    """The trial with a target for each robot, where its cell has one."""
    if trial is None or all(cell.target is None for cell in cells):
        return trial
    return replace(trial, target=torch.tensor([cell.target or trial.target for cell in cells]))


def _one_per_cell(part: Tensor, known: dict[int, Episode]) -> Tensor:
    """The first robot of every cell that has no picture yet."""
    cells, first = np.unique(part.numpy(), return_index=True)
    new = [i for cell, i in zip(cells.tolist(), first.tolist(), strict=True) if cell not in known]
    return torch.tensor(new, dtype=torch.long)


def _tabulate(cells: Sequence[Cell], cell_of_episode: Tensor, played: Sequence[Played]) -> list[CellResult]:
    success = torch.cat([part.success for part in played])
    distance = torch.cat([part.distance for part in played])
    cause = np.array([name for part in played for name in part.cause])
    results = []
    for index, cell in enumerate(cells):
        mine = cell_of_episode == index
        failures = Counter(name for name in cause[mine.numpy()].tolist() if name)
        results.append(
            CellResult(cell, int(mine.sum()), int(success[mine].sum()), float(distance[mine].median()), dict(failures))
        )
    return results
