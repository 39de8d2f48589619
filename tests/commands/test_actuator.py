"""`arrive actuator` through the command line: from a simulated drive to an exported policy that was trained on it."""

import json
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from actuator_networks import lstm
from arrive import cli
from arrive.actuation.network_file import read_network
from arrive.deployment.policy_file import read_policy_file

TINY = [
    "task.episode_s=0.4",
    "task.episode_min_s=0.4",
    "task.reward_window_s=0.4",
    "ppo.hidden=[16]",
    "ppo.symmetry=false",
    "ppo.num_steps=8",
    "terrain.levels=2",
    "terrain.variants=1",
]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def refused(capsys, *arguments: object) -> str:
    with pytest.raises(SystemExit) as stopped:
        cli.main([str(argument) for argument in arguments])
    err = capsys.readouterr().err
    assert stopped.value.code == 1, err
    assert err.startswith("arrive: ")
    assert err.count("\n") == 1
    return err


def test_record_fit_show_train_export(tmp_path, capsys):
    cli.main(["actuator", "record", "-o", "log.csv", "--joints", "5", "--seconds", "2"])
    cli.main(["actuator", "fit", "log.csv", "-o", "drive.safetensors", "--epochs", "4", "--threads", "1"])
    said = capsys.readouterr().out
    assert "5 trajectories, 4 epochs" in said
    network = read_network(tmp_path / "drive.safetensors", 0.005)
    assert network.units == (8, 8)
    assert network.data == "log.csv"
    assert f"RMS {network.error_nm:.2f} N m" in said
    cli.main(["actuator", "show", "drive.safetensors", "-o", "motors.png", "--clip", "constant"])
    assert f"lstm of 8-8 units every 0.005 s, error {network.error_nm:.2f} N m RMS" in capsys.readouterr().out
    for name in ("drive.png", "motors.png"):
        assert (tmp_path / name).stat().st_size < 100_000
        with Image.open(tmp_path / name) as picture:
            assert len(picture.convert("RGB").getcolors(1 << 20)) > 20

    motor = ["physics.motor=network", "physics.motor_file=drive.safetensors", "physics.motor_clip=constant"]
    run = ["--num-envs", "16", "--threads", "1", "--out", "run", "--set", *TINY, *motor]
    cli.main(["train", "flat", "--iterations", "2", *run])
    saved = json.loads((tmp_path / "run" / "config.json").read_text())["config"]["physics"]
    assert (saved["motor"], saved["motor_clip"]) == ("network", "constant")
    (tmp_path / "drive.safetensors").unlink()  # the run has a copy of its own, wherever its folder goes
    (tmp_path / "run").rename(tmp_path / "moved")
    cli.main(["train", "flat", "--iterations", "3", "--threads", "1", "--resume", "moved"])
    evaluation = ["--episodes", "1", "--level", "0", "--threads", "1"]
    cli.main(["eval", "moved", *evaluation])
    cli.main(["export", "moved", "-o", "policy.onnx"])
    file = read_policy_file(tmp_path / "policy.onnx")
    assert len(file.robot.joint_names) == 12


def test_bad_input_is_one_line(tmp_path, capsys):
    assert "name at least one log" in refused(capsys, "actuator", "fit")
    assert "name at least one network" in refused(capsys, "actuator", "show")
    assert "no such file" in refused(capsys, "actuator", "show", "drive.safetensors")
    assert "cannot read" in refused(capsys, "actuator", "fit", "nothing.csv")
    assert "a multiple of 0.0002" in refused(capsys, "actuator", "record", "--period-s", "0.0005001")
    assert "--epochs must be at least 1" in refused(capsys, "actuator", "fit", "log.npz", "--epochs", "0")
    cli.main(["actuator", "record", "-o", "log.npz", "--joints", "5", "--seconds", "1.5"])
    assert "--units must be positive, and equal" in refused(capsys, "actuator", "fit", "log.npz", "--units", "8", "4")
    network = ["physics.motor=network", "physics.motor_file=gone.safetensors"]
    assert "gone.safetensors: no such file" in refused(capsys, "train", "flat", "--set", *network)
    assert "go together" in refused(capsys, "train", "flat", "--set", network[0])


@pytest.mark.parametrize(
    ("words", "suffix"),
    [
        (("actuator", "record", "-o", "kept.txt"), ".npz or .csv"),
        (("actuator", "fit", "log.npz", "-o", "kept.txt"), ".safetensors"),
        (("actuator", "show", "drive.safetensors", "-o", "drive.safetensors"), ".png"),
        (("actuator", "import", "arrays.npz", "-o", "arrays.npz"), ".safetensors"),
        (("export", "run", "-o", "run/policy.pt"), ".onnx"),
        (("eval", "run", "--json", "run/log.csv"), ".json"),
        (("energy", "run", "--json", "energy.png"), ".json"),
        (("gait", "run", "--json", "gait"), ".json"),
        (("report", "run", "--out", "run/log.csv"), ".html or .htm"),
        (("drive", "--log", "run/policy.pt"), ".npz"),
        (("showreel", "-o", "film.mp4"), ".webp"),
        (("bench", "flat", "--json", "kept.txt"), ".json"),
    ],
)
def test_a_slip_replaces_no_file_of_another_kind(capsys, words, suffix):
    assert f"must be a file that ends in {suffix}, not {words[-1]}" in refused(capsys, *words)


def test_import_writes_a_network(tmp_path):
    scales = {"in_scale": np.array([2.0, 0.25]), "out_scale": np.array([20.0])}
    np.savez(tmp_path / "arrays.npz", **lstm().weights, **scales)
    cli.main(["actuator", "import", "arrays.npz", "-o", "drive.safetensors", "--data", "somebody's, BSD-3"])
    network = read_network(tmp_path / "drive.safetensors")
    assert (network.error_scale, network.velocity_scale, network.torque_scale) == (2.0, 0.25, 20.0)
    assert network.data == "somebody's, BSD-3"


def test_help_needs_neither_torch_nor_mujoco():
    code = "import sys, arrive.cli; sys.exit(bool({'torch', 'mujoco', 'numpy'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
