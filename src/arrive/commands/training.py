"""`arrive train`: a new run, or one that goes on."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from rich.progress import Progress

from arrive.build import Placement, build_env
from arrive.commands.threads import use_threads
from arrive.config import Config
from arrive.errors import ArriveError
from arrive.learning.checkpoint import CHECKPOINT_NAME
from arrive.learning.curves import plot_curves
from arrive.learning.display import TrainingDisplay
from arrive.learning.logs import RunLog
from arrive.learning.ranks import join_ranks
from arrive.learning.rundir import new_run_folder, read_config, samples_before, write_config
from arrive.learning.trainer import Trainer
from arrive.physics.device import choose_device, describe_device
from arrive.recipe import make_config
from arrive.terrain import parse_families

if TYPE_CHECKING:
    from arrive.cli import Train

DEFAULT_MINUTES = 40.0
"""Training budget where none is given [min]."""


def train(command: Train) -> None:
    """Train a new run or continue one."""
    threads = use_threads(command.threads)
    minutes, iterations, samples = _budget(command)
    device = choose_device(command.device)
    ranks = join_ranks(device)
    # Rank 0 alone makes the folder; the others take what it has found.
    config, folder = ranks.share((_resumed if command.resume else _fresh)(command) if ranks.leads else None)
    if ranks.leads:
        together = f", {ranks.count} processes" if ranks.count > 1 else ""
        print(describe_device(device, command.device, threads, config.physics.engine) + together)
    with Progress(transient=True, disable=not ranks.leads) as bar:
        worlds = bar.add_task("building terrain", total=None)
        env = build_env(
            config,
            Placement(seed_offset=ranks.seed_offset),
            threads,
            lambda i, n: bar.update(worlds, completed=i, total=n),
            device,
        )
    trainer = Trainer(config, env, folder, ranks)
    if samples is not None:
        iterations = math.ceil(samples / trainer.batch)
    before = 0
    if command.resume:
        trainer.load()
    elif command.start_from:
        before = trainer.warm_start(command.start_from / CHECKPOINT_NAME)
        before += samples_before(read_config(command.start_from)[1])
    if ranks.leads:
        _train_and_show(command, trainer, minutes, iterations, before)
    else:
        trainer.train(minutes, iterations, lambda result: None)
    ranks.leave()


def _train_and_show(
    command: Train, trainer: Trainer, minutes: float | None, iterations: int | None, before: int
) -> None:
    """Train with the display, the log and the curves."""
    config, folder = trainer.config, trainer.folder
    log = RunLog(folder)
    if command.resume:
        log.truncate_after(trainer.iteration)
    else:
        write_config(folder, config, before)  # last, so that a start that failed leaves the folder free
    title = f"{config.robot}, {','.join(config.terrain.families)}, {config.preset}, {config.task.name}"
    with TrainingDisplay(title, folder) as display:

        def report(result) -> None:
            log.write(result)
            display.update(result)

        trainer.train(minutes, iterations, report)
    log.close()
    if trainer.iteration:
        print(f"curves: {plot_curves(folder)}")
    print(f"run: {folder} ({trainer.iteration} iterations, {trainer.samples / 1e6:.1f} M samples)")


def _budget(command: Train) -> tuple[float | None, int | None, float | None]:
    """Minutes, iterations and samples; whichever is spent first ends the run."""
    samples = None if command.samples is None else _parse_samples(command.samples)
    budget = {"minutes": command.minutes, "iterations": command.iterations, "samples": samples}
    for name, value in budget.items():
        if value is not None and not 0 < value < math.inf:
            raise ArriveError(f"--{name} must be positive, not {value}")
    if samples is not None and command.iterations is not None:
        raise ArriveError("give --samples or --iterations, not both")
    if all(value is None for value in budget.values()):
        return DEFAULT_MINUTES, None, None
    return command.minutes, command.iterations, samples


def _parse_samples(text: str) -> float:
    """The number that 40M, 500k or 1e6 stands for."""
    factor = {"k": 1e3, "M": 1e6, "G": 1e9}.get(text[-1:], 1.0)
    try:
        return float(text[:-1] if factor > 1.0 else text) * factor
    except ValueError:
        raise ArriveError(f"--samples must be a number such as 40M, 500k or 1e6, not {text!r}") from None


def _fresh(command: Train) -> tuple[Config, Path]:
    families = parse_families(command.terrain)
    config = make_config(families, command.preset, command.task, command.num_envs, command.seed, command.set)
    return config, new_run_folder(config, command.out)


def _resumed(command: Train) -> tuple[Config, Path]:
    """The configuration of the run to continue; asking for another one at the same time is an error."""
    folder = command.resume
    config, _ = read_config(folder)
    names = tuple(family.name for family in parse_families(command.terrain))
    if names != config.terrain.families:
        raise ArriveError(f"{folder} trains on {','.join(config.terrain.families)}, not {command.terrain}")
    present = {"preset": config.preset, "task": config.task.name, "num_envs": config.num_envs, "seed": config.seed}
    changed = [name for name, value in present.items() if getattr(command, name) not in (None, value)]
    changed += [name for name in ("set", "start_from", "out") if getattr(command, name)]
    if changed:
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in changed)
        raise ArriveError(f"a resumed run keeps its configuration: --resume goes without another {flags}")
    return config, folder
