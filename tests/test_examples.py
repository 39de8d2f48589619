"""The examples run as they stand: the loops on a simulated robot, the C++ program, the ROS 2 node on a stand-in."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnxruntime
import pytest

import ros2_stub
from arrive import cli
from arrive.config import saved_config
from arrive.deployment import Controller, GridHeights, Sensors, Target
from arrive.simulation import SimulatedRobot
from arrive.terrain.ground import ground_of
from loading import load
from tiny_runs import train_words

EXAMPLES = Path(__file__).parent.parent / "examples"


def test_the_minimal_loop_prints_a_target_for_every_joint(capsys, exported):
    load("examples/minimal.py").main(str(exported))
    lines = capsys.readouterr().out.splitlines()
    names = Controller.load(exported).policy.robot.joint_names
    assert [line.split(":")[0] for line in lines] == [*names, "mode"]
    assert lines[-1] == "mode: joystick"


def test_the_loop_on_a_simulated_robot_is_short_and_brings_it_to_its_target(capsys, exported):
    assert len((EXAMPLES / "simulated_robot.py").read_text().splitlines()) < 80
    assert load("examples/simulated_robot.py").main(["--fast"]) < Controller.load(exported).policy.task.arrival_radius_m
    modes = [line.split()[2] for line in capsys.readouterr().out.splitlines()[:-1]]
    assert modes == ["target", "hold"]


# C++.


def cpp_parts() -> tuple[list[str], Path] | str:
    """Include folders and onnxruntime's library, or why the program cannot be built here.

    Environment variables ORT_INCLUDE, ORT_LIBRARY and JSON_INCLUDE name what lies elsewhere. The library of the Python
    package will do: its interface is versioned, so that older headers fit.
    """
    if shutil.which("g++") is None:
        return "there is no g++"
    roots = [Path(os.environ[name]) for name in ("ORT_INCLUDE", "JSON_INCLUDE") if name in os.environ]
    roots += [Path("/usr/include/onnxruntime"), Path("/usr/local/include/onnxruntime"), Path("/usr/include")]
    folders = []
    for header, package in (
        ("onnxruntime_cxx_api.h", "libonnxruntime-dev"),
        ("nlohmann/json.hpp", "nlohmann-json3-dev"),
    ):
        found = [root for root in roots if (root / header).is_file()]
        if not found:
            return f"there is no {header} ({package} on Debian 13)"
        folders.append(str(found[0]))
    capi = Path(onnxruntime.__file__).parent / "capi"
    libraries = [Path(os.environ["ORT_LIBRARY"])] if "ORT_LIBRARY" in os.environ else []
    libraries += [*Path("/usr/lib").glob("*/libonnxruntime.so"), *capi.glob("libonnxruntime.so.*")]
    return (folders, libraries[0]) if libraries else "there is no libonnxruntime.so"


@pytest.fixture(scope="module")
def run_policy(tmp_path_factory):
    """Builds the C++ program and gives a function that runs it."""
    parts = cpp_parts()
    if isinstance(parts, str):
        pytest.skip(parts)
    folder = tmp_path_factory.mktemp("cpp")
    (folder / "libonnxruntime.so.1").symlink_to(parts[1])
    includes = [f"-isystem{path}" for path in parts[0]]
    source, program = EXAMPLES / "cpp" / "run_policy.cpp", folder / "run_policy"
    subprocess.run(
        ["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", *includes, source, parts[1], "-o", program], check=True
    )
    # Also under the name that the library has in itself.
    environment = os.environ | {"LD_LIBRARY_PATH": f"{folder}:{parts[1].parent}"}
    return lambda *arguments: subprocess.run([program, *arguments], env=environment, capture_output=True, text=True)


def targets_of(result) -> list[float]:
    assert result.returncode == 0, result.stderr
    lines = result.stdout.splitlines()
    assert lines[0].startswith("16 golden pairs met")
    return [float(line.split()[1]) for line in lines[1:]]


@pytest.fixture(scope="module")
def untrained(tmp_path_factory):
    """An export of the preset as it is now, of networks that know nothing."""
    folder = tmp_path_factory.mktemp("untrained") / "run"
    cli.main(train_words(1, str(folder)))
    cli.main(["export", str(folder), "-o", str(folder / "robot.onnx")])
    return folder / "robot.onnx"


@pytest.mark.parametrize("file", ["exported", "untrained"])
def test_the_cpp_program_asks_for_the_same_joint_targets_as_the_controller(run_policy, file, request, tmp_path):
    exported = request.getfixturevalue(file)
    controller, rng = Controller.load(exported), np.random.default_rng(0)
    policy, joints = controller.policy, len(controller.policy.robot.joint_names)
    for _ in range(5):
        controller.reset()
        quat = np.array([1.0, 0.0, 0.0, 0.0]) + rng.normal(0.0, 0.2, 4)
        state = {
            "joint_pos": np.array(policy.robot.default_joint_pos_rad) + rng.normal(0.0, 0.3, joints),
            "joint_vel": rng.normal(0.0, 3.0, joints),
            "base_pos_w": np.array([5.0, -3.0, 0.5]) + rng.normal(0.0, 0.1, 3),
            "base_quat_w": quat / np.linalg.norm(quat),
            "base_lin_vel_b": rng.normal(0.0, 0.5, 3),
            "base_ang_vel_b": rng.normal(0.0, 0.5, 3),
        }
        heights, target = rng.normal(0.0, 0.1, len(policy.grid.points_m)), np.array([6.0, -1.0, 0.5])
        command = controller.step(Sensors(**state, time_s=0.0), Target(target, 3.0), GridHeights(heights, 0.0), 0.0)
        assert command.mode == "target"
        told = {"target_w": target, "time_left_s": 3.0, "action": np.zeros(joints), "heights_w": heights}
        content = {name: np.asarray(value).tolist() for name, value in (state | told).items()}
        (tmp_path / "state.json").write_text(json.dumps(content))
        found = targets_of(run_policy(exported, tmp_path / "state.json"))
        np.testing.assert_allclose(found, command.targets, atol=1e-5)


def test_the_cpp_program_says_what_is_wrong(run_policy, exported, tmp_path):
    assert len(targets_of(run_policy(exported))) == 12
    (tmp_path / "state.json").write_text('{"joint_pos": []}')
    for arguments in ((), (tmp_path / "none.onnx",), (exported, tmp_path / "state.json")):
        result = run_policy(*arguments)
        assert result.returncode == 1
        assert result.stderr.startswith("run_policy: ")


# ROS 2.


def stamped(now_s: float, frame: str = "odom") -> SimpleNamespace:
    nanoseconds = round(1e9 * now_s)
    stamp = SimpleNamespace(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return SimpleNamespace(stamp=stamp, frame_id=frame)


def xyz(values) -> SimpleNamespace:
    return SimpleNamespace(**dict(zip("xyz", map(float, values), strict=True)))


def joint_state(sensors: Sensors, names: list[str]) -> SimpleNamespace:
    """In another order than the policy's."""
    order = list(reversed(range(len(names))))
    return SimpleNamespace(
        header=stamped(sensors.time_s),
        name=[names[i] for i in order],
        position=[float(sensors.joint_pos[i]) for i in order],
        velocity=[float(sensors.joint_vel[i]) for i in order],
    )


