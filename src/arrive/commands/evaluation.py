"""`arrive eval` and `arrive report`: success rates of policies."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from arrive.commands.files import write_result
from arrive.commands.policies import read_policy
from arrive.commands.results import keep_longer, keep_others
from arrive.commands.threads import use_threads
from arrive.config import to_dict
from arrive.errors import ArriveError
from arrive.evaluation import difficulty, reach
from arrive.evaluation.arrival import Arrival, Cell, CellResult, Conditions, cells_of, choose_cells, evaluate
from arrive.evaluation.difficulty import difficulty_cells, policy_content, telling
from arrive.evaluation.episode import Episode
from arrive.evaluation.reach import REACH_NAME, ReachGrid, check_policy, effort, hardest_solved, measure_reach
from arrive.files import check_writable
from arrive.learning.policy import Policy
from arrive.learning.rundir import commit
from arrive.physics.device import choose_device, describe_device
from arrive.policies import CONFIG_NAME, DIFFICULTY_NAME, EXPORTED, find_policy
from arrive.policies.solved import solved_beside, solved_in
from arrive.render.graphics import GraphicsUnavailable
from arrive.render.pictures import film, picture_strip
from arrive.report.card import write_card
from arrive.report.diagnosis import why_stuck
from arrive.report.reach import direction_table, distance_table, ground_words, waiting_words
from arrive.report.records import DIFFICULTY_PICTURES, read_run
from arrive.terrain import Family
from arrive.terrain.ground import Ground

if TYPE_CHECKING:
    from arrive.commands.options import Eval, Report

ARRIVAL = "arrival"
"""The protocol without options: success on a policy's own levels, or on one terrain."""
ARRIVAL_LEVELS = 10
"""Levels of a terrain that it measures at most unless --levels is given."""
GRID_OPTIONS = {"target_distance": "distances", "direction": "directions", "time": "times"}
"""Options of the protocol `reach`, and the fields of `ReachGrid` that they set."""


def run_eval(command: Eval) -> None:
    """Evaluate policies, print success rates and causes of failure, and write JSON files and pictures."""
    if command.json and command.others:
        raise ArriveError("--json works with a single policy; evaluate several one by one")
    grid = {name: value for name in GRID_OPTIONS if (value := getattr(command, name)) is not None}
    protocol = command.protocol or (reach.NAME if grid else ARRIVAL)
    if grid and protocol != reach.NAME:
        raise ArriveError(f"--{next(iter(grid)).replace('_', '-')} needs --protocol reach, not {protocol}")
    if command.levels is not None and protocol == reach.NAME:
        raise ArriveError("--levels is not for --protocol reach, which measures one value of each terrain")
    # Small networks gain little from torch's threads and are six times slower with them on a busy machine. One thread
    # also gives the same sums on machines with different numbers of cores.
    threads = use_threads(command.threads)
    torch.set_num_threads(1)
    device = choose_device(command.device)
    print(describe_device(device, command.device, threads))
    measures = {ARRIVAL: _evaluate_arrival, difficulty.NAME: _evaluate_difficulty, reach.NAME: _evaluate_reach}
    for path in (command.policy, *command.others):
        measures[protocol](command, read_policy(path, device), threads)


def _chosen(command: Eval, policy: Policy) -> list[tuple[Family, Cell | None]]:
    return choose_cells(policy.config, command.terrain, command.level, command.value)


def _evaluate_arrival(command: Eval, policy: Policy, threads: int) -> None:
    chosen = _chosen(command, policy)
    _check_levels(command, chosen)
    cells = [cell for family, one in chosen for cell in ([one] if one else _spread(command, policy, family))]
    if command.json:
        keep_longer(command.json, ARRIVAL, len(cells) * command.episodes, command.force)
    setting = Conditions(command.layout or "training")
    pictures = _picture_folder(command.pictures or policy.folder / "pictures")
    with Progress(transient=True) as bar:
        steps = bar.add_task(f"{len(cells)} x {command.episodes} episodes", total=None)
        answer = evaluate(
            policy,
            cells,
            command.episodes,
            command.seed,
            threads,
            lambda i, n: bar.update(steps, completed=i, total=n),
            setting,
        )
    _print_results(answer.results)
    for family, _ in chosen:
        print(why_stuck([result for result in answer.results if result.cell.family is family]))
    if command.json:
        write_result(command.json, _arrival_content(command, policy, setting, answer))
    filmed = [
        telling([episode for cell, episode in zip(cells, answer.episodes, strict=True) if cell.family is family])
        for family, _ in chosen
    ]
    _write_pictures(pictures, answer.episodes, filmed)


