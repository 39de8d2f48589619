"""The training queue: order, slices, exact continuation, and what is measured when."""

import contextlib
import importlib.util
import json
import math
import os
import shutil
import signal
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from subprocess import PIPE, STDOUT, CompletedProcess, Popen

import pytest
import torch

from arrive.cli import main
from arrive.errors import ArriveError
from arrive.learning.checkpoint import CHECKPOINT_NAME, Origin, save_sealed
from arrive.learning.logs import LOG_NAME, read_log
from arrive.learning.run_files import read_progress
from arrive.learning.rundir import LOCK_NAME
from arrive.lock import Lock
from arrive.presets import robust
from arrive.report.records import read_run

ROOT = Path(__file__).parent.parent
SPEC = importlib.util.spec_from_file_location("campaign", ROOT / "scripts" / "campaign.py")
campaign = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(campaign)

QUEUE = """
[[run]]
name = "all"
terrain = "all"
million_samples = 1.0
set = ["ppo.num_steps=12"]
[[run]]
name = "gap"
terrain = "gap"
million_samples = 0.5
start_from = "all"
set = ["ppo.num_steps=12", "ppo.gamma=0.99"]
"""
ITERATIONS_PER_MINUTE = 4


def write_checkpoint(folder: Path, iteration: int, minutes: float = 0.0) -> None:
    """The checkpoint of a run so far, of 12,288 samples per iteration."""
    schema = [{"name": "height", "start": 0, "stop": 1}]
    origin = Origin("anymal_c", robust(), schema, "abc", iteration, 12_288 * iteration).content()
    state = {"elapsed_s": 60.0 * minutes, "algorithm": {"actor_state_dict": {"weight": torch.ones(1)}}}
    save_sealed(origin | {"state": state}, folder / CHECKPOINT_NAME)


class FakeArrive:
    """Trains at a fixed pace, on a clock of its own."""

    def __init__(self):
        self.minutes, self.calls, self.processes = 0.0, [], []

    def __call__(self, processes, *arguments) -> None:
        command, *rest = map(str, arguments)
        self.calls.append((command, *rest))
        self.processes.append(processes)
        if command != "train":
            return
        options = dict(zip(rest[1::2], rest[2::2], strict=False))
        folder = Path(options.get("--resume") or options["--out"])
        iterations, minutes = campaign.trained(folder)
        spent = float(options["--minutes"]) - minutes
        total = min(iterations + round(spent * ITERATIONS_PER_MINUTE), int(options["--iterations"]))
        minutes += (total - iterations) / ITERATIONS_PER_MINUTE
        self.minutes += (total - iterations) / ITERATIONS_PER_MINUTE
        folder.mkdir(parents=True, exist_ok=True)
        write_checkpoint(folder, total, minutes)

    def clock(self) -> float:
        return 60.0 * self.minutes


def arguments(folder: Path, minutes: float, queue: str = QUEUE):
    (folder / "queue.toml").write_text(queue)
    return campaign.Arguments(
        minutes=minutes,
        slice=10.0,
        queue=folder / "queue.toml",
        policies=folder / "policies",
        table=folder / "results" / "table1.md",
    )


def test_runs_are_trained_in_order_in_slices_and_measured_once_all_samples_are_in(tmp_path):
    arrive = FakeArrive()
    campaign.run(arguments(tmp_path, 1000.0), arrive, arrive.clock)
    trained = [call for call in arrive.calls if call[0] == "train"]
    # 1.0 and 0.5 million samples are 82 and 41 iterations of 12,288: 20.5 and 10.25 minutes.
    assert [
        Path(call[call.index(flag) + 1]).name for call in trained for flag in ("--out", "--resume") if flag in call
    ] == (["all"] * 3 + ["gap"] * 2)
    assert campaign.trained(tmp_path / "policies" / "all")[0] == 82
    first_gap = trained[3]
    assert first_gap[first_gap.index("--start-from") + 1] == str(tmp_path / "policies" / "all")
    assert first_gap[-4:] == ("--set", "ppo.num_steps=12", "ppo.gamma=0.99", "num_envs=1024")
    assert [call[0] for call in arrive.calls[-4:]] == ["eval", "export", "eval", "export"]


