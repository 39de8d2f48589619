"""What each command does."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from arrive.build import build_env
from arrive.config import Config, override, to_dict
from arrive.errors import ArriveError, unknown_name
from arrive.evaluation import difficulty
from arrive.evaluation.arrival import Arrival, CellResult, cells_of
from arrive.evaluation.arrival import evaluate as evaluate_policy
from arrive.evaluation.diagnosis import why_stuck
from arrive.evaluation.graphics import GraphicsUnavailable
from arrive.evaluation.pictures import Episode, film, picture_strip
from arrive.evaluation.policy import Policy, load_policy
from arrive.evaluation.records import DIFFICULTY_NAME, DIFFICULTY_PICTURES
from arrive.evaluation.report import write_report
from arrive.learning.checkpoint import CHECKPOINT_NAME
from arrive.learning.curves import plot_curves
from arrive.learning.display import TrainingDisplay
from arrive.learning.logs import RunLog
from arrive.learning.rundir import new_run_folder, read_config, write_config
from arrive.learning.trainer import Trainer
from arrive.presets import PRESETS, get_preset
from arrive.robots import ROBOTS
from arrive.task.registry import TASKS, get_task
from arrive.task.rewards import CRASH_COST
from arrive.terrain import FAMILIES, parse_families
from arrive.validate import validate

if TYPE_CHECKING:
    from arrive.cli import Eval, Export, List, Report, Train, Verify

DEFAULT_PRESET = "robust"
DEFAULT_MINUTES = 40.0
"""Training budget where none is given [min]."""


def train(command: Train) -> None:
    """Train a new run or continue one."""
    threads = _use_threads(command.threads)
    minutes, iterations = _budget(command)
    config, folder = _resumed(command) if command.resume else _fresh(command)
    with Progress(transient=True) as bar:
        worlds = bar.add_task("building terrain", total=None)
        env = build_env(config, threads=threads, progress=lambda i, n: bar.update(worlds, completed=i, total=n))
    trainer = Trainer(config, env, folder)
    log = RunLog(folder)
    if not command.resume:
        write_config(folder, config)
    if command.resume:
        trainer.load()
        log.truncate_after(trainer.iteration)
    elif command.start_from:
        trainer.warm_start(command.start_from / CHECKPOINT_NAME)
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


def _use_threads(threads: int) -> int:
    """Give torch as many threads as physics; MuJoCo's and torch's threads take turns."""
    if threads < 0:
        raise ArriveError(f"--threads must be 0 or more, not {threads}")
    threads = threads or len(os.sched_getaffinity(0))
    torch.set_num_threads(threads)
    return threads


def _budget(command: Train) -> tuple[float | None, int | None]:
    for name, value in (("minutes", command.minutes), ("iterations", command.iterations)):
        if value is not None and not 0 < value < math.inf:
            raise ArriveError(f"--{name} must be positive, not {value}")
    if command.minutes is None and command.iterations is None:
        return DEFAULT_MINUTES, None
    return command.minutes, command.iterations


def _fresh(command: Train) -> tuple[Config, Path]:
    config = get_preset(command.preset or DEFAULT_PRESET)
    names = tuple(family.name for family in parse_families(command.terrain))
    task = command.task or config.task.name
    changes: dict = {
        "terrain": dataclasses.replace(config.terrain, families=names),
        "seed": 1 if command.seed is None else command.seed,
        "task": dataclasses.replace(config.task, name=task),
    }
    if command.num_envs is not None:
        changes["num_envs"] = command.num_envs
    config = get_task(task).configure(dataclasses.replace(config, **changes))
    config = override(config, command.set)
    validate(config)
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


def evaluate(command: Eval) -> None:
    """Measure policies, print tables and what they fail at, and write JSON and pictures."""
    if command.json and command.others:
        raise ArriveError("--json takes the result of one policy; measure several one by one")
    # Small networks gain little from torch's threads, lose six times the speed where the machine is busy, and one
    # thread gives the same sums on every machine of a kind.
    threads = _use_threads(command.threads)
    torch.set_num_threads(1)
    measure = {"arrival": _evaluate_arrival, "difficulty": _evaluate_difficulty}[command.protocol]
    for path in (command.policy, *command.others):
        measure(command, load_policy(path), threads)


def _evaluate_arrival(command: Eval, policy: Policy, threads: int) -> None:
    if command.levels is not None:
        raise ArriveError("--levels goes with --protocol difficulty; choose one level of training with --level")
    families = parse_families(command.terrain or ",".join(policy.config.terrain.families))
    cells = cells_of(policy.config, families, command.level)
    with Progress(transient=True) as bar:
        steps = bar.add_task(f"{len(cells)} x {command.episodes} episodes", total=None)
        answer = evaluate_policy(
            policy, cells, command.episodes, command.seed, threads, lambda i, n: bar.update(steps, completed=i, total=n)
        )
    _print_results(answer.results)
    for family in families:
        print(why_stuck([result for result in answer.results if result.cell.family is family]))
    if command.json:
        _write_json(command.json, _arrival_content(command, policy, answer))
    _write_pictures(command.pictures or policy.path.parent / "pictures", answer.episodes, with_film=True)


def _evaluate_difficulty(command: Eval, policy: Policy, threads: int) -> None:
    if command.level is not None:
        raise ArriveError("--level goes with --protocol arrival; choose how many levels with --levels")
    difficulty.check_arguments(command.episodes, command.levels)
    families = parse_families(command.terrain or ",".join(policy.config.terrain.families))
    folder = policy.path.parent
    with Progress() as bar:
        steps = bar.add_task(f"{folder.name}: {command.episodes} episodes per level", total=None)
        answer = difficulty.measure(
            policy,
            families,
            command.episodes,
            command.seed,
            command.levels,
            threads,
            lambda i, n: bar.update(steps, completed=i, total=n),
        )
    _print_results([result for results in answer.results.values() for result in results])
    for results in answer.results.values():
        print(why_stuck(results))
    _write_json(command.json or folder / DIFFICULTY_NAME, answer.content)
    pictures = command.pictures or folder / DIFFICULTY_PICTURES
    _write_pictures(pictures, answer.episodes, names=list(answer.results))


def _print_results(results: list[CellResult]) -> None:
    table = Table("terrain", "level", "parameter", "episodes", "arrived", "95 % interval", "failures")
    for result in results:
        low, high = result.interval
        unit = result.cell.family.unit
        table.add_row(
            result.cell.family.name,
            str(result.cell.level),
            f"{result.cell.value:.3g} {unit}".strip() if unit else "",
            str(result.episodes),
            f"{result.success:.1%}",
            f"{low:.1%} to {high:.1%}",
            ", ".join(f"{cause} {count}" for cause, count in sorted(result.failures.items())),
        )
    Console().print(table)


def _arrival_content(command: Eval, policy: Policy, answer: Arrival) -> dict:
    families: dict[str, dict] = {}
    for result in answer.results:
        family = result.cell.family
        entry = families.setdefault(family.name, {"parameter": family.parameter, "unit": family.unit, "levels": []})
        entry["levels"].append(
            {
                "level": result.cell.level,
                "value": result.cell.value,
                "episodes": result.episodes,
                "success": result.success,
                "interval": list(result.interval),
                "median_distance_m": result.median_distance,
                "failures": result.failures,
            }
        )
    return {
        "families": families,
        "policy": {"samples": policy.samples, "config": to_dict(policy.config)},
        "protocol": {"name": "arrival", "episodes": command.episodes, "seed": command.seed},
        "commit": policy.commit,
    }


def _write_json(path: Path, content: dict) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content, indent=2) + "\n")
    except OSError as error:
        raise ArriveError(f"cannot write {path}: {error}") from error
    print(f"result: {path}")


def _write_pictures(
    folder: Path, episodes: list[Episode], names: list[str] | None = None, with_film: bool = False
) -> None:
    """A strip per episode and, if asked, a film of the first; or one line where no graphics library is present."""
    names = names or [episode.caption.replace(" ", "_") for episode in episodes]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, episode in zip(names, episodes, strict=True):
            picture_strip(episode, folder / f"{name}.png")
        if with_film:
            film(episodes[0], folder / f"{names[0]}.mp4")
    except GraphicsUnavailable as error:
        print(error)
    except OSError as error:
        raise ArriveError(f"cannot write pictures to {folder}: {error}") from error
    else:
        print(f"pictures: {folder}")


def report(command: Report) -> None:
    """Write the report page and its JSON file."""
    for path in write_report((command.run, *command.others), command.out):
        print(f"report: {path}")


def export(command: Export) -> None:
    """Write a policy for a robot's computer."""
    _need_onnxruntime()
    from arrive.deployment.export import export_policy

    policy = load_policy(command.policy)
    export_policy(policy, command.out)
    print(f"exported: {command.out} ({policy.config.robot}, {policy.config.task.name}, commit {policy.commit})")


