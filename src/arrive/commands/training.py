"""`arrive train`: start or resume a run."""

from __future__ import annotations

import math
import shlex
from contextlib import closing, nullcontext
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from rich.progress import Progress

from arrive.build import Placement, build_env
from arrive.commands.films import Films
from arrive.commands.policies import read_policy
from arrive.commands.threads import use_threads
from arrive.config import Config
from arrive.env import ArriveEnv
from arrive.errors import ArriveError, Interrupted
from arrive.learning.checkpoint import CHECKPOINT_NAME
from arrive.learning.display import TrainingDisplay, count
from arrive.learning.logs import RunLog
from arrive.learning.ranks import Ranks, join_ranks
from arrive.learning.report import IterationReport
from arrive.learning.rundir import (
    check_free,
    new_run_folder,
    owned,
    read_config,
    samples_before,
    write_config,
)
from arrive.learning.trainer import Budget, Trainer
from arrive.lock import Lock
from arrive.physics.device import choose_device, describe_device
from arrive.plugins import import_options
from arrive.policies import CONFIG_NAME, find_policy
from arrive.recipe import make_config
from arrive.terrain import parse_families

if TYPE_CHECKING:
    from arrive.commands.options import Train

DEFAULT_MINUTES = 40.0
"""Default training budget [min]."""

NOT_IN_THE_RUN = ("minutes", "samples", "iterations", "threads", "device", "logger", "film_minutes")
"""Options that a run does not keep, so that they are given again when it is resumed."""


def train(command: Train) -> None:
    """Start a new run or resume one.

    Raises:
        ArriveError: it cannot start or cannot continue.
        Interrupted: it was interrupted; the message says how to continue.
    """
    threads = use_threads(command.threads)
    budget = _budget(command)
    device = choose_device(command.device)
    ranks = join_ranks(device)
    # Only rank 0 makes the folder. The other ranks get its result.
    config, folder = ranks.share(
        (_resumed(command, command.resume) if command.resume else _fresh(command)) if ranks.leads else None
    )
    with owned(folder) if ranks.leads else nullcontext() as lock:
        if ranks.leads and not command.resume:
            check_free(folder)  # again, because another process may have held the lock until now
        try:
            interrupted = _train(command, _Run(config, folder, ranks, device, threads, budget, lock))
        except KeyboardInterrupt:
            raise Interrupted(f"interrupted; {_how_to_go_on(command, folder)}") from None
    ranks.leave()
    if interrupted and ranks.leads:
        raise Interrupted(f"interrupted; {_how_to_go_on(command, folder)}")


@dataclass(frozen=True)
class _Run:
    """Configuration, folder, lock and processes of a run."""

    config: Config
    folder: Path
    ranks: Ranks
    device: torch.device
    threads: int
    budget: Budget
    lock: Lock | None
    """Lock of the folder; None in processes that do not write."""


def _train(command: Train, run: _Run) -> bool:
    """Build, load and train. Returns whether a signal ended it before its budget was spent."""
    if run.ranks.leads:
        together = f", {run.ranks.count} processes" if run.ranks.count > 1 else ""
        print(describe_device(run.device, command.device, run.threads, run.config.physics.engine) + together)
    # Read before anything is built, because it may be damaged.
    log = RunLog(run.folder, command.logger) if run.ranks.leads else None
    trainer = Trainer(run.config, _build(run), run.folder, run.ranks)
    before = 0
    if command.resume:
        trainer.load()
    elif command.start_from:
        before = _begin_from(trainer, find_policy(command.start_from))
    lock = run.lock
    if log is None or lock is None:
        trainer.train(run.budget, lambda result: None)
        return trainer.interrupted
    lock.check()
    if command.resume:
        log.resume_at(trainer.state.iteration)
    else:
        write_config(run.folder, run.config, before)  # last, so that a start that failed leaves the folder free
    log.describe(run.config)
    _train_and_show(command, run, trainer, log, lock)
    return trainer.interrupted


def _begin_from(trainer: Trainer, start: Path) -> int:
    """Take another run's networks. Returns the policy steps of all runs before this one."""
    checkpoint = start / CHECKPOINT_NAME
    samples = trainer.warm_start(checkpoint if checkpoint.is_file() else read_policy(start))
    return samples + (samples_before(read_config(start)[1]) if (start / CONFIG_NAME).is_file() else 0)


