"""Robots with actuator networks: both engines, resets, checkpoints and checks of the configuration."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from actuator_networks import lstm, taps
from arrive.actuation import motor_torque
from arrive.actuation.clip import TorqueClip
from arrive.actuation.network_file import write_network
from arrive.actuation.runtime import make_runtime
from arrive.build import build_env
from arrive.config import Config, override
from arrive.errors import ArriveError
from arrive.evaluation.motors import meter
from arrive.physics import Physics, PhysicsConfig
from arrive.physics.device import make_physics
from arrive.physics.motors import motor_network
from arrive.physics.world import compile_world
from arrive.presets import robust
from arrive.simulation import SimulatedRobot
from arrive.terrain import FAMILIES, build_tile
from arrive.terrain.ground import ground_of
from engines import DEFAULT, ROBOT, standing

MOTOR = ROBOT.motors[0]
NETWORK = PhysicsConfig(motor="network", motor_file="drive.safetensors")
MAKERS = {"lstm": lstm, "taps": taps}


@cache
def world(config: PhysicsConfig) -> mujoco.MjModel:
    return compile_world(ROBOT, build_tile(FAMILIES["flat"], 0.0, np.random.default_rng(0), "training"), config)


def engine(
    kind: str = "lstm", num_envs: int = 3, clip: str = "affine", backend: str = "mujoco", decimation: int = 4
) -> Physics:
    """Robots in the air, with one network for all joints."""
    config = replace(NETWORK, motor_clip=clip, engine=backend, decimation=decimation)
    physics = make_physics(
        ROBOT, [world(replace(config, engine="auto"))], config, num_envs, 1, torch.device("cpu"), MAKERS[kind]()
    )
    physics.reset(torch.arange(num_envs), *standing(num_envs, 5.0))
    return physics


def targets(n: int, seed: int) -> Tensor:
    return DEFAULT + torch.from_numpy(np.random.default_rng(seed).normal(0, 0.3, (n, 12))).float()


@pytest.mark.parametrize("kind", MAKERS)
def test_each_physics_step_has_the_torque_of_the_network_for_that_state(kind):
    """Stepped one physics step at a time, so that positions and velocities of every call can be seen from outside."""
    physics, runtime = engine(kind, 2, decimation=1), make_runtime(MAKERS[kind](), 24)
    for step in range(12):
        before, wanted = physics.read(), targets(2, step // 4)
        physics.step(wanted)
        speed = before.joint_vel.numpy()
        expected = runtime.step((wanted - before.joint_pos).numpy().ravel(), speed.ravel()).reshape(2, 12).copy()
        TorqueClip([MOTOR], "affine").cut(expected, speed)
        np.testing.assert_allclose(physics.read().joint_torque, expected, atol=1e-4)
    assert np.abs(expected).max() > 5.0


@pytest.mark.parametrize("kind", MAKERS)
def test_a_policy_step_is_its_physics_steps(kind):
    whole, single = engine(kind), engine(kind, decimation=1)
    for step in range(3):
        whole.step(targets(3, step))
        for _ in range(4):
            single.step(targets(3, step))
    for name, value in whole.state_dict().items():
        assert torch.equal(value, single.state_dict()[name]), name


@pytest.mark.parametrize("ahead", [0.4, -0.4])
def test_the_torque_pushes_the_joint_towards_its_target(ahead):
    physics = engine()
    for _ in range(2):
        physics.step((DEFAULT + ahead).expand(3, 12))
    moved = (physics.read().joint_pos - DEFAULT) / ahead
    assert bool((moved > 0.01).all())


@pytest.mark.parametrize("kind", MAKERS)
def test_a_reset_robot_forgets_and_the_others_do_not(kind):
    """Robot 1 is put back to the start: from there it does what a fresh one does, and robots 0 and 2 go on."""
    physics, undisturbed, fresh = (engine(kind) for _ in range(3))
    for step in range(3):
        physics.step(targets(3, step))
        undisturbed.step(targets(3, step))
    physics.reset(torch.tensor([1]), *standing(1, 5.0))
    for step in range(3, 6):
        for each in (physics, undisturbed, fresh):
            each.step(targets(3, step))
    state = physics.state_dict()
    for name in ("qpos", "qvel", *(name for name in state if name.startswith("motor_"))):
        assert torch.equal(state[name][1], fresh.state_dict()[name][1]), name
        assert torch.equal(state[name][[0, 2]], undisturbed.state_dict()[name][[0, 2]]), name
        assert not torch.equal(state[name][1], undisturbed.state_dict()[name][1]), name


@pytest.mark.parametrize("kind", MAKERS)
def test_a_saved_simulation_goes_on_bit_for_bit(kind):
    physics, other = engine(kind), engine(kind)
    for step in range(3):
        physics.step(targets(3, step))
    other.load_state_dict(physics.state_dict())
    for step in range(3, 6):
        physics.step(targets(3, step))
        other.step(targets(3, step))
    for name, value in physics.state_dict().items():
        assert torch.equal(value, other.state_dict()[name]), name


def test_a_diverged_robot_leaves_the_others_alone():
    physics, healthy = engine(), engine()
    state = physics.state_dict()
    state["qvel"][1] = float("nan")
    physics.load_state_dict(state)
    for step in range(2):
        physics.step(targets(3, step))
        healthy.step(targets(3, step))
    assert physics.read().finite.tolist() == [True, False, True]
    assert torch.equal(physics.state_dict()["qpos"][[0, 2]], healthy.state_dict()["qpos"][[0, 2]])
    physics.reset(torch.tensor([1]), *standing(1, 5.0))
    physics.step(targets(3, 2))
    assert bool(physics.read().finite.all())


class TestClip:
    @pytest.mark.parametrize(("clip", "kind"), [("affine", "dc"), ("constant", "ideal")])
    def test_the_clip_limits_torque_like_the_motors_inside_mujoco(self, clip, kind):
        """A PD torque cut afterwards is the torque of the PD motor with that limit."""
        error, speed = np.meshgrid(np.linspace(-4, 4, 41), np.linspace(-15, 15, 61))
        torque = MOTOR.stiffness * error - MOTOR.damping * speed
        TorqueClip([MOTOR], clip).cut(torque, speed)
        np.testing.assert_allclose(torque, motor_torque(MOTOR, error, speed, kind), atol=1e-9)

    def test_no_clip_keeps_the_torque(self):
        torque = np.array([1e4, -1e4])
        TorqueClip([MOTOR], "none").cut(torque, np.array([20.0, -20.0]))
        assert torque.tolist() == [1e4, -1e4]

    def test_simulated_torques_keep_within_it(self):
        """Joints that run at 6 rad/s towards targets 6 rad ahead: 120 * (1 - 6 / 7.5) = 24 N m, 80, or more."""
        first, highest = {}, {}
        for clip in ("affine", "constant", "none"):
            physics = engine("taps", num_envs=1, clip=clip, decimation=1)
            qpos, qvel = standing(1, 5.0)
            qvel[:, 6:] = 6.0
            physics.reset(torch.arange(1), qpos, qvel)
            for _ in range(5):
                speed = physics.read().joint_vel.numpy()
                physics.step((qpos[:, 7:] + 6.0).float())
                torque = physics.read().joint_torque.numpy()
                assert (torque <= TorqueClip([MOTOR], clip).limits(speed)[1] + 1e-4).all()
                first.setdefault(clip, float(torque.max()))
                highest[clip] = max(highest.get(clip, 0.0), float(torque.max()))
        assert first["affine"] == pytest.approx(24.0, abs=1e-4)
        assert highest["constant"] == pytest.approx(80.0)
        assert highest["none"] > 100.0


class TestSimulatedRobot:
    def test_the_simulated_robot_moves_as_in_training(self, tmp_path):
        """The robot of `play` and `drive`, from the same state with the same targets."""
        path = tmp_path / "drive.safetensors"
        write_network(path, lstm())
        config = Config(physics=replace(NETWORK, motor_file=str(path)))
        robot, physics = SimulatedRobot(config, ground_of("flat").build()), engine(num_envs=1)
        for _ in range(2):
            robot.reset()
            physics.reset(torch.arange(1), torch.from_numpy(robot.data.qpos[None].copy()), torch.zeros(1, 18).double())
            for step in range(4):
                robot.step(targets(1, step)[0].numpy())
                physics.step(targets(1, step))
            np.testing.assert_allclose(robot.data.qpos, physics.state_dict()["qpos"][0], atol=1e-7)


def test_metered_robots_have_the_same_motors(tmp_path):
    """`arrive energy` steps the engine by itself; without the network targets would be taken for torques."""
    path = tmp_path / "drive.safetensors"
    write_network(path, lstm())
    config = replace(robust(), num_envs=2, physics=replace(NETWORK, motor_file=str(path)))
    config = replace(config, terrain=replace(config.terrain, levels=1, variants=1))
    plain, metered = build_env(config, threads=1), build_env(config, threads=1)
    motors = meter(metered, 1)
    for env in (plain, metered):
        env.restart(seed=3)
        env.step(torch.full((2, 12), 0.2))
    assert float(plain.state.joint_torque.abs().max()) > 1.0
    torch.testing.assert_close(metered.state.joint_torque, plain.state.joint_torque)
    assert float(motors.torque_sq.min()) > 0.0


class TestConfiguration:
    def test_file_and_motor_go_together(self):
        with pytest.raises(ArriveError, match=r"physics.motor=network and physics.motor_file=FILE go together"):
            override(Config(), ("physics.motor=network",))
        with pytest.raises(ArriveError, match="go together"):
            override(Config(), ("physics.motor_file=drive.safetensors",))
        with pytest.raises(ArriveError, match=r"motor_clip is for physics.motor=network"):
            override(Config(), ("physics.motor_clip=none",))

    def test_a_network_with_another_period_is_refused(self, tmp_path):
        path = tmp_path / "drive.safetensors"
        write_network(path, lstm())
        config = replace(NETWORK, motor_file=str(path))
        assert motor_network(config).period_s == 0.005
        with pytest.raises(ArriveError, match=r"every 0.005 s and the physics step is 0.0025 s.*timestep_s=0.005"):
            motor_network(replace(config, timestep_s=0.0025))
        assert motor_network(PhysicsConfig()) is None


@pytest.mark.warp
class TestWarp:
    @pytest.fixture(autouse=True)
    def installed(self):
        pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed")

    @pytest.mark.parametrize("clip", ["affine", "none"])
    @pytest.mark.parametrize("kind", MAKERS)
    def test_agrees_with_the_cpu_engine(self, kind, clip):
        """From the same states in the air, one physics step at a time: torques within 1e-3 N m."""
        cpu, warp = (engine(kind, clip=clip, backend=backend, decimation=1) for backend in ("mujoco", "warp"))
        for step in range(8):
            warp.load_state_dict(cpu.state_dict())
            for each in (cpu, warp):
                each.step(3.0 * targets(3, step // 4))
            np.testing.assert_allclose(warp.read().joint_torque, cpu.read().joint_torque, atol=1e-3)
            for name, value in cpu.state_dict().items():
                if name.startswith("motor_"):
                    torch.testing.assert_close(warp.state_dict()[name], value, atol=1e-4, rtol=1e-5)
        assert float(cpu.read().joint_torque.abs().max()) > 20.0

    def test_resets_and_saves_its_state(self):
        warp, other = engine(backend="warp"), engine(backend="warp")
        for step in range(2):
            warp.step(targets(3, step))
        other.load_state_dict(warp.state_dict())
        for each in (warp, other):
            each.step(targets(3, 2))
        for name, value in warp.state_dict().items():
            assert torch.equal(value, other.state_dict()[name]), name
        warp.reset(torch.tensor([1]), *standing(1, 5.0))
        state = warp.state_dict()
        assert not state["motor_hidden"][1].any()
        assert not state["motor_cell"][1].any()
        assert bool(state["motor_hidden"][[0, 2]].any())


def test_a_file_that_is_missing_is_named_before_terrain_is_built():
    with pytest.raises(ArriveError, match=r"nowhere.safetensors: no such file"):
        motor_network(replace(NETWORK, motor_file=str(Path("nowhere.safetensors"))))
