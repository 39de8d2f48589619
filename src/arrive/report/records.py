"""Contents of a run's folder for a report: training, measurements, pictures."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from arrive.config import saved_config, to_dict
from arrive.errors import ArriveError, shown, unknown_name
from arrive.evaluation.arrival import Cell, CellResult
from arrive.evaluation.reach import REACH_NAME
from arrive.learning.logs import LOG_NAME, read_log
from arrive.learning.rundir import read_config, samples_before
from arrive.policies import DIFFICULTY_NAME, EXPORTED, results_folder
from arrive.report.text import plain
from arrive.results.read import check_result, read_if_there
from arrive.terrain import FAMILIES, get_family

DIFFICULTY_PICTURES = "pictures/difficulty"
"""Folder of a strip per family, under the run's."""
SYMBOLS = {"velocity": "V", "continuous": "P_c", "final": "P_f"}
"""The paper's names of the tasks."""


@dataclass(frozen=True)
class Run:
    """One run, as far as it got."""

    name: str
    record: dict[str, Any]
    """config.json: configuration, commit, command and seed of the training."""
    log: dict[str, list[float]]
    """Columns of log.csv; empty where there is none."""
    difficulty: dict[str, Any] | None
    """difficulty.json, or None where the run was not measured."""
    pictures: dict[str, Path]
    """Strips by family."""
    reach: dict[str, Any] | None = None
    """reach.json, or None where the run was not measured so."""

    @property
    def task(self) -> str:
        """Name of the task it was trained on."""
        return self.record["config"]["task"]["name"]

    @property
    def label(self) -> str:
        """The paper's symbol of the task and the run's name, for charts."""
        return label_of(self.task, self.name)

    @property
    def samples(self) -> int:
        """Policy steps it was trained for."""
        if self.difficulty is not None:
            return int(self.difficulty["policy"]["samples"])
        return int(self.log["progress/samples"][-1]) if self.log.get("progress/samples") else 0

    @property
    def samples_before(self) -> int:
        """Policy steps of the runs that it began from; 0 also where its record is too old to say."""
        return samples_before(self.record)

    @property
    def amount(self) -> str:
        """How much it was trained, in words."""
        before = f" after {self.samples_before / 1e6:.1f} M of the runs before" if self.samples_before else ""
        return f"{self.samples / 1e6:.2f} M samples{before}"

    @property
    def families(self) -> dict[str, Any]:
        """What difficulty.json says of each family; empty where the run was not measured."""
        return self.difficulty["families"] if self.difficulty else {}

    @property
    def usage(self) -> dict[str, Any]:
        """How the robots of each family spent their time; empty where the run was not measured."""
        return self.difficulty["policy"]["usage"] if self.difficulty else {}

    def results(self) -> dict[str, list[CellResult]]:
        """Measurements by family; empty if there are none."""
        return {name: _results(name, entry) for name, entry in self.families.items()}


@dataclass(frozen=True)
class Measured:
    """One policy in a result of `arrive energy` or `arrive gait`."""

    name: str
    task: str
    content: dict[str, Any]

    @staticmethod
    def of(content: dict[str, Any]) -> list["Measured"]:
        """All policies of a result."""
        return [Measured(policy["name"], policy["task"], policy) for policy in content["policies"]]

    @property
    def label(self) -> str:
        """The paper's symbol of the task and the policy's name, for charts."""
        return label_of(self.task, self.name)


def label_of(task: str, name: str) -> str:
    """The paper's symbol of a task and a policy's name, for charts."""
    return f"{f'${SYMBOLS[task]}$' if task in SYMBOLS else plain(task)} ({plain(name)})"


def _results(name: str, entry: dict[str, Any]) -> list[CellResult]:
    family = get_family(name)
    return [
        CellResult(
            Cell(family, i, level["value"]),
            level["episodes"],
            round(level["success"] * level["episodes"]),
            float("nan"),
            level["failures"],
        )
        for i, level in enumerate(entry["levels"])
    ]


def read_run(path: Path) -> Run:
    """Read a run's folder, also by a file in it, or an exported file with the results of measuring it.

    Raises:
        ArriveError: no run, or a file that cannot be read.
    """
    if path.suffix == EXPORTED:
        return _read_exported(path)
    folder = path if path.is_dir() else path.parent
    _, record = read_config(folder)
    difficulty = _read_families(folder / DIFFICULTY_NAME, "difficulty")
    return Run(
        name=shown(folder.resolve().name),
        record=record,
        log=read_log(folder) if (folder / LOG_NAME).is_file() else {},
        difficulty=difficulty,
        pictures=_strips(folder, difficulty),
        reach=_read_families(folder / REACH_NAME, "reach"),
    )


def _strips(folder: Path, difficulty: dict[str, Any] | None) -> dict[str, Path]:
    """Picture strips by family."""
    paths = {
        name: folder / DIFFICULTY_PICTURES / f"{name}.png" for name in (difficulty["families"] if difficulty else ())
    }
    return {name: path for name, path in paths.items() if path.is_file()}


def _read_exported(path: Path) -> Run:
    """An exported file has no log. Its results are in the folder of its name, if it was measured itself.

    Otherwise it has those of its run, without pictures and without how the robots spent their time.
    """
    # Imported here because only this needs onnxruntime.
    from arrive.deployment.policy_file import read_policy_file

    meta = read_policy_file(path).meta
    training, measured = meta["training"], meta["evaluation"]
    check_result(training, "training", path, "Export the policy again.")
    config = to_dict(saved_config(training["config"], path))
    record = {"config": config, "commit": training["commit"], "seed": config["seed"]}
    record["command"] = f"arrive export {path.name}"
    if measured is not None:
        check_result(measured, "exported", path)
        _check_families(measured, path)
    folder = results_folder(path)
    beside = _read_families(folder / DIFFICULTY_NAME, "difficulty")
    inside = measured and measured | {"policy": {"samples": training["samples"], "usage": {}}}
    return Run(
        name=shown(path.stem),
        record=record,
        log={},
        difficulty=beside or inside,
        pictures=_strips(folder, beside),
        reach=_read_families(folder / REACH_NAME, "reach"),
    )


def _read_families(path: Path, kind: str) -> dict[str, Any] | None:
    """A result by terrain family, or None where there is none."""
    content = read_if_there(path, kind)
    if content is not None:
        _check_families(content, path)
    return content


def _check_families(content: dict[str, Any], path: Path) -> None:
    """Check that all terrain families of a result are known.

    Raises:
        ArriveError: one is not; the message has the file.
    """
    for name in [*content["families"], *content.get("policy", {}).get("usage", {})]:
        if name not in FAMILIES:
            raise ArriveError(f"cannot read {path}: {unknown_name('terrain', name, FAMILIES)}")
