"""The wheel in a fresh environment with all dependencies, and on a robot with only NumPy and onnxruntime."""

import json
import os
import site
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from arrive.policies import shipped_names

ROOT = Path(__file__).parent.parent


def run(*command: str | Path, **options) -> subprocess.CompletedProcess:
    # Without this checkout on the path.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    # Pictures are not what is tested, and a film takes a minute.
    environment["MUJOCO_GL"] = "disable"
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
    for name in ("src", "policies", "pyproject.toml", "setup.py", "README.md", "LICENSE"):
        done(run("cp", "-r", ROOT / name, copy / name))
    done(run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", folder, copy))
    (found,) = folder.glob("arrive-*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The program of an environment that has the wheel, and all else from the one that runs this test."""
    folder = tmp_path_factory.mktemp("installed")
    done(run(sys.executable, "-m", "venv", "--without-pip", folder))
    python = folder / "bin" / "python"
    done(run(sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index", wheel))
    own = done(run(python, "-c", "import site; print(site.getsitepackages()[0])")).strip()
    (Path(own) / "others.pth").write_text("\n".join(site.getsitepackages()) + "\n")
    assert own in done(run(python, "-c", "import arrive; print(arrive.__file__)", cwd=folder))
    return folder / "bin" / "arrive"


def test_the_wheel_says_that_it_has_types(wheel):
    assert "arrive/py.typed" in zipfile.ZipFile(wheel).namelist()


def test_the_wheel_has_the_licence_alone_as_its_licence_file(wheel):
    (licence,) = (name for name in zipfile.ZipFile(wheel).namelist() if "/licenses/" in name)
    assert zipfile.ZipFile(wheel).read(licence) == (ROOT / "LICENSE").read_bytes()


def test_shipped_policies_work_without_a_checkout(installed, tmp_path):
    listed = done(run(installed, "list", "policies", cwd=tmp_path))
    assert all(name in listed for name in shipped_names())
    name = shipped_names()[0]
    done(run(installed, "export", name, "-o", "robot.onnx", cwd=tmp_path))
    assert "is sound: anymal_c" in done(run(installed, "verify", "robot.onnx", cwd=tmp_path))
    few = ("--terrain", "flat", "--level", "0", "--episodes", "4", "--threads", "1")
    for policy in (name, "robot.onnx"):
        done(run(installed, "eval", policy, *few, "--json", f"{policy}.json", cwd=tmp_path))
    first, second = (
        json.loads((tmp_path / f"{policy}.json").read_text())["families"] for policy in (name, "robot.onnx")
    )
    assert first == second, "an exported file is measured like its policy"
    written = {path.parts[0] for path in (path.relative_to(tmp_path) for path in tmp_path.iterdir())}
    assert written <= {"robot.onnx", f"{name}.json", "robot.onnx.json", "runs", "robot"}
    wrong = run(installed, "eval", f"{name}{name[-1]}", cwd=tmp_path)
    assert wrong.returncode == 1
    assert f"Did you mean {name}?" in wrong.stderr


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


@pytest.mark.slow
def test_verify_runs_in_both_ways_and_refuses_in_one_line(robot, exported, tmp_path):
    for command in ((robot / "arrive", "verify"), (robot / "python", "-m", "arrive.deployment.verify")):
        said = done(run(*command, exported, cwd=tmp_path))
        assert "is sound: anymal_c, 12 joints" in said
        assert "16 golden pairs reproduced" in said
    damaged = bytearray(exported.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    (tmp_path / "damaged.onnx").write_bytes(damaged)
    for path in ("damaged.onnx", "none.onnx"):
        result = run(robot / "arrive", "verify", path, cwd=tmp_path)
        assert result.returncode == 1
        assert result.stderr.startswith("arrive: ")
        assert result.stderr.count("\n") == 1


@pytest.mark.slow
def test_the_minimal_example_runs(robot, exported, tmp_path):
    said = done(run(robot / "python", ROOT / "examples" / "minimal.py", exported, cwd=tmp_path))
    assert len(said.splitlines()) == 13
    assert said.splitlines()[-1] == "mode: joystick"


@pytest.mark.slow
def test_other_commands_say_what_is_missing(robot, tmp_path):
    result = run(robot / "arrive", "train", "flat", cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "pip install ." in result.stderr
