"""Tests of every robot: the built-in ones, and one with six legs of four joints."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from arrive.config import check_config
from arrive.errors import ArriveError
from arrive.physics import PhysicsConfig
from arrive.physics.world import compile_world, sensor_layout
from arrive.presets import robust
from arrive.recipe import make_config
from arrive.robots import ROBOTS
from arrive.robots.robot import Robot
from arrive.sizing import for_robot
from arrive.task.heights import FootGrid, HeightGrid
from arrive.task.randomisation import start_states
from arrive.terrain import build_tile, get_family, parse_families
from hexapod import HEXAPOD

EVERY = [*ROBOTS.values(), HEXAPOD]
WITH_REVERSE = [robot for robot in EVERY if robot.joint_reverse is not None and robot.name != "anymal_c"]
"""The base of ANYmal C is no front-back image of itself."""


def on_flat_ground(robot: Robot, payload_kg: float = 0.0) -> mujoco.MjModel:
    tile = build_tile(get_family("flat"), 0.0, np.random.default_rng(0), "training")
    return compile_world(robot, tile, PhysicsConfig(), payload_kg=payload_kg)


def standing(robot: Robot, model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:7] = [0, 0, robot.standing_height, 1, 0, 0, 0]
    data.qpos[7:] = data.ctrl[:] = robot.default_joint_pos
    return data


Pairs = tuple[tuple[str, float], ...]
"""For each joint, its partner under a reflection and the sign of the position there."""


def left_right(robot: Robot, model: mujoco.MjModel) -> Pairs:
    """The joint on the other side; a rotation about an axis in the plane of reflection, x or z, changes its sign."""
    data = standing(robot, model)
    mujoco.mj_kinematics(model, data)
    anchors = np.array([data.joint(name).xanchor for name in robot.joint_names])
    axes = [model.joint(name).axis for name in robot.joint_names]
    pairs = []
    for anchor, axis in zip(anchors, axes, strict=True):
        partner = int(np.linalg.norm(anchors - anchor * [1, -1, 1], axis=1).argmin())
        pairs.append((robot.joint_names[partner], 1.0 if axis[1] else -1.0))
    return tuple(pairs)


def reflect_joints(robot: Robot, pairs: Pairs, values: np.ndarray) -> np.ndarray:
    image = np.empty_like(values)
    for value, (partner, sign) in zip(values, pairs, strict=True):
        image[robot.joint_names.index(partner)] = sign * value
    return image


@pytest.mark.parametrize("robot", EVERY, ids=lambda robot: robot.name)
def test_names_masses_and_joints_are_those_of_the_model(robot):
    model = robot.build_spec(False).compile()
    hinges = [model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] != 0]
    assert tuple(hinges) == robot.joint_names
    for body in (robot.base_body, *robot.foot_bodies, *robot.collision_bodies, *robot.crash_bodies):
        assert model.body(body).id > 0
    assert model.body_mass.sum() == pytest.approx(robot.mass, abs=1e-9)
    touching = {model.body(i).name for i in model.geom_bodyid}
    assert touching == {*robot.crash_bodies, *robot.collision_bodies, *robot.foot_bodies}
    low, high = model.jnt_range[1:].T
    assert (low < robot.default_joint_pos).all()
    assert (robot.default_joint_pos < high).all()


@pytest.mark.parametrize("robot", EVERY, ids=lambda robot: robot.name)
def test_stands_on_all_feet_and_stays_there(robot):
    model = on_flat_ground(robot)
    data = standing(robot, model)
    mujoco.mj_forward(model, data)
    bottoms = [data.site(name).xpos[2] - model.site(name).size[0] for name in robot.foot_sites]
    np.testing.assert_allclose(bottoms, 0.0, atol=1e-12)
    mujoco.mj_step(model, data, 1600)
    start = data.qpos.copy()
    assert robot.standing_height - start[2] < 0.1 * robot.standing_height
    mujoco.mj_step(model, data, 400)
    assert np.linalg.norm(data.qpos[:3] - start[:3]) < 0.002
    assert data.qpos[3] > 0.999


@pytest.mark.parametrize("robot", EVERY, ids=lambda robot: robot.name)
def test_stands_over_its_feet_under_the_heaviest_payload(robot):
    """Legs that yield must not carry the weight off the feet: the hind legs then sink until they lie on the ground."""
    model = on_flat_ground(robot, for_robot(robust(), robot).randomisation.payload_kg[1])
    data = standing(robot, model)
    mujoco.mj_step(model, data, 400)
    feet = np.array([data.site(name).xpos[:2] for name in robot.foot_sites])
    away = data.body(robot.base_body).subtree_com[:2] - feet.mean(0)
    assert (np.abs(away) < 0.08 * np.ptp(feet, axis=0)).all()
    assert robot.standing_height - data.qpos[2] < 0.1 * robot.standing_height
    assert not others_in_contact(robot, data)


@pytest.mark.parametrize("robot", EVERY, ids=lambda robot: robot.name)
def test_stands_after_a_start_of_training(robot):
    """A zero action brings every random start onto the feet, and no joint starts beyond its range."""
    random = for_robot(robust(), robot).randomisation
    model, starts = on_flat_ground(robot), start_states(40, robot, random, torch.Generator().manual_seed(0))
    low, high = model.jnt_range[1:].T
    for qpos, qvel in zip(*starts, strict=True):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, robot.default_joint_pos
        assert ((low <= data.qpos[7:]) & (data.qpos[7:] <= high)).all()
        mujoco.mj_step(model, data, 400)
        assert not others_in_contact(robot, data)


def others_in_contact(robot: Robot, data: mujoco.MjData) -> set[str]:
    """Bodies other than feet that touch the ground."""
    layout = sensor_layout(robot)
    counts = np.concatenate([data.sensordata[layout.crash_contacts], data.sensordata[layout.collision_contacts]])
    names = (*robot.crash_bodies, *robot.collision_bodies)
    return {name for name, count in zip(names, counts, strict=True) if count}


@pytest.mark.parametrize(
    ("robot", "axis"),
    [(robot, 1) for robot in EVERY] + [(robot, 0) for robot in WITH_REVERSE],
    ids=lambda value: getattr(value, "name", str(value)),
)
def test_a_reflected_robot_behaves_like_the_reflection(robot, axis):
    """From a random fall with random joint targets, 0.3 s of physics commute with the reflection of one axis."""
    model, rng = on_flat_ground(robot), np.random.default_rng(0)
    pairs = left_right(robot, model) if axis else robot.joint_reverse
    polar = np.ones(3)
    polar[axis] = -1.0
    quat = np.concatenate([[1.0], -polar])

    def reflected(data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
        joints = reflect_joints(robot, pairs, data.qpos[7:])
        qpos = np.concatenate([data.qpos[:3] * polar, data.qpos[3:7] * quat, joints])
        spins = reflect_joints(robot, pairs, data.qvel[6:])
        return qpos, np.concatenate([data.qvel[:3] * polar, -data.qvel[3:6] * polar, spins])

    data, image = standing(robot, model), mujoco.MjData(model)
    data.qpos[3:7] += rng.normal(0, 0.05, 4)
    data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
    data.qpos[7:] += rng.normal(0, 0.1, model.nu)
    data.qvel[:] = rng.normal(0, 0.3, model.nv)
    image.qpos[:], image.qvel[:] = reflected(data)
    for _ in range(60):
        data.ctrl[:] = np.array(robot.default_joint_pos) + rng.normal(0, 0.1, model.nu)
        image.ctrl[:] = reflect_joints(robot, pairs, data.ctrl)
        mujoco.mj_step(model, data)
        mujoco.mj_step(model, image)
    assert data.ncon > 0
    qpos, qvel = reflected(data)
    np.testing.assert_allclose(image.qpos, qpos, atol=1e-7)
    np.testing.assert_allclose(image.qvel, qvel, atol=1e-5)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=lambda robot: robot.name)
def test_visual_geoms_have_no_contacts_and_no_mass(robot):
    plain, drawn = robot.build_spec(False).compile(), robot.build_spec(True).compile()
    seen = drawn.geom_group == 2
    assert seen.any()
    assert not drawn.geom_contype[seen].any()
    assert not drawn.geom_conaffinity[seen].any()
    assert (~seen).sum() == plain.ngeom
    np.testing.assert_array_equal(drawn.body_inertia, plain.body_inertia)


class TestGo2:
    """Against Menagerie's model, whose figures were read off the compiled model by a script that shares no code."""

    ROBOT = ROBOTS["go2"]
    FEET = (
        (
            [-0.87, -0.37, -1.21, 0.17, -1.09, -1.91, -0.04, 0.28, -1.34, -0.81, 1.46, -1.75],
            [
                (0.4834335, -0.0437341, -0.2010723),
                (0.4142901, -0.1595848, 0.0943043),
                (-0.0674298, 0.1295038, -0.3141498),
                (-0.3461026, -0.2776506, -0.0881943),
            ],
        ),
        (
            [-0.15, 1.4, -1.33, 0.96, -0.13, -1.5, 0.41, 0.96, -2.72, 0.99, 0.99, -2.13],
            [
                (-0.0333937, 0.1037861, -0.260022),
                (0.4337572, 0.0630555, -0.1932787),
                (-0.1583128, 0.1675936, -0.0390294),
                (-0.1787698, 0.0746891, -0.1937682),
            ],
        ),
    )
    # Mass, centre of mass, principal inertias.
    LINKS = {  # noqa: RUF012
        "base": (6.921, (0.021112, 0.0, -0.005366), (0.107027, 0.0980771, 0.0244531)),
        "FL_hip": (0.678, (-0.0054, 0.00194, -0.000105), (0.00088403, 0.000596003, 0.000479967)),
        "RR_hip": (0.678, (0.0054, -0.00194, -0.000105), (0.00088403, 0.000596003, 0.000479967)),
        "FL_thigh": (1.152, (-0.00374, -0.0223, -0.0327), (0.00594973, 0.00584149, 0.000878787)),
        "RR_thigh": (1.152, (-0.00374, 0.0223, -0.0327), (0.00594973, 0.00584149, 0.000878787)),
        "FL_calf": (0.241352, (0.00629595, -0.000622121, -0.141417), (0.0014901, 0.00146356, 5.31397e-05)),
        "RR_calf": (0.241352, (0.00629595, 0.000622121, -0.141417), (0.0014901, 0.00146356, 5.31397e-05)),
    }

    @pytest.mark.parametrize(("joint_pos", "feet"), FEET)
    def test_foot_positions(self, joint_pos, feet):
        model = self.ROBOT.build_spec(False).compile()
        data = mujoco.MjData(model)
        data.qpos[7:] = joint_pos
        mujoco.mj_kinematics(model, data)
        found = [data.site(site).xpos for site in self.ROBOT.foot_sites]
        np.testing.assert_allclose(found, feet, atol=1e-6)

    def test_inertials(self):
        model = self.ROBOT.build_spec(False).compile()
        for body, (mass, com, inertia) in self.LINKS.items():
            link = model.body(body)
            assert link.mass[0] == pytest.approx(mass)
            np.testing.assert_allclose(link.ipos, com, atol=1e-6, err_msg=body)
            np.testing.assert_allclose(sorted(link.inertia), sorted(inertia), atol=3e-6, err_msg=body)

    def test_the_knee_has_the_linkages_motor(self):
        """45.43 N m and 15.7 rad/s are the URDF's limits of the calf."""
        hip, knee = self.ROBOT.motor_of("FL_hip_joint"), self.ROBOT.motor_of("RR_calf_joint")
        assert (hip.effort_limit, hip.no_load_speed) == (23.7, 30.1)
        assert knee.effort_limit == pytest.approx(45.43)
        assert knee.no_load_speed == pytest.approx(15.7, abs=0.01)
        assert knee.rotor_inertia / hip.rotor_inertia == pytest.approx(1.917**2, rel=1e-3)
        model = on_flat_ground(self.ROBOT)
        assert model.joint("FR_calf_joint").armature[0] == pytest.approx(knee.rotor_inertia)
        assert model.joint("FR_thigh_joint").armature[0] == pytest.approx(hip.rotor_inertia)