def odometry(sensors: Sensors) -> SimpleNamespace:
    w, x, y, z = map(float, sensors.base_quat_w)
    pose = SimpleNamespace(position=xyz(sensors.base_pos_w), orientation=SimpleNamespace(x=x, y=y, z=z, w=w))
    twist = SimpleNamespace(linear=xyz(sensors.base_lin_vel_b), angular=xyz(sensors.base_ang_vel_b))
    return SimpleNamespace(
        header=stamped(sensors.time_s), pose=SimpleNamespace(pose=pose), twist=SimpleNamespace(twist=twist)
    )


def grid_map(terrain, now_s: float, start: tuple[int, int] = (0, 0)) -> SimpleNamespace:
    """A map as grid_map publishes it: rows fall in x, columns in y, column by column, begun anywhere."""
    rows, columns = terrain.heights_w.shape
    length = rows * terrain.resolution_m, columns * terrain.resolution_m
    centre = [terrain.origin_w[axis] + length[axis] / 2 for axis in (0, 1)]
    dims = [SimpleNamespace(label="column_index", size=columns), SimpleNamespace(label="row_index", size=rows)]
    stored = np.roll(terrain.heights_w[::-1, ::-1], start, axis=(0, 1)).flatten(order="F")
    pose = SimpleNamespace(position=xyz((*centre, 0.0)), orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0))
    return SimpleNamespace(
        header=stamped(now_s),
        info=SimpleNamespace(resolution=terrain.resolution_m, length_x=length[0], length_y=length[1], pose=pose),
        layers=["variance", "elevation"],
        data=[None, SimpleNamespace(layout=SimpleNamespace(dim=dims), data=stored)],
        outer_start_index=start[0],
        inner_start_index=start[1],
    )


