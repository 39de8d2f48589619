"""A policy's card: one page of Markdown that says what it is, what it solves, and how it moves."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from arrive.errors import ArriveError
from arrive.evaluation.arrival import CellResult
from arrive.evaluation.difficulty import SHARES
from arrive.evaluation.motion import UNITS
from arrive.files import write_text
from arrive.policies import CURVES_NAME
from arrive.report.reach import direction_table, distance_table, ground_words, protocol_words, waiting_words
from arrive.report.records import DIFFICULTY_PICTURES, Run
from arrive.report.text import code_block, inline_code, markdown
from arrive.terrain import get_family
from arrive.terrain.ground import Ground

CARD_NAME = "card.md"


def write_card(run: Run, folder: Path) -> Path:
    """Write the card of a measured run into its folder.

    Raises:
        ArriveError: it was not measured, or the file cannot be written.
    """
    if run.difficulty is None and run.reach is None:
        raise ArriveError(f"{run.name} was not measured: run `arrive eval --protocol difficulty {folder}` first")
    path = folder / CARD_NAME
    write_text(path, card_text(run, (folder / CURVES_NAME).is_file()))
    return path


def card_text(run: Run, with_curves: bool) -> str:
    """The card of a measured run; paths in it are relative to the run's folder."""
    config = run.record["config"]
    minutes = run.log["progress/elapsed_s"][-1] / 60.0 if run.log.get("progress/elapsed_s") else float("nan")
    parts = [
        f"# {markdown(run.name)}",
        f"{config['robot']}, task {inline_code(config['task']['name'])}, preset {inline_code(config['preset'])}, "
        f"networks {'-'.join(map(str, config['ppo']['hidden']))}, trained on "
        f"{', '.join(config['terrain']['families'])} for {run.amount}, in {minutes:.0f} minutes, "
        f"seed {config['seed']}, commit {markdown(run.record['commit'])}:",
        code_block(run.record["command"], "sh"),
        *(_difficulty(run, run.difficulty) if run.difficulty else ()),
        *(_reach(run, run.reach) if run.reach else ()),
        *(_motion(run) if run.difficulty else ()),
    ]
    if with_curves:
        parts += ["## How it was learnt", f"![curves]({CURVES_NAME})"]
    return "\n\n".join(parts) + "\n"


def _difficulty(run: Run, measured: dict[str, Any]) -> list[str]:
    protocol = measured["protocol"]
    return [
        "## What it solves",
        f"`arrive eval --protocol difficulty`: {protocol['episodes']} episodes per level, seed {protocol['seed']}; "
        f"success is {markdown(protocol['success'].partition(';')[0])}. Commit {markdown(measured['commit'])}.",
        _solved(run),
        "A value is solved if it and every easier one below have at least that success rate.",
        *(_family(run, name, results) for name, results in run.results().items()),
    ]


def _reach(run: Run, measured: dict[str, Any]) -> list[str]:
    """Where and by when it arrives."""
    protocol = measured["protocol"]
    parts = [
        "## Where and by when it arrives",
        f"`arrive eval --protocol reach`: {protocol['episodes']} episodes per row, seed {protocol['seed']}, "
        f"{markdown(protocol['layout'])} layout; success is {markdown(protocol['success'])}, with 95 % intervals. "
        f"By distance: {markdown(protocol['by_distance'])}. By direction: {markdown(protocol['by_direction'])}. "
        f"Commit {markdown(measured['commit'])}.",
    ]
    for name, entry in measured["families"].items():
        parts.append(f"### {markdown(ground_words(name, entry))}")
        if compared := protocol_words(run.difficulty, name, entry):
            parts.append(markdown(compared))
        parts += [_table(*distance_table(entry)), _table(*direction_table(entry))]
        parts.append(f"Waiting: {markdown(waiting_words(entry['waiting']))}.")
    return parts


def _solved(run: Run) -> str:
    """The hardest parameter up to which all are solved with each share of success, a line per family."""
    head = ["terrain", *(f"solved with {share:.0%}" for share in SHARES)]
    rows = []
    for name, entry in run.families.items():
        limits = [entry[f"max_at_{share * 100:.0f}"] for share in SHARES]
        rows.append([name, *("-" if limit is None else _amount(name, limit) for limit in limits)])
    return _table(head, rows)


def _amount(name: str, value: float) -> str:
    """A terrain's value with its unit; "yes" for a terrain without a parameter."""
    return Ground(get_family(name), value).amount or "yes"


def _family(run: Run, name: str, results: Sequence[CellResult]) -> str:
    unit = results[0].cell.family.unit
    rows = []
    for result in results:
        low, high = result.interval
        failures = ", ".join(f"{cause} {count}" for cause, count in sorted(result.failures.items()))
        value = f"{result.cell.value:g} {unit}" if unit else ""
        rows.append([value, f"{result.success:.1%}", f"{low:.1%} to {high:.1%}", failures])
    text = f"### {name}\n\n" + _table(["parameter", "success", "95 % interval", "failures"], rows)
    return text + (f"\n\n![{name}]({DIFFICULTY_PICTURES}/{name}.png)" if name in run.pictures else "")


def _motion(run: Run) -> list[str]:
    figures = "; ".join(f"`{name}` is the {text}" for name, text in UNITS.items())
    return ["## How it moves", f"Successful episodes, from start to end: {figures}.", _motion_table(run)]


def _motion_table(run: Run) -> str:
    rows = []
    for name, levels in run.usage.items():
        for level in levels:
            motion = level.get("motion")
            if motion:
                # A measurement by an earlier version lacks the newer figures.
                figures = ("-" if motion.get(figure) is None else f"{motion[figure]:.3g}" for figure in UNITS)
                rows.append([f"{name} {level['value']:g}", str(level["episodes"]), *figures])
    return _table(["terrain", "episodes", *(f"`{figure}`" for figure in UNITS)], rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; its head may have markup, its rows are texts."""
    lines = [head, ["---"] * len(head), *(map(markdown, row) for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