def test_a_campaign_that_ran_out_of_time_goes_on_where_it_stood(tmp_path):
    arrive = FakeArrive()
    campaign.run(arguments(tmp_path, 5.0), arrive, arrive.clock)
    assert campaign.trained(tmp_path / "policies" / "all") == (20, 5.0)
    assert {call[0] for call in arrive.calls} == {"train"}  # nothing is finished, nothing is measured
    arrive.minutes = 0.0
    campaign.run(arguments(tmp_path, 5.0), arrive, arrive.clock)
    assert campaign.trained(tmp_path / "policies" / "all") == (40, 10.0)
    assert "--resume" in arrive.calls[-1]


def test_a_run_that_has_begun_goes_on_whatever_became_of_its_start(tmp_path):
    """Its start may be replaced by a newer one that is not finished; the run has its own checkpoint."""
    arrive = FakeArrive()
    campaign.run(arguments(tmp_path, 25.0), arrive, arrive.clock)
    shutil.rmtree(tmp_path / "policies" / "all")
    queue = QUEUE.split("[[run]]")
    turned = "[[run]]".join([queue[0], queue[2], queue[1]])
    arrive.minutes = 0.0
    campaign.run(arguments(tmp_path, 5.0, turned), arrive, arrive.clock)
    assert Path(arrive.calls[-1][arrive.calls[-1].index("--resume") + 1]).name == "gap"


def test_a_training_that_was_interrupted_ends_the_campaign(tmp_path):
    arrive = FakeArrive()

    def interrupted(processes, *arguments) -> None:
        given = list(arguments)
        at = given.index("--minutes") + 1
        given[at] = float(given[at]) - 1.0
        arrive(processes, *given)

    campaign.run(arguments(tmp_path, 1000.0), interrupted, arrive.clock)
    assert len(arrive.calls) == 1
    assert campaign.trained(tmp_path / "policies" / "all") == (36, 9.0)


TWO_AND_A_THIRD = """
[[run]]
name = "flat"
terrain = "flat"
million_samples = 0.1
set = ["ppo.num_steps=12"]
[[run]]
name = "pit"
terrain = "pit"
million_samples = 0.1
set = ["ppo.num_steps=12"]
[[run]]
name = "gap"
terrain = "gap"
million_samples = 0.1
set = ["ppo.num_steps=12"]
start_from = "pit"
"""


def test_runs_are_trained_beside_each_other_and_wait_for_those_they_start_from(tmp_path):
    arrive, meeting, one_at_a_time = FakeArrive(), threading.Barrier(2, timeout=20.0), threading.Lock()
    order = []

    def slow(processes, *arguments) -> None:
        name = Path(arguments[3]).name if arguments[0] == "train" else ""
        order.append(name)
        if name in ("flat", "pit"):
            meeting.wait()  # breaks unless both are being trained
        with one_at_a_time:
            arrive(processes, *arguments)

    campaign.run(replace(arguments(tmp_path, 1000.0, TWO_AND_A_THIRD), runs=2), slow, arrive.clock)
    assert sorted(order[:2]) == ["flat", "pit"]
    assert order[2] == "gap"
    assert {name: campaign.trained(tmp_path / "policies" / name)[0] for name in ("flat", "pit", "gap")} == {
        "flat": 9,
        "pit": 9,
        "gap": 9,
    }


def test_a_training_that_fails_ends_those_beside_it_after_their_slice(tmp_path):
    arrive, meeting = FakeArrive(), threading.Barrier(2, timeout=20.0)

    def failing(processes, *arguments) -> None:
        meeting.wait()
        if Path(arguments[3]).name == "flat":
            raise ArriveError("no disk")
        time.sleep(0.5)
        arrive(processes, *arguments)

    with pytest.raises(ArriveError, match="no disk"):
        campaign.run(replace(arguments(tmp_path, 1000.0, TWO_AND_A_THIRD), runs=2), failing, arrive.clock)
    assert campaign.trained(tmp_path / "policies" / "pit")[0] == 9
    assert not (tmp_path / "policies" / "gap").exists()
    with pytest.raises(ArriveError, match=r"--runs must be at least 1, not 0"):
        campaign.run(replace(arguments(tmp_path, 5.0), runs=0), arrive, arrive.clock)


