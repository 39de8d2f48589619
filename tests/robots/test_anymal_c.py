"""The compiled ANYmal C against its manufacturer's public description.

Expected masses, inertias and foot positions were computed from the URDF of `anymal_c_simple_description` (PyPI
example-robot-data 6.0.0) by a script that shares no code with the model: it walks the URDF's joints with their
rotated frames and sums the links that fixed joints join.
"""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from arrive.errors import ArriveError
from arrive.physics import PhysicsConfig
from arrive.physics.world import compile_world
from arrive.robots import ROBOTS, get_robot
from arrive.terrain import build_tile, get_family

ROBOT = get_robot("anymal_c")
SIDES = {"LF": (1, 1), "LH": (-1, 1), "RF": (1, -1), "RH": (-1, -1)}

# Mass [kg], centre of mass [m], inertia about it xx, yy, zz, xy, xz, yz [kg m^2]; hind legs as their diagonal partner
# turned by half a turn about z. The base's is with the products of the hatch's (invalid) inertia left out.
PUBLISHED = {
    "base": (
        26.37317,
        (-0.0177939, -0.0001782, 0.0085043),
        (0.2167117, 1.7851617, 1.8336994, 0.0082238, 0.0579332, -0.0011638),
    ),
    "LF_HIP": (
        2.781,
        (0.0566606, 0.0173939, -0.0004608),
        (0.0032955, 0.0049383, 0.0058330, -0.0000445, -0.0000979, 0.0001358),
    ),
    "LF_THIGH": (
        3.071,
        (-0.0000465, 0.0308147, -0.2456957),
        (0.0299040, 0.0295638, 0.0048611, -0.0000443, -0.0000945, 0.0041424),
    ),
    "LF_SHANK": (
        0.58842,
        (0.0612528, 0.0054620, -0.0806598),
        (0.0088104, 0.0101611, 0.0015498, 0.0000536, 0.0018194, -0.0000227),
    ),
    "RF_HIP": (
        2.781,
        (0.0567633, -0.0173939, -0.0004608),
        (0.0032955, 0.0049401, 0.0058348, -0.0000450, 0.0001000, -0.0001358),
    ),
    "RF_THIGH": (
        3.071,
        (0.0000465, -0.0308147, -0.2456957),
        (0.0299040, 0.0295638, 0.0048611, -0.0000444, 0.0001148, -0.0041424),
    ),
    "RF_SHANK": (
        0.58842,
        (0.0612528, -0.0054620, -0.0806598),
        (0.0088104, 0.0101611, 0.0015498, -0.0000536, 0.0018194, 0.0000227),
    ),
}
PUBLISHED_TOTAL_MASS = 52.13485

# Joint positions in the order of Robot.joint_names [rad] and the centres of the foot spheres LF, LH, RF, RH in the
# base frame [m].
FOOT_POSITIONS = [
    (
        [-0.62, -0.79, 1.51, -0.02, -1.22, -0.33, 0.09, -1.02, 1.17, -0.35, -0.33, 0.08],
        [
            (0.4203559, -0.0235903, -0.5180460),
            (0.2214162, 0.2972722, -0.1963346),
            (0.6424700, -0.2577389, -0.4900311),
            (-0.2746151, -0.4939318, -0.4932412),
        ],
    ),
    (
        [-0.2, 0.26, 1.19, 0.44, -0.65, 0.74, 0.35, -0.62, -2.49, 0.69, -0.6, -0.93],
        [
            (-0.0160409, 0.2176141, -0.4319267),
            (-0.3032699, 0.5094800, -0.3984103),
            (0.4474538, -0.3187423, 0.0133074),
            (0.1127436, -0.0422053, -0.3846105),
        ],
    ),
    (
        [0.36, 0.26, -0.14, 0.22, -1.41, 1.03, -0.04, -1.23, 0.8, 0.64, -0.88, 0.65],
        [
            (0.3360840, 0.4995869, -0.4912893),
            (-0.0431382, 0.3774187, -0.3192446),
            (0.8398631, -0.3148124, -0.3371849),
            (-0.1538533, 0.0417126, -0.5258504),
        ],
    ),
]