class RosRobot:
    """The example's node on a simulated robot."""

    def __init__(self, monkeypatch, exported):
        ros2_stub.install(monkeypatch)
        monkeypatch.syspath_prepend(EXAMPLES / "ros2")
        for name in ("conversions", "arrive_node"):
            monkeypatch.delitem(sys.modules, name, raising=False)
        monkeypatch.setattr(ros2_stub.Node, "parameters", {"policy": str(exported)})
        self.node = load("examples/ros2/arrive_node.py").ArriveNode()
        policy = self.node.controller.policy
        config = saved_config(policy.meta["training"]["config"], policy.path)
        self.robot, self.names = SimulatedRobot(config, ground_of("flat").build()), policy.robot.joint_names
        self.commands, self.status = (self.node.publishers[name].sent for name in ("commands", "status"))
        (self.period_s, self.timer), *_ = self.node.timers

    def publish(self, topic: str, message) -> None:
        self.node.receivers[topic](message)

    def step(self) -> str:
        """All topics, one tick, and the robot does what it is told; gives the status."""
        now_s = self.node.now_s = self.node.now_s + self.period_s
        sensors = self.robot.sensors(now_s)
        self.publish("joint_states", joint_state(sensors, self.names))
        self.publish("odom", odometry(sensors))
        self.publish("elevation_map", grid_map(self.robot.height_map(now_s), now_s, start=(7, 30)))
        self.timer()
        self.robot.step(np.array(self.commands[-1].data))
        return self.status[-1].data


@pytest.fixture
def ros(monkeypatch, exported):
    return RosRobot(monkeypatch, exported)


def test_the_ros_node_brings_a_robot_to_a_goal_and_lets_a_stick_overrule_it(ros):
    # A tick before anything has arrived: a reason, and no command to the drives.
    ros.timer()
    assert ros.status[0].data.startswith("safe")
    assert not ros.commands
    while not ros.commands:
        ros.node.now_s += ros.period_s
        sensors = ros.robot.sensors(ros.node.now_s)
        ros.publish("joint_states", joint_state(sensors, ros.names))
        ros.publish("odom", odometry(sensors))
        ros.publish("elevation_map", grid_map(ros.robot.height_map(ros.node.now_s), ros.node.now_s))
        ros.timer()
    assert ros.status[-1].data == "stop"
    pose = SimpleNamespace(position=xyz((3.0, 0.5, 0.0)))
    ros.publish("goal", SimpleNamespace(header=stamped(ros.node.now_s), pose=pose))
    modes = [ros.step() for _ in range(round(6.0 / ros.period_s))]
    assert modes[0] == "target"
    assert modes[-1].startswith("hold")
    assert np.linalg.norm(ros.robot.base_pos_w[:2] - (3.0, 0.5)) < 0.6
    # The stick drives while its button is held, and stops the robot afterwards.
    ros.publish("joy", SimpleNamespace(axes=[0.0, 1.0], buttons=[0, 0, 0, 0, 1]))
    assert ros.step() == "joystick"
    ros.publish("joy", SimpleNamespace(axes=[0.0, 1.0], buttons=[0, 0, 0, 0, 0]))
    assert ros.step() == "stop"
    ros.publish("joy", SimpleNamespace(axes=[0.0, 1.0], buttons=[0, 0, 0, 0, 1]))
    assert [ros.step() for _ in range(30)] == ["joystick"] * 25 + ["stop"] * 5
    assert not ros.robot.crashed