def verify_file(command: Verify) -> None:
    """Check an exported policy and say what it is."""
    _need_onnxruntime()
    from arrive.deployment.verify import verify

    file = verify(command.file)
    pairs = len(file.meta["golden"]["actions"])
    print(
        f"{command.file} is sound: {file.robot.name}, {len(file.robot.joint_names)} joints, {file.terms[-1].stop} "
        f"observations, task {file.task.name}, {1.0 / file.period_s:.0f} Hz, {pairs} golden pairs met"
    )


def _need_onnxruntime() -> None:
    if importlib.util.find_spec("onnxruntime") is None:
        raise ArriveError("this needs onnxruntime: pip install 'arrive[deploy]'")


def list_names(command: List) -> None:
    """Print what can be chosen by name."""
    names = {
        "terrains": {f.name: _describe(f) for f in FAMILIES.values()},
        "presets": {name: _first_line(build) for name, build in PRESETS.items()},
        "robots": {name: robot.description for name, robot in ROBOTS.items()},
        "tasks": {name: _first_line(task) for name, task in TASKS.items()},
        "rewards": {name: _first_line(term) for task in TASKS.values() for name, term in task.rewards.items()}
        | {CRASH_COST: "Paid once, at a crash."},
    }
    if command.what is not None and command.what not in names:
        raise unknown_name("list", command.what, names)
    for kind in [command.what] if command.what else names:
        table = Table(title=kind, title_justify="left", show_header=False, box=None)
        for name, description in names[kind].items():
            table.add_row(name, description)
        Console().print(table)


def _describe(family) -> str:
    if family.lowest == family.highest:
        return family.description
    return f"{family.description} ({family.parameter} {family.lowest:g} to {family.highest:g} {family.unit})"


def _first_line(thing) -> str:
    return (thing.__doc__ or "").strip().splitlines()[0]
