"""Trains a queue of policies in the hours there are, goes on where it stopped, and measures what is done.

    python scripts/campaign.py --minutes 150 --runs 2 --threads 1

Each run of the queue is a run folder under `policies/`, and one campaign at a time works on a queue; when it is killed,
the trainings that it has begun save and end. The first unfinished ones that have begun or whose start is
finished are trained for a slice of time, as many beside each other as wished, again and again until the minutes are
spent; Ctrl-C ends them after the iteration in progress. Runs of one thread beside each other make more samples than one
run in several processes, and that more than one process of several threads. What has all its samples, or is named by
`--also`, is measured by the paper's protocol and exported.
`results/table1.md` then has the paper's Table I beside every policy that was measured.
"""

import ctypes
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from arrive.config import Config
from arrive.errors import ArriveError, unknown_name
from arrive.evaluation.difficulty import DIFFICULTY_NAME
from arrive.files import read_json, read_text, write_text
from arrive.learning.checkpoint import CHECKPOINT_NAME
from arrive.learning.run_files import read_progress
from arrive.lock import Lock
from arrive.recipe import make_config
from arrive.report.records import Run, read_run
from arrive.report.table import LIMITS, make_table
from arrive.terrain import parse_families

ROOT = Path(__file__).resolve().parent.parent
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
"""What a run may be called: its folder's name, which cannot lead elsewhere."""
PR_SET_PDEATHSIG = 1
"""Linux's prctl: the signal that a process gets when its parent dies."""
LEAST_MINUTES = 1.0
"""A slice shorter than this is not begun."""

Arrive = Callable[..., None]
"""Runs the command line in so many processes with these arguments."""


@dataclass(frozen=True)
class Entry:
    """One run of the queue."""

    name: str
    terrain: str
    million_samples: float
    start_from: str | None = None
    """Run whose networks it starts with: one of the queue, once that has all its samples, or a folder like
    `policies/walk`."""
    seed: int = 1
    set: tuple[str, ...] = ()
    """Changes to the configuration as PATH=VALUE."""
    processes: int | None = None
    """Processes that train it together; those of the command line by default."""

    @property
    def config(self) -> Config:
        """The run's configuration; its robots are those of all processes together."""
        return make_config(parse_families(self.terrain), seed=self.seed, overrides=tuple(self.set))

    @property
    def iterations(self) -> int:
        """Training iterations that make the samples."""
        config = self.config
        return math.ceil(1e6 * self.million_samples / (config.num_envs * config.ppo.num_steps))


@dataclass
class Arguments:
    """How long to train, and what."""

    minutes: float
    """In all, measuring not included [min]."""
    slice: float = 30.0
    """Training of a run at a time [min]."""
    runs: int = 1
    """Runs that are trained beside each other."""
    processes: int = 1
    """That train one run together, each with its share of the robots, where the queue does not say; a run goes on with
    as many as it began with."""
    threads: int = 1
    """Of each process."""
    episodes: int = 500
    """Per level, in a measurement."""
    also: tuple[str, ...] = ()
    """Unfinished runs to be measured at the end too, as they are by then."""
    queue: Path = ROOT / "queue.toml"
    """TOML file with one [[run]] per policy: name, terrain, million_samples, seed, set."""
    policies: Path = ROOT / "policies"
    table: Path = ROOT / "results" / "table1.md"


def read_queue(path: Path) -> list[Entry]:
    """The queue, in order.

    Raises:
        ArriveError: it cannot be read, has unknown keys, a name that is not one of a folder or not its own, or a run
            starts from what is neither in the queue nor a run, or in the end from itself.
    """
    try:
        rows = tomllib.loads(read_text(path))["run"]
        entries = [_entry(row) for row in rows]
    except (tomllib.TOMLDecodeError, KeyError, TypeError, ValueError) as error:
        raise ArriveError(f"{path} is not a queue of runs: {error}") from error
    starts: dict[str, str | None] = {}
    for entry in entries:
        if entry.name in starts:
            raise ArriveError(f"{path}: {entry.name} is listed more than once")
        starts[entry.name] = entry.start_from
    for entry in entries:
        start = entry.start_from
        if start is not None and start not in starts and not (ROOT / start / CHECKPOINT_NAME).exists():
            raise ArriveError(f"{path}: {entry.name} starts from {start!r}, neither in the queue nor a run's folder")
        _check_ends(entry.name, starts, path)
    return entries


def _entry(row: dict[str, Any]) -> Entry:
    """One run from its table.

    Raises:
        TypeError, ValueError: an unknown key or a value that makes no sense.
    """
    entry = Entry(**row | {"set": tuple(row.get("set", ()))})
    if not isinstance(entry.name, str) or not NAME.fullmatch(entry.name):
        raise ValueError(f"a run's name must be letters, digits, - and _, not {entry.name!r}")
    if isinstance(entry.million_samples, bool) or not 0 < entry.million_samples < math.inf:
        raise ValueError(f"million_samples of {entry.name} must be positive, not {entry.million_samples!r}")
    if not all(isinstance(text, str) for text in (entry.terrain, *entry.set)) or type(entry.seed) is not int:
        raise ValueError(f"terrain and set of {entry.name} must be text, its seed a whole number")
    start = entry.start_from
    if start is not None and (not start or Path(start).is_absolute() or ".." in Path(start).parts):
        raise ValueError(f"start_from of {entry.name} must be a run or a folder of this checkout, not {start!r}")
    if entry.processes is not None and (type(entry.processes) is not int or entry.processes < 1):
        raise ValueError(f"processes of {entry.name} must be at least 1, not {entry.processes!r}")
    return entry


