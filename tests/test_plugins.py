"""Modules of users: the guides in docs/extend.md work as written, and bad modules are refused."""

import csv
import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from arrive import cli, plugins
from arrive.build import build_env
from arrive.config import Config, from_dict, to_dict
from arrive.deployment import Controller, Target
from arrive.deployment.inputs import frame_of
from arrive.deployment.policy_file import read_policy_file
from arrive.deployment.terms import COMPUTED
from arrive.errors import ArriveError
from arrive.learning.policy import load_policy
from arrive.recipe import make_config
from arrive.robots import ROBOTS
from arrive.simulation import SimulatedRobot
from arrive.task.registry import TASKS
from arrive.task.task import TaskConfig
from arrive.terms import TERMS
from arrive.terrain import FAMILIES, parse_families
from arrive.terrain.ground import ground_of
from settings import SHORT

GUIDES = Path(__file__).parents[1] / "docs" / "extend.md"
RUN = ["--num-envs", "16", "--threads", "1", "--iterations", "1", "--out", "run", "--set", *SHORT]


@pytest.fixture(autouse=True)
def fresh(tmp_path, monkeypatch):
    """An empty folder with the guides' modules, and registries that forget them."""
    monkeypatch.chdir(tmp_path)
    for code in re.findall(r"```python\n(.*?)```", GUIDES.read_text(), re.DOTALL):
        (tmp_path / re.match(r"# (\w+\.py)\n", code)[1]).write_text(code)
    before = set(sys.modules)
    registries = (ROBOTS, FAMILIES, TASKS, TaskConfig.kinds, TERMS, COMPUTED, plugins._imported)
    saved = [(things, dict(things)) for things in registries]
    yield
    for things, content in saved:
        things.clear()
        things.update(content)
    for name in set(sys.modules) - before:
        if getattr(sys.modules[name], "__file__", None) and str(tmp_path) in str(sys.modules[name].__file__):
            del sys.modules[name]


def forget() -> None:
    """What another process would not know."""
    for things, names in ((ROBOTS, ("pup",)), (FAMILIES, ("ditch",)), (plugins._imported, ("pup", "ditch"))):
        for name in names:
            things.pop(name, None)
    for name in ("pup", "ditch"):
        sys.modules.pop(name, None)


def refused(capsys, *arguments: str) -> str:
    with pytest.raises(SystemExit) as stopped:
        cli.main(list(arguments))
    err = capsys.readouterr().err
    assert stopped.value.code == 1, err
    assert err.count("\n") == 1
    return err


def test_the_guides_terrain_and_robot_train_and_export(tmp_path, capsys):
    both = ["--import", "pup.py", "--import=ditch.py"]
    cli.main(["train", "ditch,flat", "--robot", "pup", *RUN, *both])
    record = json.loads((tmp_path / "run" / "config.json").read_text())
    assert record["imports"] == {"pup": str(tmp_path / "pup.py"), "ditch": str(tmp_path / "ditch.py")}
    assert record["config"]["terrain"]["families"] == ["ditch", "flat"]
    capsys.readouterr()
    cli.main(["list", "terrains", *both])
    assert "a ditch to walk through (depth 0.02 to 0.4 m)" in capsys.readouterr().out

    forget()
    assert "unknown robot 'pup'" in (message := refused(capsys, "train", "flat", "--robot", "pup"))
    assert "add your own with --import FILE.py" in message
    go_on = ["train", "ditch,flat", "--resume", "run", "--iterations", "2", "--threads", "1"]
    assert "needs the module 'pup': add --import" in refused(capsys, *go_on)
    assert "needs the module 'pup': add --import" in refused(capsys, "export", "run")
    cli.main([*go_on, *both])
    cli.main(["export", "run", "-o", "pup.onnx", *both])
    assert read_policy_file("pup.onnx").robot.name == "pup"


def trained(task: str, tmp_path: Path) -> dict:
    """The record of a run of one iteration of a guide's task, and the policy exported from it."""
    option = ["--import", f"{task}.py"]
    cli.main(["train", "flat", "--task", task, *RUN, *option])
    cli.main(["export", "run", "-o", "policy.onnx", *option])
    return json.loads((tmp_path / "run" / "config.json").read_text())


def last_row(tmp_path: Path) -> dict[str, str]:
    with (tmp_path / "run" / "log.csv").open(newline="") as file:
        return list(csv.DictReader(file))[-1]


