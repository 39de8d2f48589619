"""`arrive bench --deployment`: what it measures, and which options it refuses."""

import pytest

from arrive.bench.control_loop import WalkInputs
from arrive.bench.deployment import bench_deployment, print_deployment
from arrive.deployment import Controller
from arrive.errors import ArriveError


@pytest.fixture(scope="module")
def result(exported):
    return bench_deployment((exported,), hidden=(64, 32), steps=200)


def test_both_policies_are_measured(result, capsys):
    random, given = result["policies"]
    assert random["hidden"] == [64, 32]
    assert given["hidden"] == [256, 128, 64]
    for row in (random, given):
        latency = row["latency_ms"]
        assert 0.001 < latency["median"] <= latency["p99"] <= latency["max"]
        # An interpreter with NumPy takes 30 MB at least, and one with torch takes 200 MB and more.
        assert 30.0 < row["resident_mb"] < 150.0
    print_deployment(result)
    printed = capsys.readouterr().out
    assert "64-32" in printed
    assert "200 steps" in printed


def test_a_result_is_met_if_it_is_within_its_target(monkeypatch):
    monkeypatch.setattr("arrive.bench.deployment.TARGETS", {"median": 1e-6, "p99": 1e3, "resident": 1e6})
    assert not bench_deployment(hidden=(8,), steps=5)["policies"][0]["met"]
    monkeypatch.setattr("arrive.bench.deployment.TARGETS", {"median": 1e3, "p99": 1e3, "resident": 1e6})
    assert bench_deployment(hidden=(8,), steps=5)["policies"][0]["met"]


def test_every_input_changes_and_the_policy_acts_on_all_of_them(exported):
    controller = Controller.load(exported)
    walk, modes, seen = WalkInputs(controller), set(), []
    for i in range(100):
        inputs = walk.at(0.02 * i)
        command = controller.step(*inputs, 0.02 * i)
        modes.add(command.mode)
        seen.append((inputs[0].joint_pos.tobytes(), inputs[1], inputs[2].origin_w.tobytes(), command.targets.tobytes()))
        assert "of the ground seen" in command.reason or not command.reason
    assert modes == {"joystick"}
    assert all(len(set(column)) == 100 for column in zip(*seen, strict=True))


def test_options_that_cannot_be_measured_are_refused_with_a_reason(tmp_path):
    with pytest.raises(ArriveError, match="at least 1"):
        bench_deployment(steps=0)
    with pytest.raises(ArriveError, match=r"ppo\.hidden"):
        bench_deployment(hidden=(), steps=5)
    with pytest.raises(ArriveError, match="no file"):
        bench_deployment((tmp_path / "absent.onnx",), hidden=(8,), steps=5)
