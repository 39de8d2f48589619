"""A robot with six legs of four joints: trained, exported, controlled, measured and drawn."""

import socket

import numpy as np
import pytest
from PIL import Image

from arrive import cli
from arrive.build import build_env
from arrive.deployment import Controller, Joystick, Target
from arrive.deployment.policy_file import read_policy_file
from arrive.evaluation.gait import GaitRecording, describe_gait, foot_labels, gait_content
from arrive.learning.policy import load_policy
from arrive.recipe import make_config
from arrive.render import pictures
from arrive.report.figure import svg_text
from arrive.report.gait_chart import gait_figure
from arrive.robots import ROBOTS
from arrive.simulation import SimulatedRobot
from arrive.terrain import FAMILIES, parse_families
from arrive.terrain.ground import ground_of
from hexapod import HEXAPOD
from settings import SHORT


@pytest.fixture(scope="module", autouse=True)
def registered():
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(ROBOTS, HEXAPOD.name, HEXAPOD)
        yield


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run of two iterations, and the file exported from it."""
    folder = tmp_path_factory.mktemp("hexapod") / "run"
    run = ["--robot", "hexapod", "--iterations", "2", "--num-envs", "16", "--threads", "1", "--out", str(folder)]
    cli.main(["train", "flat", *run, "--set", *SHORT])
    cli.main(["export", str(folder), "-o", str(folder / "hexapod.onnx")])
    return folder


def test_it_is_reset_and_steps_on_every_terrain():
    config = make_config(parse_families("all"), num_envs=2 * len(FAMILIES), overrides=tuple(SHORT), robot="hexapod")
    env = build_env(config, threads=1)
    assert env.num_actions == 24
    for _ in range(40):
        observation, reward, _, _ = env.step(0.1 * np.pi * (env._uniform(env.num_envs, 24) - 0.5))
        assert bool(observation["policy"].isfinite().all())
        assert bool(reward.isfinite().all())
    heights = env.state.base_pos_w[:, 2]
    assert float(heights.max()) < 2.0
    assert not env.log.diverged


def test_its_networks_answer_its_front_back_image_with_the_reflected_action(trained):
    policy = load_policy(trained)
    facing = policy.actor.facing
    assert len(facing.side) == 1
    rng = np.random.default_rng(0)
    index, sign = facing.observation_index[0], facing.observation_sign[0]
    observation = sign.new_tensor(rng.normal(size=(8, len(sign))))
    expected = policy.act(observation)[:, facing.action_index[0]] * facing.action_sign[0]
    np.testing.assert_allclose(policy.act(observation[:, index] * sign), expected, atol=1e-5)


def test_a_controller_runs_it(trained, capsys):
    """Each joint's own motor is in the file, and what the controller asks for stays within its limits."""
    cli.main(["verify", str(trained / "hexapod.onnx")])
    assert "is sound: hexapod, 24 joints" in capsys.readouterr().out
    file = read_policy_file(trained / "hexapod.onnx")
    assert file.robot.effort_limit == [motor.effort_limit for motor in HEXAPOD.motors]
    policy = load_policy(trained)
    robot, controller = SimulatedRobot(policy.config, ground_of("flat").build()), Controller(file)
    stiffness, damping = np.array(file.robot.stiffness), np.array(file.robot.damping)
    modes = set()
    for step in range(50):
        goal = Target((1.0, 0.0, file.task.target_height_m), 2.0) if step < 25 else Joystick(1.0, 0.0)
        sensors = robot.sensors()
        command = controller.step(sensors, goal, robot.height_map(), robot.time_s)
        asked = stiffness * (command.targets - sensors.joint_pos) - damping * sensors.joint_vel
        assert (np.abs(asked) <= np.array(file.robot.effort_limit) + 1e-9).all()
        modes.add(command.mode)
        robot.step(command.targets)
    assert modes == {"target", "joystick"}
    assert not robot.fell


def test_it_is_measured_and_drawn(trained, tmp_path, monkeypatch, capsys):
    """Picture strips, a film, the card's figures, and the charts of gait and energy."""
    monkeypatch.setattr(pictures, "FRAME_SIZE", (64, 48))
    monkeypatch.setattr(pictures, "FILM_SIZE", (96, 64))
    measured = [str(trained), "--threads", "1"]
    cli.main(["eval", *measured, "--episodes", "2", "--level", "0", "--pictures", str(tmp_path / "pictures")])
    said = capsys.readouterr().out
    if "no pictures" not in said:
        names = {path.suffix for path in (tmp_path / "pictures").iterdir()}
        assert names == {".png", ".mp4"}
    cli.main(
        ["gait", *measured, "--speeds", "0.5", "--seconds", "2", "--robots", "2", "--json", str(tmp_path / "g.json")]
    )
    cli.main(
        ["energy", *measured, "--speeds", "0.5", "--distance", "2", "--robots", "2", "--json", str(tmp_path / "e.json")]
    )
    for name in ("g.png", "e.png"):
        assert Image.open(tmp_path / name).size[0] > 300


def test_its_gait_is_a_tripod():
    """Six rows of bars, named by its feet."""
    time = np.arange(300) * 0.02
    first = (time % 0.5 < 0.3)[:, None, None]
    second = ((time + 0.25) % 0.5 < 0.3)[:, None, None]
    contact = np.concatenate([first, second, first, second, first, second], axis=2).repeat(3, axis=1)
    ones = np.ones((300, 3))
    record = GaitRecording(
        contact, np.stack([0.4 * ones, 0.0 * ones], axis=-1), 0.0 * ones, ones, np.ones(3, dtype=bool)
    )
    row = {"told_m_s": 0.4, "direction_deg": 0.0} | describe_gait(record, HEXAPOD.foot_corners(), 0.02)
    assert row["gait"] == "tripod"
    feet = foot_labels(HEXAPOD)
    assert feet == ["LF", "LM", "LH", "RF", "RM", "RH"]
    figure = gait_figure(gait_content([{"name": "six", "task": "final", "feet": feet, "gaits": [row]}], 3, 6.0, 1))
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert labels == feet[::-1]
    assert len(figure.axes[0].collections) == 6
    assert "tripod" in svg_text(figure)


def test_the_page_shows_it(trained):
    """Links, trail and one line per joint and foot."""
    pytest.importorskip("viser", reason="viser is not installed")
    from arrive.drive.pace import Pace
    from arrive.play.history import History
    from arrive.play.panel import Panel
    from arrive.play.playground import Playground
    from arrive.play.scene import Scene
    from arrive.play.server import open_server
    from arrive.play.skills import open_skill
    from arrive.play.trail import Trail

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    playground = Playground(open_skill(str(trained / "hexapod.onnx")), ground_of("flat"))
    server, _ = open_server("127.0.0.1", port)
    try:
        scene, panel = Scene(server, playground), Panel(server, playground, lambda request: None)
        history, trail = History(playground.control_dt), Trail(playground.control_dt)
        for _ in range(10):
            playground.step()
            history.append(playground.read())
            trail.append(playground.robot.data.site_xpos[: len(HEXAPOD.foot_sites)].copy())
        scene.update(playground.robot, follow=True)
        scene.show_trail(trail, len(HEXAPOD.foot_sites), True)
        panel.update(playground, Pace(playground.control_dt), history)
        assert len(scene._links) == 1 + 6 * 4  # every body with a shape: the trunk; femur, tibia, tarsus, foot
        assert len(panel._plots._torque.data) == 1 + 24
        assert len(panel._plots._contact.data) == 1 + 6
    finally:
        server.stop()