def _spread(command: Eval, policy: Policy, family: Family) -> list[Cell]:
    """Evenly spaced ones of the policy's own levels, from the easiest to the hardest."""
    cells = cells_of(policy.config, [family])
    count = min(command.levels or ARRIVAL_LEVELS, len(cells))
    return [cells[round(i * (len(cells) - 1) / max(count - 1, 1))] for i in range(count)]


def _check_levels(command: Eval, chosen: list[tuple[Family, Cell | None]]) -> None:
    """Check that --levels and a single level or value are not given together.

    Raises:
        ArriveError: they are.
    """
    if command.levels is not None and any(cell for _, cell in chosen):
        raise ArriveError("--levels spreads levels over a terrain's range; leave it out to measure one level or value")


def _evaluate_difficulty(command: Eval, policy: Policy, threads: int) -> None:
    if command.layout == "training":
        raise ArriveError("--protocol difficulty always uses the evaluation layout; leave out --layout")
    difficulty.check_levels(command.levels)
    chosen, folder = _chosen(command, policy), policy.folder
    one = {family.name: cell for family, cell in chosen if cell}
    _check_levels(command, chosen)
    # A single value does not show the hardest solved terrain, so it is not stored as that result.
    out = command.json or (None if one else folder / DIFFICULTY_NAME)
    if out is not None:
        rows = sum(1 if family.name in one else len(difficulty_cells(family, command.levels)) for family, _ in chosen)
        keep_longer(out, difficulty.NAME, rows * command.episodes, command.force)
    pictures = _picture_folder(command.pictures or folder / ("pictures" if one else DIFFICULTY_PICTURES))
    with Progress() as bar:
        steps = bar.add_task(f"{policy.name}: {command.episodes} episodes per level", total=None)
        answer = difficulty.measure_difficulty(
            policy,
            [family for family, _ in chosen],
            command.episodes,
            command.seed,
            command.levels,
            threads,
            lambda i, n: bar.update(steps, completed=i, total=n),
            one,
        )
    _print_results([result for results in answer.results.values() for result in results])
    for results in answer.results.values():
        print(why_stuck(results))
    if out is not None:
        write_result(out, answer.content)
    _write_pictures(pictures, answer.episodes, answer.episodes, names=list(answer.results))
    if command.json is None and not one:
        _write_card(folder)


def _evaluate_reach(command: Eval, policy: Policy, threads: int) -> None:
    given = {
        field: parse_numbers(f"--{name.replace('_', '-')}", text)
        for name, field in GRID_OPTIONS.items()
        if (text := getattr(command, name)) is not None
    }
    grid = ReachGrid(**given, layout=command.layout or "evaluation")
    grid.check()
    check_policy(policy)
    folder, levels, chosen = policy.folder, policy.config.terrain.levels, _chosen(command, policy)
    solved = {} if all(cell for _, cell in chosen) else _solved(policy)
    grounds = [
        Ground(family, cell.value if cell else hardest_solved(solved, family, levels)) for family, cell in chosen
    ]
    out = command.json or folder / REACH_NAME
    keep_longer(out, reach.NAME, effort(grid, command.episodes, len(grounds)), command.force)
    with Progress() as bar:
        steps = bar.add_task(f"{policy.name}: {command.episodes} episodes per row", total=None)
        content = measure_reach(
            policy,
            grounds,
            grid,
            command.episodes,
            command.seed,
            threads,
            lambda i, n: bar.update(steps, completed=i, total=n),
        )
    for name, entry in content["families"].items():
        _print_reach(name, entry)
    write_result(out, content)
    if command.json is None:
        _write_card(folder)


def _solved(policy: Policy) -> dict[str, float]:
    """The hardest values that a policy solves: as measured beside it, or else as its exported file says."""
    solved = solved_beside(policy.path)
    if solved or policy.path.suffix != EXPORTED:
        return solved
    # Imported here because only exported files need onnxruntime.
    from arrive.deployment.policy_file import read_policy_file

    return solved_in(read_policy_file(policy.path).meta["evaluation"])