@pytest.fixture
def training_campaign(tmp_path):
    """A campaign in a process group of its own, in the middle of training the run `a` over and over."""
    small = '["ppo.hidden=[8]", "ppo.num_steps=24", "terrain.variants=1", "num_envs=256"]'
    queue = tmp_path / "queue.toml"
    queue.write_text(f'[[run]]\nname = "a"\nterrain = "flat"\nmillion_samples = 1.0\nset = {small}\n')
    options = ("--queue", queue, "--policies", tmp_path, "--table", tmp_path / "table.md", "--minutes", "5")
    words = [sys.executable, ROOT / "scripts" / "campaign.py", *options]
    process = Popen(words, stdout=PIPE, stderr=STDOUT, text=True, start_new_session=True)
    try:
        wait_until(lambda: (log := tmp_path / "a" / LOG_NAME).exists() and log.read_text().count("\n") > 2)
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def wait_until(condition) -> None:
    deadline = time.monotonic() + 240.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_an_interrupted_campaign_loses_no_iteration(tmp_path, training_campaign):
    """Ctrl-C reaches the campaign and the training that it waits for."""
    os.killpg(training_campaign.pid, signal.SIGINT)
    said, _ = training_campaign.communicate(timeout=240.0)
    assert training_campaign.returncode == 0, said
    assert read_progress(tmp_path / "a").iteration == read_log(tmp_path / "a")["iteration"][-1] > 1


def test_a_killed_campaign_ends_what_it_trains(tmp_path, training_campaign):
    """SIGKILL of the campaign alone: its training saves and ends, and only then is the queue free."""
    training_campaign.kill()
    training_campaign.wait()
    run, queue = (Lock(path, "it") for path in (tmp_path / "a" / LOCK_NAME, tmp_path / "queue.lock"))
    with pytest.raises(ArriveError, match="in use"):
        queue.acquire()
    wait_until(lambda: not run.path.exists())
    wait_until(lambda: acquired(queue))
    queue.release()
    assert read_progress(tmp_path / "a").iteration == read_log(tmp_path / "a")["iteration"][-1] > 1


def acquired(lock: Lock) -> bool:
    try:
        lock.acquire()
    except ArriveError:
        return False
    return True


def test_an_unfinished_run_is_measured_where_it_is_named(tmp_path):
    arrive = FakeArrive()
    campaign.run(replace(arguments(tmp_path, 5.0), also=("all", "gap")), arrive, arrive.clock)
    # The gap waits for the run that it starts from, so there is nothing of it to measure.
    assert [call[:2] for call in arrive.calls[1:]] == [
        (command, str(tmp_path / "policies" / "all")) for command in ("eval", "export")
    ]
    with pytest.raises(ArriveError, match=r"'al'.* Did you mean 'all'"):
        campaign.run(replace(arguments(tmp_path, 5.0), also=("al",)), FakeArrive())


def test_a_measurement_holds_for_the_samples_that_it_was_made_with(tmp_path):
    assert not campaign.measured(tmp_path)
    write_checkpoint(tmp_path, 2)
    (tmp_path / "difficulty.json").write_text('{"policy": {"samples": 12288}}')
    assert not campaign.measured(tmp_path)
    (tmp_path / "difficulty.json").write_text('{"policy": {"samples": 24576}}')
    assert campaign.measured(tmp_path)


def test_processes_share_the_robots_of_a_run(tmp_path, monkeypatch):
    arrive = FakeArrive()
    queue = '[[run]]\nname = "a"\nterrain = "flat"\nmillion_samples = 1.0\nset = ["num_envs=512", "ppo.num_steps=4"]\n'
    asked = replace(arguments(tmp_path, 5.0, queue), processes=2)
    campaign.run(asked, arrive, arrive.clock)
    (call,) = arrive.calls
    assert call[call.index("--set") + 1 :] == ("num_envs=512", "ppo.num_steps=4", "num_envs=256")
    # 256 robots x 4 steps of each of two processes.
    assert call[call.index("--iterations") + 1] == str(math.ceil(1e6 / 2048))
    launched = []
    monkeypatch.setattr(
        campaign.subprocess, "run", lambda words, **options: launched.append(words) or CompletedProcess(words, 0)
    )
    campaign.command_line(2, *call)
    assert "--nproc-per-node=2" in launched[0]
    assert launched[0][launched[0].index("arrive.cli") :] == ["arrive.cli", *call]