def _check_ends(name: str, starts: dict[str, str | None], path: Path) -> None:
    """Make sure that the chain of starts from a run ends."""
    chain = [name]
    while (start := starts.get(chain[-1])) is not None:
        if start in chain:
            raise ArriveError(f"{path}: runs start from each other in a circle: {' <- '.join([*chain, start])}")
        chain.append(start)


def trained(folder: Path) -> tuple[int, float]:
    """Iterations and minutes that a run's checkpoint has behind it."""
    progress = read_progress(folder)
    return progress.iteration, progress.minutes


def measured(folder: Path) -> bool:
    """Whether a run was measured with all the samples that it has now."""
    path = folder / DIFFICULTY_NAME
    if not path.exists():
        return False
    policy = read_json(path).get("policy")
    return isinstance(policy, dict) and policy.get("samples") == read_progress(folder).samples


class Campaign:
    """The queue and what has become of it."""

    def __init__(self, arguments: Arguments, arrive: Arrive, clock: Callable[[], float]):
        self._arguments, self._arrive, self._clock = arguments, arrive, clock
        self._began = clock()
        self._busy: set[str] = set()
        self._ended = False
        self._changed = threading.Condition()
        self._entries = read_queue(arguments.queue)
        self._goals = {entry.name: entry.iterations for entry in self._entries}
        if arguments.runs < 1:
            raise ArriveError(f"--runs must be at least 1, not {arguments.runs}")
        for name in arguments.also:
            if name not in self._goals:
                raise unknown_name("run in the queue", name, self._goals)

    def folder(self, name: str) -> Path:
        """A run's folder."""
        return self._arguments.policies / name

    def _start(self, name: str) -> Path:
        return self.folder(name) if name in self._goals else ROOT / name

    def finished(self, name: str) -> bool:
        """Whether a run has all its samples."""
        return trained(self.folder(name))[0] >= self._goals[name]

    def _next(self) -> Entry | None:
        """The first unfinished run that is not being trained and has begun or whose start is finished.

        Folders of runs that are being trained are not read: another process writes to them.
        """
        for entry in self._entries:
            if entry.name in self._busy:
                continue
            iterations, _ = trained(self.folder(entry.name))
            if iterations < self._goals[entry.name] and (iterations > 0 or self._ready(entry.start_from)):
                return entry
        return None

    def _ready(self, start: str | None) -> bool:
        """Whether a run can start from here: a folder outside the queue, or a run of it that has all its samples."""
        return start not in self._goals or (start not in self._busy and self.finished(start))

    def _minutes_left(self) -> float:
        return self._arguments.minutes - (self._clock() - self._began) / 60.0

    def _take(self) -> Entry | None:
        """The next run, which is then this thread's; None once there is none, the time is over, or a run was ended."""
        with self._changed:
            # What another thread trains now may be the start of the next run.
            while (entry := self._next()) is None and self._busy and not self._ended:
                self._changed.wait()
            if entry is None or self._ended or self._minutes_left() < LEAST_MINUTES:
                return None
            self._busy.add(entry.name)
            return entry

    def _train_slices(self) -> None:
        """Train one run after the other until there is nothing more to do."""
        while (entry := self._take()) is not None:
            complete = False
            try:
                complete = self.train(entry, min(self._arguments.slice, self._minutes_left()))
            finally:
                with self._changed:
                    self._busy.remove(entry.name)
                    self._ended |= not complete
                    self._changed.notify_all()

    def spend(self) -> None:
        """Train until the minutes are spent, the queue is done, or somebody interrupted a run.

        Each run's process is waited for by a thread of its own, so that Ctrl-C, which reaches the processes too, leaves
        them the time to end their iteration and write a checkpoint.
        """
        with ThreadPoolExecutor(self._arguments.runs) as pool:
            for worker in [pool.submit(self._train_slices) for _ in range(self._arguments.runs)]:
                _wait(worker)

    def train(self, entry: Entry, minutes: float) -> bool:
        """Train a run for some minutes more.

        Returns:
            False where it ended before: somebody interrupted it.
        """
        folder, goal = self.folder(entry.name), self._goals[entry.name]
        iterations, before = trained(folder)
        print(f"{entry.name}: {iterations} of {goal} iterations", flush=True)
        common = ("--iterations", goal, "--threads", self._arguments.threads, "--minutes", before + minutes)
        processes = self._processes(entry)
        if iterations:
            self._arrive(processes, "train", entry.terrain, "--resume", folder, *common)
        else:
            start = ("--start-from", self._start(entry.start_from)) if entry.start_from else ()
            changes = ("--set", *entry.set, f"num_envs={self._robots(entry)}")
            new = ("--out", folder, "--seed", entry.seed, *start, *common, *changes)
            self._arrive(processes, "train", entry.terrain, *new)
        iterations, spent = trained(folder)
        return iterations >= goal or spent >= before + minutes - 1e-6

    def _processes(self, entry: Entry) -> int:
        return entry.processes or self._arguments.processes

    def _robots(self, entry: Entry) -> int:
        """A process's share of a run's robots.

        Raises:
            ArriveError: they cannot be shared evenly.
        """
        robots, processes = entry.config.num_envs, self._processes(entry)
        if robots % processes:
            raise ArriveError(f"{entry.name} has {robots} robots, which {processes} processes cannot share evenly")
        return robots // processes

    def measure(self) -> None:
        """Measure and export the runs whose turn it is and that were not yet as they are, and write the table."""
        for entry in self._entries:
            folder = self.folder(entry.name)
            wanted = self.finished(entry.name) or (entry.name in self._arguments.also and trained(folder)[0] > 0)
            if wanted and not measured(folder):
                options = ("--episodes", self._arguments.episodes, "--threads", self._arguments.threads)
                self._arrive(1, "eval", folder, "--protocol", "difficulty", *options)
                self._arrive(1, "export", folder, "--out", folder / "policy.onnx")
        folders = [self.folder(entry.name) for entry in self._entries]
        runs = [read_run(folder) for folder in folders if (folder / DIFFICULTY_NAME).exists()]
        if runs:
            write_text(self._arguments.table, table_text(runs))