def _write_card(folder: Path) -> None:
    if (folder / CONFIG_NAME).is_file():
        print(f"card: {write_card(read_run(folder), folder)}")


def parse_numbers(option: str, text: str) -> tuple[float, ...]:
    """Parse numbers joined by commas.

    Raises:
        ArriveError: the text is something else.
    """
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise ArriveError(f"{option} must be numbers joined by commas, such as 1,2.5, not {text!r}") from error


def _print_reach(name: str, entry: dict[str, Any]) -> None:
    for head, rows in (distance_table(entry), direction_table(entry)):
        table = Table(*head, title=ground_words(name, entry), title_justify="left")
        for row in rows:
            table.add_row(*row)
        Console().print(table)
    print(f"{name}: {waiting_words(entry['waiting'])}")


def _print_results(results: list[CellResult]) -> None:
    table = Table("terrain", "level", "parameter", "episodes", "arrived", "95 % interval", "failures")
    for result in results:
        low, high = result.interval
        unit = result.cell.family.unit
        table.add_row(
            result.cell.family.name,
            "" if result.cell.level is None else str(result.cell.level),
            f"{result.cell.value:.3g} {unit}".strip() if unit else "",
            str(result.episodes),
            f"{result.success:.1%}",
            f"{low:.1%} to {high:.1%}",
            ", ".join(f"{cause} {count}" for cause, count in sorted(result.failures.items())),
        )
    Console().print(table)


def _arrival_content(command: Eval, policy: Policy, setting: Conditions, answer: Arrival) -> dict[str, Any]:
    families: dict[str, dict[str, Any]] = {}
    for result in answer.results:
        family = result.cell.family
        entry = families.setdefault(family.name, {"parameter": family.parameter, "unit": family.unit, "levels": []})
        own = {"level": result.cell.level, "median_distance_m": result.median_distance}
        entry["levels"].append(own | result.content())
    return {
        "families": families,
        "policy": policy_content(policy),
        "protocol": {
            "name": ARRIVAL,
            "episodes": command.episodes,
            "seed": command.seed,
            "layout": setting.layout,
            "worlds_per_level": policy.config.terrain.variants,
            "randomisation": to_dict(policy.config.randomisation),
            "observation_noise": policy.config.observation.noise,
        },
        "commit": commit(),
    }


def _picture_folder(folder: Path) -> Path:
    """The same folder; refuse one that cannot be written, before the work."""
    check_writable(folder / "picture.png")
    return folder


def _write_pictures(
    folder: Path, episodes: list[Episode], filmed: list[Episode], names: list[str] | None = None
) -> None:
    """Draw a strip of every episode and films of some. Without a graphics library, only print a line."""
    names = names or [episode.caption.replace(" ", "_") for episode in episodes]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, episode in zip(names, episodes, strict=True):
            picture_strip(episode, folder / f"{name}.png")
            if any(episode is one for one in filmed):
                film(episode, folder / f"{name}.mp4")
    except GraphicsUnavailable as error:
        print(error)
    except OSError as error:
        raise ArriveError(f"cannot write pictures to {folder}: {error}") from error
    else:
        print(f"pictures: {folder}")


def report(command: Report) -> None:
    """Write the report page and its JSON file.

    Raises:
        ArriveError: a run or a result cannot be read.
    """
    # Imported here because only the report draws charts, and loading matplotlib takes time.
    from arrive.report.experiments import FILES
    from arrive.report.write import is_report, write_report

    keep_others(command.out.with_suffix(".json"), is_report, command.force)
    paths = [path if path.is_dir() else find_policy(path) for path in (command.run, *command.others)]
    runs = [read_run(path) for path in paths]
    unmeasured = [str(path) for path, run in zip(paths, runs, strict=True) if run.difficulty is None]
    if unmeasured:
        print(f"not evaluated yet; run: arrive eval --protocol difficulty {shlex.join(unmeasured)}")
    files = {name: getattr(command, name) for name in FILES}
    for path in write_report(runs, command.out, files):
        print(f"report: {path}")
