import json

import pytest

from loading import load

TINY = ("num_envs=16", "ppo.num_steps=4", "ppo.hidden=[16]", "terrain.levels=2", "terrain.variants=1")


@pytest.fixture(scope="module")
def benchmark():
    return load("benchmarks/from_scratch.py")


def test_it_trains_measures_and_continues_after_an_interruption(benchmark, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")  # films are not what is tested
    arguments = benchmark.Arguments(("flat",), (1, 2), "200", TINY, processes=1, episodes=2, out=tmp_path)
    benchmark.main(arguments)
    rows = json.loads((tmp_path / "table.json").read_text())["runs"]
    assert [(row["terrain"], row["seed"], row["samples"]) for row in rows] == [("flat", 1, 256.0), ("flat", 2, 256.0)]
    assert all(list(row["success"]) == ["flat"] for row in rows)
    before = [path.stat().st_mtime_ns for path in sorted(tmp_path.glob("*/difficulty.json"))]
    benchmark.main(arguments)
    assert [path.stat().st_mtime_ns for path in sorted(tmp_path.glob("*/difficulty.json"))] == before
    assert (tmp_path / "table.md").read_text().count("| flat | 1 | 0.0 M |") == 1


def test_samples_to_each_level(benchmark):
    log = [{"level/gap": x, "progress/samples": str(i)} for i, x in enumerate(["", "0.4", "1.1", "0.9", "3.2"])]
    assert benchmark.climb(log, "level/gap") == [2.0, 4.0, 4.0]