def test_the_guides_reward_is_paid(tmp_path, capsys):
    """Its cost is logged; the preset's other weights are kept; its weight is changed by name."""
    record = trained("calm", tmp_path)
    assert float(last_row(tmp_path)["rewards/tilt_cost"]) < 0.0
    rewards = record["config"]["task"]["rewards"]
    assert rewards["tilt_cost"] == {"weight": -0.5}
    assert rewards["task"] == {"weight": 10.0}
    families = parse_families("flat")
    changed = make_config(families, task="calm", overrides=("task.rewards.tilt_cost=-1",))
    assert changed.task.rewards.tilt_cost.weight == -1.0
    assert from_dict(Config, to_dict(changed)) == changed
    with pytest.raises(ArriveError, match="tilt_cost"):
        make_config(families, overrides=("task.rewards.tilt_cost=-1",))


def test_the_guides_observation_is_the_same_for_the_controller(tmp_path):
    """Training and controller compute the same from the same state, and without the module no controller runs it."""
    trained("tall", tmp_path)
    file = read_policy_file("policy.onnx")
    term = file.terms[-1]
    assert (term.name, term.stop - term.start, term.unit) == ("base_height", 1, "m")
    policy = load_policy(Path("run"))
    robot, controller = SimulatedRobot(policy.config, ground_of("flat").build()), Controller(file)
    goal = Target((1.0, 0.0, 0.5), 2.0)
    frame = frame_of(robot.sensors(), goal, robot.height_map(), 0.0, controller._grid)
    observation, _ = controller.observe(frame)
    assert observation[-1] == pytest.approx(2.0 * robot.base_pos_w[2])
    env = build_env(replace(policy.config, num_envs=2), threads=1)
    expected = 2.0 * env.state.base_pos_w[:, 2].numpy()
    assert env.observer.observe(env.state, env.task.command, env._generator)[:, -1].numpy() == pytest.approx(
        expected, abs=2.0 * 0.02 + 1e-6
    )
    COMPUTED.pop("base_height")
    with pytest.raises(ArriveError, match=r"unknown observation of the controller.*base_height"):
        Controller(file)


def test_the_guides_task_judges_by_its_own_rule(tmp_path, capsys):
    record = trained("halt", tmp_path)
    assert record["config"]["task"]["still_speed"] == 0.2
    capsys.readouterr()
    cli.main(["list", "tasks"])
    assert "a robot that still moves" in capsys.readouterr().out
    config = make_config(parse_families("flat"), task="halt", num_envs=2)
    env = build_env(config, threads=1)
    state, task = env.state, env.task
    task.command.target_w[:] = state.base_pos_w
    state.base_lin_vel_w[:] = 0.0
    state.base_lin_vel_w[1, 0] = 0.3
    nobody = torch.zeros(2, dtype=torch.bool)
    outcome = task.judge(state, nobody, nobody)
    assert outcome.success.tolist() == [True, False]
    assert outcome.failures["moving"].tolist() == [False, True]


def test_an_installed_package_needs_no_import(tmp_path, monkeypatch, capsys):
    info = tmp_path / "pup_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: pup-package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[arrive.plugins]\npup = pup\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    cli.main(["list", "robots"])
    assert "pup" in capsys.readouterr().out
    assert plugins.imported() == {"pup": "package pup-package"}
    forget()
    (tmp_path / "pup.py").write_text("raise RuntimeError('broken')")
    assert "package pup-package cannot be loaded" in refused(capsys, "list", "robots")