@pytest.fixture(scope="module")
def robot_model() -> mujoco.MjModel:
    return ROBOT.build_spec(False).compile()


@pytest.fixture(scope="module")
def flat_model() -> mujoco.MjModel:
    """The robot on the flat tile with the physics that training uses."""
    tile = build_tile(get_family("flat"), 0.0, np.random.default_rng(0), "training")
    return compile_world(ROBOT, tile, PhysicsConfig())


def standing(model: mujoco.MjModel, height: float = ROBOT.standing_height) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:7] = [0, 0, height, 1, 0, 0, 0]
    data.qpos[7:] = data.ctrl[:] = ROBOT.default_joint_pos
    return data


def published(body: str) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre of mass and 3x3 inertia of a body of any leg."""
    diagonal_partner = {"LH": "RF", "RH": "LF"}.get(body[:2], body[:2])
    turned = diagonal_partner != body[:2]
    mass, com, (xx, yy, zz, xy, xz, yz) = PUBLISHED[diagonal_partner + body[2:]]
    turn = np.diag([-1.0, -1.0, 1.0]) if turned else np.eye(3)
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return mass, turn @ com, turn @ inertia @ turn


def lumped(model: mujoco.MjModel, body: str) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre of mass and inertia about it of a body with the jointless bodies fixed to it, in its frame."""
    root = model.body(body).id
    fixed = [i for i in range(model.nbody) if model.body_parentid[i] == root and model.body_jntnum[i] == 0]
    parts = [(root, np.zeros(3))] + [(i, model.body_pos[i]) for i in fixed]
    masses = np.array([model.body_mass[i] for i, _ in parts])
    coms = np.array([offset + model.body_ipos[i] for i, offset in parts])
    com = masses @ coms / masses.sum()
    inertia = np.zeros((3, 3))
    for (i, _), mass, arm in zip(parts, masses, coms - com, strict=True):
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[i])
        rotation = rotation.reshape(3, 3)
        inertia += rotation @ np.diag(model.body_inertia[i]) @ rotation.T
        inertia += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return masses.sum(), com, inertia


def test_total_mass(robot_model):
    assert robot_model.body_mass.sum() == pytest.approx(PUBLISHED_TOTAL_MASS, abs=1e-9)


@pytest.mark.parametrize("part", ["HIP", "THIGH", "SHANK"])
@pytest.mark.parametrize("leg", SIDES)
def test_leg_inertials_are_the_published_ones_up_to_symmetry(robot_model, leg, part):
    body = f"{leg}_{part}"
    for actual, expected, tolerance in zip(
        lumped(robot_model, body), published(body), (1e-9, 5.3e-5, 1.1e-4), strict=True
    ):
        np.testing.assert_allclose(actual, expected, atol=tolerance, rtol=0)


def test_base_inertial_is_the_published_one_made_symmetric(robot_model):
    mass, com, inertia = published("base")
    symmetric = np.array([[1, 0, 1], [0, 1, 0], [1, 0, 1]])
    actual_mass, actual_com, actual_inertia = lumped(robot_model, "base")
    assert actual_mass == pytest.approx(mass)
    np.testing.assert_allclose(actual_com, com * [1, 0, 1], atol=1e-7)
    np.testing.assert_allclose(actual_inertia, inertia * symmetric, atol=1e-7)


def test_joint_order_and_ranges(robot_model):
    hinges = [robot_model.joint(i) for i in range(robot_model.njnt) if robot_model.jnt_type[i] != 0]
    assert tuple(hinge.name for hinge in hinges) == ROBOT.joint_names
    for hinge in hinges:
        lateral = (-0.72, 0.49) if hinge.name[0] == "L" else (-0.49, 0.72)
        expected = lateral if hinge.name.endswith("HAA") else (-9.42477796077, 9.42477796077)
        np.testing.assert_allclose(hinge.range, expected)
        assert robot_model.jnt_limited[hinge.id]