def test_the_ros_node_ignores_what_is_in_another_frame_or_cannot_be_read(ros):
    ros.publish("odom", odometry(ros.robot.sensors(0.0)))
    terrain = ros.robot.height_map(0.0)
    foreign = grid_map(terrain, 0.0)
    foreign.header.frame_id = "map"
    ros.publish("elevation_map", foreign)
    assert "frame 'map' is ignored, the odometry's is 'odom'" in ros.node.warnings[-1]
    turned = grid_map(terrain, 0.0)
    turned.info.pose.orientation.z = 0.7
    ros.publish("elevation_map", turned)
    assert "rotated" in ros.node.warnings[-1]
    poor = grid_map(terrain, 0.0)
    poor.layers = ["variance", "slope"]
    ros.publish("elevation_map", poor)
    assert "no layer 'elevation'" in ros.node.warnings[-1]
    ros.timer()
    assert ros.status[-1].data.startswith("safe")
    assert not ros.commands


def test_a_grid_map_keeps_every_cell_in_its_place(ros):
    from conversions import height_map_of

    terrain = ros.robot.height_map(0.0)
    rng = np.random.default_rng(0)
    terrain = type(terrain)(terrain.origin_w, terrain.resolution_m, rng.normal(size=(5, 8)), 0.0)
    for start in ((0, 0), (2, 3)):
        read = height_map_of(grid_map(terrain, 1.25, start), "elevation")
        np.testing.assert_allclose(read.heights_w, terrain.heights_w)
        np.testing.assert_allclose(read.origin_w, terrain.origin_w)
        assert (read.resolution_m, read.time_s) == (terrain.resolution_m, 1.25)


def test_a_point_cloud_is_read_by_its_fields_names(ros):
    from conversions import point_cloud_of

    points = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, np.nan], [7.0, 8.0, 9.0], [0.5, 0.25, -1.0]], np.float32)
    rows = np.zeros((2, 2, 5), np.float32)
    rows[..., [2, 0, 3]] = points.reshape(2, 2, 3)  # x at 8 bytes, y at 0, z at 12, something else between
    fields = [SimpleNamespace(name=n, offset=o, datatype=7) for n, o in (("y", 0), ("i", 4), ("x", 8), ("z", 12))]
    cloud = SimpleNamespace(
        header=stamped(3.5), fields=fields, is_bigendian=False, point_step=20, width=2, height=2, row_step=44,
        data=b"".join(row.tobytes() + b"pad." for row in rows),
    )  # fmt: skip
    read = point_cloud_of(cloud)
    np.testing.assert_array_equal(read.points_w, points)
    assert read.time_s == 3.5
    fields[2].datatype = 8
    with pytest.raises(ValueError, match="float32"):
        point_cloud_of(cloud)


def test_joints_that_a_message_lacks_are_nan(ros):
    from conversions import sensors_of

    sensors = ros.robot.sensors(2.0)
    message = joint_state(sensors, ros.names)
    read = sensors_of(message, odometry(sensors), ros.names)
    for name in ("joint_pos", "joint_vel", "base_pos_w", "base_quat_w", "base_lin_vel_b", "base_ang_vel_b"):
        np.testing.assert_array_equal(getattr(read, name), getattr(sensors, name))
    message.name[0] = "spine"
    assert np.isnan(sensors_of(message, odometry(sensors), ros.names).joint_pos).tolist() == [False] * 11 + [True]
    message.velocity = []
    assert np.isnan(sensors_of(message, odometry(sensors), ros.names).joint_vel).all()
