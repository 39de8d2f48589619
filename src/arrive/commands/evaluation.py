"""`arrive eval` and `arrive report`: what policies can do."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import torch
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from arrive.commands.files import write_json
from arrive.commands.threads import use_threads
from arrive.config import to_dict
from arrive.errors import ArriveError
from arrive.evaluation import difficulty
from arrive.evaluation.arrival import Arrival, CellResult, cells_of
from arrive.evaluation.arrival import evaluate as evaluate_policy
from arrive.evaluation.episode import Episode
from arrive.learning.policy import Policy, load_policy
from arrive.learning.rundir import CONFIG_NAME, DIFFICULTY_NAME
from arrive.physics.device import choose_device, describe_device
from arrive.render.graphics import GraphicsUnavailable
from arrive.render.pictures import film, picture_strip
from arrive.report.card import write_card
from arrive.report.diagnosis import why_stuck
from arrive.report.records import DIFFICULTY_PICTURES, read_run
from arrive.report.write import write_report
from arrive.terrain import parse_families

if TYPE_CHECKING:
    from arrive.commands.options import Eval, Report


def evaluate(command: Eval) -> None:
    """Measure policies, print tables and what they fail at, and write JSON and pictures."""
    if command.json and command.others:
        raise ArriveError("--json takes the result of one policy; measure several one by one")
    # Small networks gain little from torch's threads, lose six times the speed where the machine is busy, and one
    # thread gives the same sums on every machine of a kind.
    threads = use_threads(command.threads)
    torch.set_num_threads(1)
    device = choose_device(command.device)
    print(describe_device(device, command.device, threads))
    measure = {"arrival": _evaluate_arrival, "difficulty": _evaluate_difficulty}[command.protocol]
    for path in (command.policy, *command.others):
        measure(command, load_policy(path, device), threads)


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
        write_json(command.json, _arrival_content(command, policy, answer))
    _write_pictures(command.pictures or policy.path.parent / "pictures", answer.episodes, films=1)


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
    write_json(command.json or folder / DIFFICULTY_NAME, answer.content)
    pictures = command.pictures or folder / DIFFICULTY_PICTURES
    _write_pictures(pictures, answer.episodes, len(families), names=list(answer.results))
    if command.json is None and (folder / CONFIG_NAME).is_file():
        print(f"card: {write_card(read_run(folder), folder)}")


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
        own = {"level": result.cell.level, "median_distance_m": result.median_distance}
        entry["levels"].append(own | result.content())
    return {
        "families": families,
        "policy": {"samples": policy.samples, "config": to_dict(policy.config)},
        "protocol": {"name": "arrival", "episodes": command.episodes, "seed": command.seed},
        "commit": policy.commit,
    }


def _write_pictures(folder: Path, episodes: list[Episode], films: int, names: list[str] | None = None) -> None:
    """A strip per episode and films of the first ones; or one line where no graphics library is present."""
    names = names or [episode.caption.replace(" ", "_") for episode in episodes]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, episode in zip(names, episodes, strict=True):
            picture_strip(episode, folder / f"{name}.png")
        for name, episode in zip(names[:films], episodes, strict=False):
            film(episode, folder / f"{name}.mp4")
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