def test_a_run_may_have_processes_of_its_own(tmp_path):
    arrive = FakeArrive()
    queue = '[[run]]\nname = "a"\nterrain = "flat"\nmillion_samples = 1.0\nprocesses = 4\nset = ["ppo.num_steps=12"]\n'
    campaign.run(replace(arguments(tmp_path, 1000.0, queue), processes=2), arrive, arrive.clock)
    assert arrive.calls[0][-1] == "num_envs=256"
    assert [(call[0], count) for call, count in zip(arrive.calls, arrive.processes, strict=True)] == [
        *[("train", 4)] * 3,
        ("eval", 1),
        ("export", 1),
    ]


def test_robots_that_processes_cannot_share_evenly_are_refused(tmp_path):
    queue = '[[run]]\nname = "a"\nterrain = "flat"\nmillion_samples = 1.0\nset = ["num_envs=15"]\n'
    with pytest.raises(ArriveError, match="15 robots, which 2 processes"):
        campaign.run(replace(arguments(tmp_path, 5.0, queue), processes=2), FakeArrive())


def test_a_run_may_start_from_a_folder_outside_the_queue(tmp_path):
    arrive = FakeArrive()
    queue = '[[run]]\nname = "a"\nterrain = "flat"\nmillion_samples = 1.0\nstart_from = "before"\n'
    campaign.run(arguments(tmp_path, 5.0, queue), arrive, arrive.clock)
    (call,) = arrive.calls
    assert call[call.index("--start-from") + 1] == str(ROOT / "policies" / "walk")


def test_the_record_of_a_command_names_no_place_of_this_machine(monkeypatch, tmp_path):
    calls = []
    monkeypatch.setattr(
        campaign.subprocess,
        "run",
        lambda words, cwd, **options: calls.append((words, cwd)) or CompletedProcess(words, 1),
    )
    with pytest.raises(ArriveError, match=r"arrive eval policies/gap --episodes 5 .* failed"):
        campaign.command_line(1, "eval", ROOT / "policies" / "gap", "--episodes", 5, "--json", tmp_path)
    ((words, cwd),) = calls
    assert (words[3:], cwd) == (["eval", "policies/gap", "--episodes", "5", "--json", str(tmp_path)], ROOT)


def entry(name: str, start: str | None = None, samples: str = "1.0") -> str:
    """A run of the queue."""
    begins = "" if start is None else f'start_from = "{start}"\n'
    return f'[[run]]\nname = "{name}"\nterrain = "flat"\nmillion_samples = {samples}\n{begins}'


@pytest.mark.parametrize(
    ("queue", "message"),
    [
        ("nonsense", "not a queue"),
        ('[[run]]\nname = "a"\nterrain = "flat"\n', "not a queue"),
        ('[[run]]\nname = "a"\nterrain = "flat"\nmillion_samples = 1.0\nstart_from = "b"\n', "neither in the queue"),
        ('[[run]]\nname = "a"\nterrain = "nowhere"\nmillion_samples = 1.0\n', "nowhere"),
        (entry(""), "a run's name must be"),
        (entry("/tmp/evil"), "a run's name must be"),
        (entry("../../evil"), "a run's name must be"),
        (entry(".."), "a run's name must be"),
        (entry("a/b"), "a run's name must be"),
        (entry("a") + entry("a"), "a is listed more than once"),
        (entry("a", "a"), "in a circle: a <- a"),
        (entry("a", "b") + entry("b", "c") + entry("c", "a"), "in a circle: a <- b <- c <- a"),
        (entry("a", ""), "start_from of a must be"),
        (entry("a", "/tmp/run"), "start_from of a must be"),
        (entry("a", "policies/../../run"), "start_from of a must be"),
        (entry("a", samples="-1.0"), "must be positive"),
        (entry("a", samples="nan"), "must be positive"),
        (entry("a") + "seed = 1.5", "its seed a whole number"),
        (entry("a") + "set = [3]", "must be text"),
        (entry("a") + "processes = 0", "at least 1"),
    ],
)
def test_a_bad_queue_is_refused_before_anything_is_trained(tmp_path, queue, message):
    arrive = FakeArrive()
    with pytest.raises(ArriveError, match=message):
        campaign.run(arguments(tmp_path, 5.0, queue), arrive)
    assert not arrive.calls