def table_text(runs: Sequence[Run]) -> str:
    """The paper's Table I beside the runs, in Markdown: hardest parameter solved with 95, 80 and 50 % success."""
    head = ["terrain", "paper V", "paper P_c", "paper P_f", *(run.name for run in runs)]
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for row in make_table(runs):
        paper = row["paper"] or {}
        cells = [_number(paper.get(task)) for task in ("velocity", "continuous", "final")]
        by_run = {entry["run"]: entry for entry in row["ours"]}
        for run in runs:
            entry = by_run.get(run.name)
            cells.append(" / ".join(_number(entry[limit]) for limit in LIMITS) if entry else "")
        name = f"{row['family']}, {row['parameter']} [{row['unit']}]" if row["unit"] else row["family"]
        lines.append(f"| {' | '.join([name, *cells])} |")
    notes = [
        f"- {run.name}: {run.amount}, seed {run.record['config']['seed']}, commit {run.record['commit'][:10]}"
        for run in runs
    ]
    title = "# Table I of the paper, and ours\n\nHardest terrain solved with at least 95 / 80 / 50 % success.\n"
    return "\n".join([title, *lines, "", *notes]) + "\n"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:g}"


def _wait(worker: Future) -> None:
    """Wait for a thread to end, and raise what it raised, whatever Ctrl-C says."""
    while True:
        try:
            return worker.result()
        except KeyboardInterrupt:
            print("waiting for the iterations in progress", flush=True)


def run(arguments: Arguments, arrive: Arrive, clock: Callable[[], float] = time.monotonic) -> None:
    """Train until the minutes are spent or the queue is done, then measure.

    Raises:
        ArriveError: another campaign works on the queue, or a command fails.
    """
    campaign = Campaign(arguments, arrive, clock)
    path = arguments.queue.with_suffix(".lock")
    with Lock(path, f"the queue {arguments.queue}") as lock:
        os.set_inheritable(lock.handle, True)  # the trainings hold it too: it is free when the last of them has ended
        campaign.spend()
        campaign.measure()


def command_line(processes: int, *arguments: object) -> None:
    """Run `arrive` with these arguments in a process of its own, or in several; they end with this one.

    It runs at the root of the checkout and is given paths from there, so that its record of the command holds anywhere.

    Raises:
        ArriveError: it failed; what it said is above.
    """
    words = [str(a.relative_to(ROOT) if isinstance(a, Path) and a.is_relative_to(ROOT) else a) for a in arguments]
    torchrun = ("torch.distributed.run", "--standalone", f"--nproc-per-node={processes}", "-m")
    launcher = torchrun if processes > 1 else ()
    command = [sys.executable, "-m", *launcher, "arrive.cli", *words]
    if subprocess.run(command, cwd=ROOT, close_fds=False, preexec_fn=_end_with(os.getpid())).returncode:
        raise ArriveError(f"arrive {' '.join(words)} failed")


def _end_with(parent: int) -> Callable[[], None]:
    """For a new process: get SIGTERM, which saves and ends a training, when the process that began it dies."""
    prctl = ctypes.CDLL(None).prctl

    def prepare() -> None:
        prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:  # it died before
            os._exit(1)

    return prepare


if __name__ == "__main__":
    try:
        run(tyro.cli(Arguments, description=__doc__), command_line)
    except ArriveError as problem:
        sys.exit(f"campaign: {problem}")