@pytest.mark.parametrize(("joint_pos", "feet"), FOOT_POSITIONS)
def test_foot_positions_are_those_of_the_description(robot_model, joint_pos, feet):
    data = mujoco.MjData(robot_model)
    data.qpos[7:] = joint_pos
    mujoco.mj_kinematics(robot_model, data)
    for site, expected in zip(ROBOT.foot_sites, feet, strict=True):
        np.testing.assert_allclose(data.site(site).xpos, expected, atol=1e-6)


def test_standing_height_puts_all_feet_on_the_ground(flat_model):
    data = standing(flat_model)
    mujoco.mj_forward(flat_model, data)
    bottoms = [data.site(site).xpos[2] - 0.03 for site in ROBOT.foot_sites]
    np.testing.assert_allclose(bottoms, 0.0, atol=1e-12)


def test_stands_still_at_the_default_pose(flat_model):
    """Under PD it sags a little in the first second and then stays where it is for five."""
    data = standing(flat_model)
    mujoco.mj_step(flat_model, data, 600)  # 3 s: PD damps drives with their rotors slowly
    start = data.qpos.copy()
    assert ROBOT.standing_height - start[2] < 0.05
    mujoco.mj_step(flat_model, data, 1000)
    assert np.linalg.norm(data.qpos[:3] - start[:3]) < 0.002
    assert np.abs(data.qvel).max() < 0.01
    assert data.qpos[3] > 0.999


def test_every_name_exists(robot_model):
    for body in (ROBOT.base_body, *ROBOT.foot_bodies, *ROBOT.collision_bodies, *ROBOT.crash_bodies):
        assert robot_model.body(body).id > 0
    for site in ROBOT.foot_sites:
        assert robot_model.site(site).id >= 0


def test_collision_shapes_meet_the_terrain_and_not_the_robot(robot_model):
    allowed = {mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX}
    assert set(robot_model.geom_type) <= {int(shape) for shape in allowed}
    assert (robot_model.geom_contype == 1).all()
    assert (robot_model.geom_conaffinity == 0).all()
    with_geoms = {robot_model.body(i).name for i in robot_model.geom_bodyid}
    assert with_geoms == {*ROBOT.crash_bodies, *ROBOT.collision_bodies, *ROBOT.foot_bodies}


def test_visuals_change_nothing_but_the_picture(robot_model):
    model = ROBOT.build_spec(True).compile()
    seen = model.geom_group == 2
    assert seen.sum() > 100
    assert (model.geom_contype[seen] == 0).all()
    assert (model.geom_conaffinity[seen] == 0).all()
    np.testing.assert_array_equal(model.body_mass, robot_model.body_mass)
    np.testing.assert_array_equal(model.body_inertia, robot_model.body_inertia)


def test_unknown_robot_is_an_error_that_lists_the_known_ones():
    with pytest.raises(ArriveError, match="anymal_c") as error:
        get_robot("anymal_d")
    assert all(name in str(error.value) for name in ROBOTS)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"collision_bodies": (*ROBOT.collision_bodies, "LF_FOOT")}, "'LF_FOOT' is in collision_bodies and in foot"),
        ({"crash_bodies": ("base", "LF_THIGH")}, "'LF_THIGH' is in crash_bodies and in collision_bodies"),
        ({"foot_bodies": ("LF_FOOT",) * 4}, "'LF_FOOT' is in foot_bodies and in foot_bodies"),
        ({"motors": ROBOT.motors[:3]}, "motors has 3 entries where 12 are needed"),
        ({"default_joint_pos": (0.0,)}, "default_joint_pos has 1 entries where 12 are needed"),
        ({"joint_reverse": ROBOT.joint_reverse[:-1]}, "joint_reverse does not name every joint once"),
        (
            {"joint_reverse": (*ROBOT.joint_reverse[:-1], (ROBOT.joint_reverse[-1][0], 1.0))},
            "joint_reverse does not undo itself",
        ),
    ],
)
def test_a_robot_with_inconsistent_fields_is_an_error_of_one_line(change, problem):
    with pytest.raises(ArriveError, match=problem) as error:
        replace(ROBOT, **change)
    assert "\n" not in str(error.value)