def test_a_run_is_finished_by_its_checkpoint_not_by_its_log(tmp_path):
    """Killed after rows that no checkpoint has: the rows are dropped, and the run is not finished."""
    folder = tmp_path / "policies" / "flat"
    write_checkpoint(folder, 5)
    (folder / LOG_NAME).write_text("iteration,progress/samples,progress/elapsed_s\n9,110592.0,60.0\n")
    assert campaign.trained(folder)[0] == 5
    arrive = FakeArrive()
    campaign.run(arguments(tmp_path, 1000.0, entry("flat", samples="0.2")), arrive, arrive.clock)
    assert "--resume" in arrive.calls[0]
    assert campaign.trained(folder)[0] == 9
    (folder / CHECKPOINT_NAME).write_bytes(b"damaged")
    with pytest.raises(ArriveError, match="cannot read"):
        campaign.trained(folder)


def test_one_campaign_at_a_time_works_on_a_queue(tmp_path):
    arrive, asked = FakeArrive(), arguments(tmp_path, 5.0)
    with (
        Lock(asked.queue.with_suffix(".lock"), "the queue"),
        pytest.raises(ArriveError, match=r"the queue .*queue\.toml is in use by process"),
    ):
        campaign.run(asked, arrive, arrive.clock)
    assert not arrive.calls
    campaign.run(asked, arrive, arrive.clock)
    assert arrive.calls


def train_a_little(folder: Path, iterations: int, *options: str) -> None:
    """So many iterations of 16 samples."""
    small = ("ppo.hidden=[8]", "ppo.num_steps=4", "terrain.variants=1", "terrain.levels=2")
    common = ("--iterations", str(iterations), "--num-envs", "4", "--threads", "1", "--out", str(folder))
    main(["train", "pit", *common, *options, "--set", *small])


def test_a_run_knows_the_samples_of_all_the_runs_before(tmp_path):
    before, start = [], ()
    for name, iterations in (("first", 1), ("second", 3), ("third", 1)):
        train_a_little(tmp_path / name, iterations, *start)
        start = ("--start-from", str(tmp_path / name))
        before.append(read_run(tmp_path / name).samples_before)
    assert before == [0, 16, 64]
    main(["train", "pit", "--resume", str(tmp_path / "third"), "--iterations", "2", "--threads", "1"])
    third = read_run(tmp_path / "third")
    assert (third.samples_before, third.samples) == (64, 32)
    assert third.amount == "0.00 M samples after 0.0 M of the runs before"


def test_the_table_has_the_paper_beside_a_measured_run(tmp_path):
    folder = tmp_path / "pit"
    train_a_little(folder, 1)
    level = {"value": 0.05, "episodes": 500, "success": 0.99, "interval": [0.97, 1.0], "failures": {}}
    limits = {"max_at_95": 0.05, "max_at_80": 0.05, "max_at_50": None}
    family = {"parameter": "depth", "unit": "m", "levels": [level], **limits}
    content = {"families": {"pit": family}, "policy": {"samples": 123_000_000}}
    (folder / "difficulty.json").write_text(json.dumps(content))
    text = campaign.table_text([campaign.read_run(folder)])
    row = next(line for line in text.splitlines() if line.startswith("| pit"))
    assert row.endswith("| 0.1 | 0.65 | 0.95 | 0.05 / 0.05 / - |")
    assert "123.00 M samples, seed 1" in text