def test_a_robot_is_not_chosen_past_its_sizes():
    with pytest.raises(ArriveError, match=r"robot cannot be set with --set: choose it with --robot"):
        make_config(parse_families("flat"), overrides=("robot=go2",))
    assert make_config(parse_families("flat"), robot="go2").robot == "go2"


def test_long_steps_suit_the_robots_joint_limits(monkeypatch):
    """MuJoCo would raise time constants below two physics steps silently."""
    robot = ROBOTS["anymal_c"]

    def hard(visuals: bool) -> mujoco.MjSpec:
        spec = robot.build_spec(visuals)
        for joint in spec.joints:
            joint.solref_limit[0] = 0.01
        return spec

    monkeypatch.setitem(ROBOTS, "hard", replace(robot, name="hard", build_spec=hard))
    assert robust().schedule.decimation == for_robot(robust(), robot).schedule.decimation == 3
    config = for_robot(robust(), ROBOTS["hard"])
    assert config.schedule.decimation == 4
    with pytest.raises(ArriveError, match=r"schedule.decimation must be 0, or at least 4: the limits .* not 3"):
        check_config(replace(config, schedule=replace(config.schedule, decimation=3)))


def test_a_preset_is_fitted_to_the_robots_size():
    """ANYmal C keeps every figure; Go2 gets lengths times 0.7, its share of the payload, and starts as far off."""
    plain, small = robust(), for_robot(robust(), ROBOTS["go2"])
    assert for_robot(plain, ROBOTS["anymal_c"]) == plain
    assert small.robot == "go2"
    assert small.task.target_height == pytest.approx(0.7 * plain.task.target_height)
    assert small.randomisation.payload_kg[1] == pytest.approx(5.0 * 15.2064 / 52.13485, rel=1e-3)
    assert small.randomisation.push_speed == pytest.approx(0.7**0.5, rel=1e-3)
    assert small.task.target_distance == plain.task.target_distance
    for config, robot in ((plain, ROBOTS["anymal_c"]), (small, ROBOTS["go2"])):
        widest = max(map(abs, robot.default_joint_pos))
        assert config.randomisation.start_joint_scale * widest == pytest.approx(0.4, rel=1e-3)
    before, after = HeightGrid(plain.observation.heights).points, HeightGrid(small.observation.heights).points
    np.testing.assert_allclose(after, 0.7 * before, atol=1e-6)
    around = FootGrid(plain.observation.foot_heights).offsets, FootGrid(small.observation.foot_heights).offsets
    np.testing.assert_allclose(around[1], 0.7 * around[0], atol=1e-6)
    # Torque over mass and length, and angular acceleration over gravity and length, cost the same.
    torque = 0.7 * 15.2064 / 52.13485
    ours, theirs = small.task.rewards, plain.task.rewards
    assert ours.torque_cost.weight * torque**2 == pytest.approx(theirs.torque_cost.weight, rel=1e-3)
    assert ours.joint_acc_cost.weight / 0.49 == pytest.approx(theirs.joint_acc_cost.weight, rel=1e-3)
    assert ours.action_rate_cost == theirs.action_rate_cost
