"""What a robot's computer gets: the wheel without its dependencies, NumPy and onnxruntime."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def run(*command: str | Path, **options) -> subprocess.CompletedProcess:
    # Without this checkout on the path.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(command, env=environment, capture_output=True, text=True, **options)


def done(result: subprocess.CompletedProcess) -> str:
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Built from a copy, so that nothing of it stays in the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    copy = folder / "checkout"
    copy.mkdir()
    for name in ("src", "pyproject.toml", "README.md", "LICENSE"):
        (copy / name).symlink_to(ROOT / name) if name != "src" else done(run("cp", "-r", ROOT / name, copy / name))
    done(run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", folder, copy))
    (found,) = folder.glob("arrive-*.whl")
    return found


@pytest.fixture(scope="module")
def robot(wheel, tmp_path_factory):
    """Folder of the programs of a fresh environment."""
    folder = tmp_path_factory.mktemp("robot")
    done(run(sys.executable, "-m", "venv", folder / "venv"))
    python = folder / "venv" / "bin" / "python"
    done(run(python, "-m", "pip", "install", "--quiet", "numpy", "onnxruntime"))
    done(run(python, "-m", "pip", "install", "--quiet", "--no-deps", wheel))
    assert run(python, "-c", "import tyro").returncode != 0
    return python.parent


@pytest.fixture(scope="module")
def policy(wheel, tmp_path_factory):
    """The policy that is in the wheel."""
    folder = tmp_path_factory.mktemp("policy")
    with zipfile.ZipFile(wheel) as file:
        return Path(file.extract("arrive/policies/joystick.onnx", folder))


@pytest.mark.slow
def test_verify_runs_in_both_ways_and_refuses_in_one_line(robot, policy, tmp_path):
    for command in ((robot / "arrive", "verify"), (robot / "python", "-m", "arrive.deployment.verify")):
        said = done(run(*command, policy, cwd=tmp_path))
        assert "is sound: anymal_c, 12 joints" in said
        assert "16 golden pairs met" in said
    damaged = bytearray(policy.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    (tmp_path / "damaged.onnx").write_bytes(damaged)
    for path in ("damaged.onnx", "none.onnx"):
        result = run(robot / "arrive", "verify", path, cwd=tmp_path)
        assert result.returncode == 1
        assert result.stderr.startswith("arrive: ")
        assert result.stderr.count("\n") == 1


@pytest.mark.slow
def test_the_minimal_example_runs(robot, policy, tmp_path):
    said = done(run(robot / "python", ROOT / "examples" / "minimal.py", policy, cwd=tmp_path))
    assert len(said.splitlines()) == 13
    assert said.splitlines()[-1] == "mode: joystick"


@pytest.mark.slow
def test_other_commands_say_what_is_missing(robot, tmp_path):
    result = run(robot / "arrive", "train", "flat", cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "pip install arrive" in result.stderr
