"""The memory check: its estimates, and its message with the number that fits."""

import subprocess
import sys

import pytest

from arrive import cli, room
from arrive.errors import ArriveError
from arrive.memory import learning_bytes, network_bytes, robot_bytes
from arrive.recipe import make_config
from arrive.room import check_room, free_memory
from arrive.terrain import get_family

GIB = 2**30
MEASURE = r"""
import re, sys, tempfile, torch
from pathlib import Path
from arrive.build import build_env
from arrive.learning.trainer import Trainer
from arrive.recipe import make_config
from arrive.terrain import get_family

torch.set_num_threads(1)
# Not getrusage: a process begins with the peak of the one that has started it.
peak = lambda: int(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1]) * 1024
few = make_config((get_family("flat"),), num_envs=8, overrides=tuple(sys.argv[2:]))
for config in (few, make_config((get_family("flat"),), num_envs=int(sys.argv[1]), overrides=tuple(sys.argv[2:]))):
    before = peak()
    Trainer(config, build_env(config, threads=1), Path(tempfile.mkdtemp())).iterate(lambda report: None)
print(peak() - before)
"""


@pytest.fixture
def one_gib(monkeypatch):
    monkeypatch.setattr(room, "free_memory", lambda: GIB)


def test_too_many_items_are_refused_with_the_number_that_fits(one_gib):
    check_room(4, GIB / 4, "robots", "--num-envs")
    words = r"not enough memory for 5 robots: about 1\.7 GiB are needed and 1\.0 GiB are free; 2 fit, .*--num-envs"
    with pytest.raises(ArriveError, match=words):
        check_room(5, GIB / 4, "robots", "--num-envs", fixed=GIB / 4 + GIB / 20 * 4)
    with pytest.raises(ArriveError, match="free; choose fewer with --num-envs"):
        check_room(1, 1.0, "robots", "--num-envs", fixed=2 * GIB)
    with pytest.raises(ArriveError, match="not enough memory"):
        check_room(10**400, 1.0, "robots", "--num-envs")


def test_the_smaller_limit_of_machine_and_container_counts(monkeypatch, tmp_path):
    limit, use = tmp_path / "max", tmp_path / "current"
    monkeypatch.setattr(room, "GROUPS", ((str(limit), str(use)),))
    monkeypatch.setattr(room, "_machine_free", lambda: 5e9)
    assert free_memory() == 5e9
    limit.write_text("max\n")
    use.write_text("1000\n")
    assert free_memory() == 5e9
    limit.write_text("4000\n")
    assert free_memory() == 3000.0


def test_as_many_robots_as_fit_are_built_and_no_more(one_gib, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        cli.main(["train", "flat", "--num-envs", "1000000", "--threads", "1"])
    message = capsys.readouterr().err
    fitting = int(message.split("free; ")[1].split(" fit")[0].replace(",", ""))
    config = make_config((get_family("flat"),))
    need = robot_bytes(config) + learning_bytes(config)
    assert 0.5 * GIB < fitting * need <= GIB < (fitting + 1) * need + 0.5 * GIB
    assert not (tmp_path / "runs").exists() or not any((tmp_path / "runs").iterdir())


@pytest.mark.parametrize(
    ("num_envs", "settings"), [(1024, ()), (256, ("ppo.num_steps=96", "ppo.hidden=[512,256,128]"))]
)
def test_the_estimate_is_near_what_training_takes(num_envs, settings):
    settings = (*settings, "terrain.variants=1")
    result = subprocess.run(
        [sys.executable, "-c", MEASURE, str(num_envs), *settings], capture_output=True, text=True, timeout=600
    )
    assert result.returncode == 0, result.stderr
    config = make_config((get_family("flat"),), num_envs=num_envs, overrides=settings)
    estimate = num_envs * (robot_bytes(config) + learning_bytes(config)) + network_bytes(config)
    assert 0.5 < estimate / float(result.stdout) < 2.0