def _build(run: _Run) -> ArriveEnv:
    with Progress(transient=True, disable=not run.ranks.leads) as bar:
        worlds = bar.add_task("building terrain", total=None)
        return build_env(
            run.config,
            Placement(seed_offset=run.ranks.seed_offset),
            run.threads,
            lambda i, n: bar.update(worlds, completed=i, total=n),
            run.device,
            learning=True,
        )


def _train_and_show(command: Train, run: _Run, trainer: Trainer, log: RunLog, lock: Lock) -> None:
    """Train with the display, the log and the curves."""
    config, folder = run.config, run.folder

    def before_save() -> None:
        lock.check()
        log.flush()

    title = f"{config.robot}, {','.join(config.terrain.families)}, {config.preset}, {config.task.name}"
    with (
        closing(log),
        TrainingDisplay(title, folder) as display,
        closing(Films(folder, command.film_minutes, display.say)) as films,
    ):

        def report(result: IterationReport) -> None:
            log.write(result)
            display.update(result)
            films.tick(result)

        trainer.train(run.budget, report, before_save)
    if trainer.state.iteration:
        # Imported here because loading matplotlib would delay the start.
        from arrive.learning.curves import plot_curves

        print(f"curves: {plot_curves(folder)}")
    print(f"run: {folder} ({trainer.state.iteration} iterations, {count(trainer.state.samples)} samples)")


def _how_to_go_on(command: Train, folder: Path) -> str:
    """The command that continues after Ctrl-C."""
    if not (folder / CHECKPOINT_NAME).exists():
        return "nothing was trained yet: run the same command again"
    words = ["arrive", "train", command.terrain, "--resume", str(folder)]
    for option in fields(command):
        value = getattr(command, option.name)
        if option.name in NOT_IN_THE_RUN and value != option.default:
            words += [f"--{option.name.replace('_', '-')}", str(value)]
    words += import_options()
    return f"resume from the last checkpoint with: {shlex.join(words)}"


def _budget(command: Train) -> Budget:
    """Minutes, iterations and samples. The one that is spent first ends the run."""
    samples = None if command.samples is None else _parse_samples(command.samples)
    budget = Budget(command.minutes, command.iterations, samples)
    return budget if any(vars(budget).values()) else Budget(DEFAULT_MINUTES)


def _parse_samples(text: str) -> float:
    """The number that 40M, 500k or 1e6 stands for."""
    factor = {"k": 1e3, "M": 1e6, "G": 1e9}.get(text[-1:], 1.0)
    try:
        samples = float(text[:-1] if factor > 1.0 else text) * factor
    except ValueError:
        samples = math.nan
    if not 0.0 < samples < math.inf:
        raise ArriveError(f"--samples must be a positive number such as 40M, 500k or 1e6, not {text!r}")
    return samples


def _fresh(command: Train) -> tuple[Config, Path]:
    families, base = parse_families(command.terrain), None
    if command.config:
        if command.preset or command.task or command.robot:
            raise ArriveError("--config has its own preset, task and robot: give either it or these options")
        base, _ = read_config(command.config)
    config = make_config(
        families, command.preset, command.task, command.num_envs, command.seed, command.set, command.robot, base
    )
    return config, new_run_folder(config, command.out)


def _resumed(command: Train, folder: Path) -> tuple[Config, Path]:
    """The configuration of the run to resume. Options that would change it are an error."""
    config, _ = read_config(folder)
    if not (folder / CHECKPOINT_NAME).is_file():
        raise ArriveError(
            f"{folder} has no {CHECKPOINT_NAME}, because its start was interrupted; start it again with --out {folder}"
        )
    names = tuple(family.name for family in parse_families(command.terrain))
    if names != config.terrain.families:
        raise ArriveError(f"{folder} trains on {','.join(config.terrain.families)}, not {command.terrain}")
    present = {
        "preset": config.preset,
        "robot": config.robot,
        "task": config.task.name,
        "num_envs": config.num_envs,
        "seed": config.seed,
    }
    changed = [name for name, value in present.items() if getattr(command, name) not in (None, value)]
    changed += [name for name in ("set", "config", "start_from", "out") if getattr(command, name)]
    if changed:
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in changed)
        raise ArriveError(f"a resumed run keeps its configuration: leave out {flags}")
    return config, folder