@pytest.mark.parametrize(
    ("code", "problem"),
    [
        ("1 / 0", "--import mine.py failed: ZeroDivisionError"),
        ("import nothing_like_it", "--import mine.py failed: ModuleNotFoundError"),
        (
            "from arrive.robots import get_robot, register_robot\nregister_robot(get_robot('go2'))",
            "a robot named 'go2' already exists",
        ),
        (
            "from dataclasses import replace\nfrom arrive.robots import get_robot, register_robot\n"
            "register_robot(replace(get_robot('go2'), name='mine', foot_sites=('a', 'b', 'c', 'd')))",
            "unknown site of robot 'mine' 'a'",
        ),
        (
            "from dataclasses import replace\nfrom arrive.robots import get_robot, register_robot\n"
            "register_robot(replace(get_robot('go2'), name='mine', mass=3.0))",
            "its bodies weigh 15.2064 kg, and mass is 3 kg",
        ),
        (
            "from dataclasses import replace\nfrom arrive.robots import get_robot, register_robot\n"
            "register_robot(replace(get_robot('go2'), name='mine', default_joint_pos=(9.0,) * 12))",
            "the default position of FL_hip_joint, 9 rad, is outside its range",
        ),
        (
            "from dataclasses import replace\nfrom arrive.terrain import get_family, register_terrain\n"
            "register_terrain(replace(get_family('gap'), name='mine', highest=4.0))",
            "terrain 'mine' with width 4 m",
        ),
        (
            "from dataclasses import replace\nfrom arrive.terrain import get_family, register_terrain\n"
            "register_terrain(replace(get_family('gap'), name='my gap'))",
            "'my gap' is not a valid terrain name",
        ),
        ("import sys\nsys.exit()", "--import mine.py failed: the module ends the program"),
        *(
            (
                "from dataclasses import replace\nfrom arrive.robots import get_robot, register_robot\n"
                "go2 = get_robot('go2')\n"
                f"register_robot(replace(go2, name='mine', {change}))",
                problem,
            )
            for change, problem in (
                ("size=0.0", "size must be a finite number above 0, not 0.0"),
                ("standing_height=float('nan')", "standing_height must be a finite number above 0, not nan"),
                ("foot_sites=(), foot_bodies=()", "foot_sites names no foot"),
                ("motors=(None,) * 12", "motors must be of the class Motor"),
                (
                    "motors=(replace(go2.motors[0], no_load_speed=0.0),) * 12",
                    "no_load_speed must be a finite number above 0, not 0.0",
                ),
                (
                    "motors=(replace(go2.motors[0], stall_torque=1.0),) * 12",
                    "stall_torque must be at least effort_limit",
                ),
                ("build_spec=lambda visuals: None", "build_spec must return an MjSpec, not NoneType"),
            )
        ),
    ],
)
def test_a_bad_module_is_one_line(tmp_path, capsys, code, problem):
    (tmp_path / "mine.py").write_text(code)
    assert problem in refused(capsys, "list", "robots", "--import", "mine.py")


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        (
            "    return spec",
            "    spec.add_mesh(name='m', file='gone.stl') if visuals else 0\n    return spec",
            "gone.stl",
        ),
        ("        collide(foot, ", "        (lambda *a, **b: 0)(foot, ", "the foot 'LF_FOOT' has no geom that touches"),
        (
            'add_hinge(hip, f"{leg}_ROLL", (1, 0, 0), (-0.8, 0.8))',
            'hip.add_joint(name=f"{leg}_ROLL", axis=(1, 0, 0))',
            "LF_ROLL has no range",
        ),
        (
            "    return spec",
            "    spec.add_actuator(name='a', target='LF_ROLL', trntype=mujoco.mjtTrn.mjTRN_JOINT)\n    return spec",
            "its model must have no actuators",
        ),
    ],
)
def test_a_bad_model_is_one_line(tmp_path, capsys, old, new, problem):
    guide = (tmp_path / "pup.py").read_text()
    assert old in guide
    (tmp_path / "pup.py").write_text(guide.replace(old, new))
    assert problem in refused(capsys, "list", "robots", "--import", "pup.py")


@pytest.mark.parametrize(
    ("task", "old", "new", "problem"),
    [
        (
            "calm",
            ".square().sum(-1)",
            ".square()",
            "the reward 'tilt_cost' must return a tensor of the shape (16,), not (16, 2)",
        ),
        ("calm", "return state.gravity_b", "state.gravity_b", "shape (16,), not NoneType"),
        ("calm", "state.gravity_b", "state.gravty_b", "calm.py, line 12: AttributeError: 'State' object has no"),
        (
            "tall",
            "[:, 2:3]",
            "[:, 0:2]",
            "observation 'base_height' must be a tensor of the shape (16, 1), not (16, 2)",
        ),
        ("tall", '("z",), 2.0', '("z",), 0.0', "needs a finite scale other than 0"),
        ("tall", "((0, 1.0),)", "((1, 1.0),)", "the reflection of the observation 'base_height' must name every entry"),
        ("tall", 'register_term("base_height"', '("base_height"', "unknown observation 'base_height'"),
        ("halt", "        outcome = super()", "        return None\n        outcome = super()", "perhaps in halt: "),
        ("halt", "success & ~moving,", "success[:1],", "outcome 'success' must be a bool tensor of the shape (16,)"),
        ("halt", '"moving": moving', '"moving": moving.float()', "outcome 'moving' must be a bool tensor"),
    ],
)
def test_a_fault_of_a_module_while_it_trains_is_one_line(tmp_path, capsys, task, old, new, problem):
    """It says where in the module, and not that it should be reported."""
    guide = (tmp_path / f"{task}.py").read_text()
    assert old in guide
    (tmp_path / f"{task}.py").write_text(guide.replace(old, new))
    told = refused(capsys, "train", "flat", "--task", task, *RUN, "--import", f"{task}.py")
    assert problem in told
    assert "please report" not in told


def test_a_missing_module_is_one_line(tmp_path, capsys):
    assert "there is no such file" in refused(capsys, "list", "--import", "gone.py")
    assert "ModuleNotFoundError" in refused(capsys, "list", "--import", "gone")
    for name in ("..", "a..b", "", "--", "torch/"):
        assert f"--import {name!r}: name a file that ends in .py" in refused(capsys, "list", "--import", name)
    (tmp_path / "json.py").write_text("")
    assert "a module named 'json' is already loaded" in refused(capsys, "list", "--import", "json.py")
