"""The report: one self-contained page and a JSON file from the folders of runs."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from arrive.errors import ArriveError
from arrive.learning.rundir import commit
from arrive.report.page import make_page
from arrive.report.records import Run, read_run
from arrive.report.table import make_relations, make_table


def write_report(folders: Sequence[Path], out: Path) -> tuple[Path, Path]:
    """Write the page to `out` and its figures beside it as JSON; returns both paths.

    Raises:
        ArriveError: a folder that holds no run, two runs of one name, or a file that cannot be written.
    """
    runs = [read_run(folder) for folder in folders]
    names = [run.name for run in runs]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ArriveError(f"two runs are called {', '.join(repeated)}; rename a folder to tell them apart")
    if out.suffix == ".json":
        raise ArriveError(f"--out names the page, not its JSON file: {out}")
    content = make_content(runs)
    written = (out, out.with_suffix(".json"))
    _write(written[0], make_page(runs, content))
    _write(written[1], json.dumps(content, indent=2) + "\n")
    return written


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
        "eval_command": _eval_command(run) if run.difficulty else None,
        "difficulty": run.difficulty,
    }


def _train_command(command: str) -> str:
    """The command as a person would type it, whatever file the program was started from."""
    return f"arrive {command.partition(' ')[2]}"


def _eval_command(run: Run) -> str:
    protocol, families = run.difficulty["protocol"], run.difficulty["families"]
    levels = f" --levels {protocol['levels']}" if protocol["levels"] else ""
    return (
        f"arrive eval --protocol difficulty {run.name} --terrain {','.join(families)} "
        f"--episodes {protocol['episodes']} --seed {protocol['seed']}{levels}"
    )


def _write(path: Path, text: str) -> None:
    partial = path.with_name(f"{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise ArriveError(f"cannot write {path}: {error}") from error
