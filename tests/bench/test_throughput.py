"""`arrive bench`: all rates, measured by wall time, with the environment's own states in the raw engine."""

import json

import numpy as np
import pytest
import torch

from arrive.bench import throughput
from arrive.bench.throughput import RATES, RawEngine, bench_throughput
from arrive.build import build_env
from arrive.cli import main
from arrive.commands import bench as command
from arrive.config import override
from arrive.presets import get_preset

SMALL = override(
    get_preset("robust"),
    ("num_envs=12", "terrain.variants=2", "ppo.hidden=[16]", "ppo.num_steps=4", "terrain.levels=2"),
)


def test_the_raw_engine_makes_the_same_step_as_the_environment():
    env = build_env(SMALL, threads=1)
    engine = RawEngine(env.physics, SMALL.physics, threads=1)
    generator = torch.Generator().manual_seed(3)
    for _ in range(5):
        actions = torch.randn(12, env.num_actions, generator=generator)
        engine.load(env.joint_targets(actions).numpy())
        engine.step()
        env.physics.step(env.joint_targets(actions))
        expected = env.physics.state_dict()
        for name in ("qpos", "qvel"):
            assert np.array_equal(engine.state(name), expected[name].numpy())


def test_rates_are_samples_per_wall_time(monkeypatch):
    ticks = iter(range(100_000))
    monkeypatch.setattr(throughput.time, "perf_counter", lambda: float(next(ticks)))
    result = bench_throughput(SMALL, threads=1, rounds=3)
    # Every timed piece takes one tick: 4 steps of engine and environment, and one each of the others.
    assert result["engine"] == result["env"] == 12 * 4 / 4
    assert result["collect"] == result["update_samples_per_s"] == result["train_samples_per_s"] == 12 * 4
    assert result["env_over_engine"] == 1.0
    assert result["ranges"]["env"] == [12.0, 12.0]
    assert sum(result["share"].values()) == pytest.approx(1.0)


def test_a_time_difference_is_never_negative_beside_a_busy_process():
    """Every measurement in turn is the one that another process has slowed down."""
    for slow in RATES:
        share = throughput._shares({name: 1.0 if name == slow else 100.0 for name in RATES})
        assert min(share.values()) >= 0.0
        assert sum(share.values()) == pytest.approx(1.0)


def test_the_command_writes_all_results(tmp_path, capsys):
    path = tmp_path / "new" / "bench.json"
    settings = ("terrain.variants=1", "ppo.num_steps=4", "ppo.hidden=[16]")
    main(
        ["bench", "flat", "--num-envs", "8", "--rounds", "2", "--threads", "1", "--json", str(path), "--set", *settings]
    )
    result = json.loads(path.read_text())
    assert all(result[name] > 0.0 for name in RATES)
    assert result["env_over_engine"] > 0.0
    assert all(0.0 < low <= result[name] <= high for name, (low, high) in result["ranges"].items())
    assert (result["num_envs"], result["threads"], result["networks"]) == (8, 1, [16])
    assert "environment over engine" in capsys.readouterr().out


@pytest.mark.parametrize("content", ['{"config": {}}', '{"protocol": {}}', "[1]", "no JSON", "", "\0"])
def test_a_file_of_another_kind_is_not_replaced_without_force(tmp_path, capsys, monkeypatch, content):
    results = iter((1.0, 2.0))
    monkeypatch.setattr(command, "_throughput", lambda options: {"env_over_engine": next(results)})
    monkeypatch.setattr(command, "_print", lambda result: None)
    path = tmp_path / "config.json"
    path.write_text(content)
    with pytest.raises(SystemExit):
        main(["bench", "flat", "--json", str(path)])
    assert f"{path} holds something else than a result of this command; give --force" in capsys.readouterr().err
    assert path.read_text() == content
    main(["bench", "flat", "--json", str(path), "--force"])
    main(["bench", "flat", "--json", str(path)])
    assert json.loads(path.read_text()) == {"env_over_engine": 2.0}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--rounds", "0"), "--rounds must be at least 1"),
        (("--policy", "x.onnx"), "--start-from"),
        (("nowhere",), "nowhere"),
        (("--start-from", "nowhere"), "there is no file"),
    ],
)
def test_options_that_cannot_be_measured_are_refused_with_a_reason(arguments, message, capsys):
    with pytest.raises(SystemExit):
        main(["bench", *arguments, "--num-envs", "8", "--threads", "1"])
    assert message in capsys.readouterr().err
