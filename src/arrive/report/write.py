"""The report: one self-contained page and a JSON file from runs and results."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from arrive.errors import ArriveError
from arrive.files import write_text
from arrive.learning.rundir import commit
from arrive.report.experiments import FILES, Results
from arrive.report.page import make_page
from arrive.report.records import Run
from arrive.report.table import make_relations, make_table
from arrive.results.read import read_result

PROTOCOLS = {"energy": "energy", "gait": "gait", "stability": "stability", "window": "time_window"}
"""What results call themselves."""


def write_report(runs: Sequence[Run], out: Path, files: dict[str, Path | None] | None = None) -> tuple[Path, Path]:
    """Write the page to `out` and its figures beside it as JSON; returns both paths.

    Args:
        files: results of `FILES`, by name; those that are None are read where their commands put them, if there.

    Raises:
        ArriveError: two runs of one name, a result that is none, or a file that cannot be read or written.
    """
    names = [run.name for run in runs]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ArriveError(f"two runs are called {', '.join(repeated)}; rename a folder to tell them apart")
    results = read_results(files or {})
    content = make_content(runs) | {name: value for name, value in vars(results).items() if value is not None}
    written = (out, out.with_suffix(".json"))
    write_text(written[0], make_page(runs, content, results))
    write_text(written[1], json.dumps(content, indent=2) + "\n")
    return written


def is_report(content: dict[str, Any]) -> bool:
    """Whether this is the content of a report's JSON file."""
    return {"table", "relations", "runs"} <= content.keys()


def read_results(files: dict[str, Path | None]) -> Results:
    """Read the measurements outside the runs' folders.

    Raises:
        ArriveError: a file that was named is missing, or one is damaged or holds something else.
    """
    return Results(**{name: _read_result(name, files.get(name), default) for name, default in FILES.items()})


def _read_result(name: str, path: Path | None, default: Path) -> dict[str, Any] | None:
    if path is None and not default.is_file():
        return None
    try:
        return read_result(path or default, PROTOCOLS[name])
    except ArriveError as error:
        raise ArriveError(f"{error} (--{name} names another file.)") from None


def make_content(runs: Sequence[Run]) -> dict[str, Any]:
    """Everything that the page says in numbers."""
    table = make_table(runs)
    return {
        "table": table,
        "relations": make_relations(table),
        "runs": [_origin(run) for run in runs],
        "commit": commit(),
    }


def _origin(run: Run) -> dict[str, Any]:
    config = run.record["config"]
    elapsed = run.log.get("progress/elapsed_s")
    return {
        "name": run.name,
        "task": run.task,
        "terrain": config["terrain"]["families"],
        "preset": config["preset"],
        "samples": run.samples,
        "samples_before": run.samples_before,
        "amount": run.amount,
        "training_s": elapsed[-1] if elapsed else None,
        "seed": run.record["seed"],
        "commit": run.record["commit"],
        "train_command": _train_command(run.record["command"]),
        "eval_command": _eval_command(run, run.difficulty) if run.difficulty else None,
        "difficulty": run.difficulty,
    }


def _train_command(command: str) -> str:
    """The command as a person would type it, whatever file the program was started from."""
    return f"arrive {command.partition(' ')[2]}"


def _eval_command(run: Run, measured: dict[str, Any]) -> str:
    protocol, families = measured["protocol"], measured["families"]
    levels = f" --levels {protocol['levels']}" if protocol["levels"] else ""
    return (
        f"arrive eval --protocol difficulty {run.name} --terrain {','.join(families)} "
        f"--episodes {protocol['episodes']} --seed {protocol['seed']}{levels}"
    )
