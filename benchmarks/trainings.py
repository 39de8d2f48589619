"""Shared by the benchmarks: trainings that can be continued, `arrive bench`, and tables.

`stability.py` and `time_window.py` use `Training` and `Results`, `from_scratch.py` the command line and tables,
`scaling.py` and `busy.py` the throughput.
"""

import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from arrive.evaluation import difficulty
from arrive.evaluation.arrival import choose_cells
from arrive.files import read_json, write_json
from arrive.learning.checkpoint import CHECKPOINT_NAME
from arrive.learning.logs import read_log
from arrive.learning.policy import Policy, load_policy
from arrive.learning.run_files import read_progress
from arrive.plugins import import_module

LAST_SHARE = 0.1
"""Results of the critic are means over this last share of a run."""
CURVE_POINTS = 50
"""Number of points in a curve."""


@dataclass(frozen=True)
class Training:
    """One run."""

    folder: Path
    ground: str
    """Terrain family to train on, or NAME=VALUE with the value at which success is measured."""
    seed: int
    samples: float
    """Policy steps of all robots."""
    preset: str
    settings: tuple[str, ...] = ()
    """Changes to the configuration, as PATH=VALUE."""
    threads: int = 0
    module: Path | None = None
    """Module to import, as with `--import`."""

    def finish(self) -> Policy:
        """Train, or continue the training, until the samples are spent.

        Raises:
            subprocess.CalledProcessError: the training failed.
        """
        family = self.ground.partition("=")[0]
        module = ("--import", str(self.module)) if self.module else ()
        options = ["--samples", f"{self.samples:.0f}", "--threads", str(self.threads), *module]
        if not (self.folder / CHECKPOINT_NAME).exists():
            changes = ("--set", *self.settings) if self.settings else ()
            new = ("--preset", self.preset, "--seed", str(self.seed), "--out", str(self.folder), *changes)
            arrive("train", family, *options, *new)
        elif read_progress(self.folder).samples < self.samples:
            arrive("train", family, *options, "--resume", str(self.folder))
        if self.module:
            # Only because the policy needs it to be read; it has no effect on measuring.
            import_module(str(self.module))
        return load_policy(self.folder)

    def measure(self, policy: Policy, episodes: int) -> dict[str, Any]:
        """Success, time, path and speed by the protocol of maximum difficulty at the ground's value."""
        ((family, cell),) = choose_cells(policy.config, self.ground)
        chosen = {family.name: cell} if cell else {}
        answer = difficulty.measure_difficulty(policy, [family], episodes, 1, threads=self.threads, chosen=chosen)
        (rows,), (usage,) = answer.results.values(), answer.content["policy"]["usage"].values()
        if len(rows) > 1:
            raise SystemExit(f"{family.name} has a parameter: give the value to measure at, as {family.name}=VALUE")
        return {"success": rows[0].success, "interval": list(rows[0].interval), "usage": usage[0]}

    def critic(self) -> dict[str, Any]:
        """Explained variance and loss of the value function at the end of training, and the curve of the former."""
        log = read_log(self.folder)
        samples, explained, loss = (
            log[name] for name in ("progress/samples", "learning/explained_variance", "learning/value")
        )
        last = max(round(LAST_SHARE * len(samples)), 1)
        step = max(len(samples) // CURVE_POINTS, 1)
        return {
            "explained_variance": sum(explained[-last:]) / last,
            "value_loss": sum(loss[-last:]) / last,
            "curve": {"samples": samples[::step], "explained_variance": explained[::step]},
        }


Content = Callable[[list[dict[str, Any]]], dict[str, Any]]
"""Makes a benchmark's result as JSON data from its runs."""


@dataclass(frozen=True)
class Results:
    """A result file to which runs are added. It alone says which runs are done."""

    path: Path
    content: Content
    names: tuple[str, ...]
    """Entries of a run that tell it from the others."""
    extended: tuple[str, ...]
    """Entries of the protocol that may differ from the file's, because they only say which runs there are."""

    def runs(self) -> list[dict[str, Any]]:
        """The runs so far; none if there is no such file.

        Raises:
            SystemExit: the file's runs were trained or measured in another way.
        """
        if not self.path.is_file():
            return []
        known, protocol = read_json(self.path), self.content([])["protocol"]
        before = {name: known["protocol"].get(name) for name in protocol}
        changed = [name for name in protocol if name not in self.extended and protocol[name] != before[name]]
        if changed:
            differences = ", ".join(f"{name} {before[name]} instead of {protocol[name]}" for name in changed)
            raise SystemExit(f"{self.path} has runs with {differences}; choose another folder with --out")
        return known["runs"]

    def complete(
        self, wanted: Iterable[tuple[Any, ...]], make: Callable[..., dict[str, Any]]
    ) -> Iterator[dict[str, Any]]:
        """Make the runs that are missing, one after the other, and yield each when it is in the file.

        Args:
            wanted: the values of `names` of each run.
            make: trains and measures a run, from its values.
        """
        for key in wanted:
            if key not in [tuple(run[name] for name in self.names) for run in self.runs()]:
                run = make(*key)
                write_json(self.path, self.content([*self.runs(), run]))
                yield run


def arrive(*arguments: str) -> None:
    """Run `arrive` with these arguments."""
    subprocess.run([sys.executable, "-m", "arrive.cli", *arguments], check=True, stdout=subprocess.DEVNULL)


def bench(*arguments: str) -> dict[str, Any]:
    """Result of `arrive bench`, run in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.json"
        arrive("bench", *arguments, "--json", str(path))
        return read_json(path)


def command() -> str:
    """The command line of this benchmark."""
    return shlex.join(["python", *sys.argv])


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rows))
