"""The simulated motor gives the torque of the explicit formula."""

import mujoco
import numpy as np
import pytest

from arrive.actuation import Motor, add_motors, motor_torque

MOTOR = Motor(stiffness=80.0, damping=2.0, effort_limit=80.0, stall_torque=120.0, no_load_speed=7.5)


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
    add_motors(spec, ["hinge"], MOTOR, kind)
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
