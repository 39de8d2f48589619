"""The simulated motor gives the torque of the explicit formula."""

import mujoco
import numpy as np
import pytest

from arrive.actuation import add_motors, motor_torque
from arrive.physics.options import PhysicsConfig, apply_options
from arrive.robots import get_robot

MOTOR = get_robot("anymal_c").motors[0]


def simulated_torque(kind: str, error_rad: float, speed: float) -> float:
    """Torque on a lone hinge at position 0.3 rad whose target is `error_rad` further [N m]."""
    model, data = HINGES[kind]
    data.qpos[0], data.qvel[0], data.ctrl[0] = 0.3, speed, 0.3 + error_rad
    mujoco.mj_forward(model, data)
    return data.qfrc_actuator[0]


def hinge(kind: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="link")
    body.add_joint(name="hinge", type=mujoco.mjtJoint.mjJNT_HINGE)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0, 0])
    add_motors(spec, ["hinge"], [MOTOR], kind)
    model = spec.compile()
    return model, mujoco.MjData(model)


HINGES = {kind: hinge(kind) for kind in ("dc", "ideal")}


@pytest.mark.parametrize("kind", ["dc", "ideal"])
def test_simulated_motor_equals_the_formula(kind):
    for error in np.linspace(-4.0, 4.0, 41):
        for speed in np.linspace(-15.0, 15.0, 61):
            expected = motor_torque(MOTOR, np.array(error), np.array(speed), kind)
            assert simulated_torque(kind, error, speed) == pytest.approx(expected, abs=1e-9), (error, speed)


@pytest.mark.parametrize(
    ("kind", "error_rad", "speed", "torque"),
    [
        ("dc", 0.5, 0.0, 40.0),  # 80 * 0.5
        ("dc", 0.5, 3.0, 34.0),  # less 2 * 3
        ("dc", 1.5, 0.0, 80.0),  # 120 asked for, cut at the effort limit
        ("dc", 1.5, 5.0, 40.0),  # 110 asked for, 120 * (1 - 5 / 7.5) available
        ("dc", 1.5, -5.0, 80.0),  # braking is not limited by the line
        ("dc", 3.0, 9.0, -24.0),  # beyond the no-load speed the back-EMF brakes: 120 * (1 - 9 / 7.5)
        ("dc", -1.5, -5.0, -40.0),
        ("ideal", 1.5, 5.0, 80.0),
        ("ideal", 0.5, 3.0, 34.0),
    ],
)
def test_torques_computed_by_hand(kind, error_rad, speed, torque):
    assert motor_torque(MOTOR, np.array(error_rad), np.array(speed), kind) == pytest.approx(torque)
    assert simulated_torque(kind, error_rad, speed) == pytest.approx(torque)


def hanging_robot(timestep_s: float) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """ANYmal C without gravity, its base held, at its default pose."""
    robot = get_robot("anymal_c")
    spec = robot.build_spec(False)
    spec.delete(spec.joint("base"))
    apply_options(spec, PhysicsConfig(timestep_s=timestep_s))
    spec.option.gravity = [0, 0, 0]
    add_motors(spec, robot.joint_names, robot.motors)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = robot.default_joint_pos
    return model, data


@pytest.mark.parametrize("timestep_s", [0.001, 0.005])
def test_a_drive_in_the_air_keeps_its_own_speed_limit(timestep_s):
    """Without rotor inertia the knee reached 27 rad/s at 5 ms."""
    robot = get_robot("anymal_c")
    model, data = hanging_robot(timestep_s)
    fastest = np.zeros(model.nv)
    for joint in range(model.nv):
        mujoco.mj_resetData(model, data)
        data.qpos[:] = data.ctrl[:] = robot.default_joint_pos
        data.ctrl[joint] += 1.0
        for _ in range(round(0.5 / timestep_s)):
            mujoco.mj_step(model, data)
            fastest[joint] = max(fastest[joint], abs(data.qvel[joint]))
    assert fastest.max() < 1.1 * MOTOR.no_load_speed
    assert fastest.min() > 0.3 * MOTOR.no_load_speed  # they do move


def test_torque_at_5_ms_is_that_at_1_ms():
    """Over 20 ms from the same states and targets, on a robot that thrashes about: within 10 % RMS."""
    rng = np.random.default_rng(1)
    coarse, fine = hanging_robot(0.005), hanging_robot(0.001)
    squared_difference, squared = 0.0, 0.0
    for _ in range(200):
        targets = fine[1].qpos + rng.normal(0.0, 0.3, fine[0].nu)
        coarse[1].qpos[:], coarse[1].qvel[:] = fine[1].qpos, fine[1].qvel
        mean = {}
        for name, (model, data), steps in (("coarse", coarse, 4), ("fine", fine, 20)):
            data.ctrl[:] = targets
            torques = []
            for _ in range(steps):
                mujoco.mj_step(model, data)
                torques.append(data.actuator_force.copy())
            mean[name] = np.mean(torques, axis=0)
        squared_difference += np.square(mean["coarse"] - mean["fine"]).sum()
        squared += np.square(mean["fine"]).sum()
    assert np.sqrt(squared_difference / squared) < 0.1
