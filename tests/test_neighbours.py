"""torch's waiting threads sleep if other processes need the CPUs, and only then."""

import os
import subprocess
import sys

import pytest

from arrive import neighbours
from arrive.neighbours import busy_cpus, wait_considerately


@pytest.fixture(autouse=True)
def nothing_chosen(monkeypatch):
    for name in neighbours.CHOSEN:
        monkeypatch.delenv(name, raising=False)
    yield
    os.environ.pop("OMP_WAIT_POLICY", None)


@pytest.mark.parametrize(("busy", "policy"), [(0.0, None), (0.1, None), (1.0, "PASSIVE")])
def test_threads_sleep_beside_a_busy_neighbour(monkeypatch, busy, policy):
    monkeypatch.setattr(neighbours, "busy_cpus", lambda: busy)
    wait_considerately()
    assert os.environ.get("OMP_WAIT_POLICY") == policy


@pytest.mark.parametrize("name", neighbours.CHOSEN)
def test_a_setting_of_the_user_is_kept(monkeypatch, name):
    monkeypatch.setattr(neighbours, "busy_cpus", lambda: 2.0)
    monkeypatch.setenv(name, "ACTIVE")
    wait_considerately()
    assert os.environ.get("OMP_WAIT_POLICY") == ("ACTIVE" if name == "OMP_WAIT_POLICY" else None)


def test_time_is_counted_on_our_own_cpus_without_waiting(monkeypatch, tmp_path):
    """user 100 + nice 20 + system 30 + irq 1 + softirq 2 + steal 3 of cpu1; neither its idle time nor cpu0."""
    stat = tmp_path / "stat"
    stat.write_text("cpu 9 9 9 9 9 9 9 9 0 0\ncpu0 7 7 7 7 7 7 7 7 0 0\ncpu1 100 20 30 5000 600 1 2 3 0 0\nctxt 5\n")
    monkeypatch.setattr(neighbours, "STAT", stat)
    monkeypatch.setattr(neighbours.os, "sched_getaffinity", lambda process: {1})
    assert neighbours._seconds() == pytest.approx(156 / os.sysconf("SC_CLK_TCK"))
    stat.unlink()
    assert busy_cpus(0.01) == 0.0


def test_a_busy_process_is_detected():
    """Whatever else runs: one that is always ready to run keeps a CPU busy, or waits for others that do."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        assert busy_cpus(0.5) > 0.1
    finally:
        process.kill()
        process.wait()
