"""Chains from base to feet, and the feet's positions that follow from them, against MuJoCo's kinematics."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from arrive.errors import ArriveError
from arrive.kinematics import FootKinematics
from arrive.robots import ROBOTS
from arrive.robots.check import check_model
from arrive.robots.legs import foot_chains, foot_partners
from arrive.robots.robot import Robot
from hexapod import HEXAPOD


def crooked() -> Robot:
    """The hexapod with turned bodies, joints off their origins and with another zero, and feet on fixed bodies."""

    def build(visuals: bool) -> mujoco.MjSpec:
        spec, rng = HEXAPOD.build_spec(visuals), np.random.default_rng(0)
        for name in HEXAPOD.joint_names:
            joint = spec.joint(name)
            joint.pos, joint.ref, joint.axis = rng.normal(0.0, 0.1, 3), rng.normal(), rng.normal(size=3)
            joint.parent.quat = rng.normal(size=4)
        for name in HEXAPOD.foot_sites:
            site = spec.site(name)
            toe = site.parent.add_body(pos=rng.normal(0.0, 0.1, 3), quat=rng.normal(size=4))
            spec.delete(site)
            toe.add_site(name=name, pos=rng.normal(0.0, 0.1, 3))
        return spec

    return replace(HEXAPOD, name="crooked", build_spec=build)


def with_a_short_leg() -> Robot:
    """One foot at a knee, so that chains differ in length."""
    return replace(HEXAPOD, name="short", foot_sites=("KNEE", *HEXAPOD.foot_sites[1:]), build_spec=build_short)


def build_short(visuals: bool) -> mujoco.MjSpec:
    spec = HEXAPOD.build_spec(visuals)
    spec.joint("LF_KNEE").parent.add_site(name="KNEE", pos=(0.01, 0.02, 0.03))
    return spec


@pytest.mark.parametrize(
    "robot", [*ROBOTS.values(), HEXAPOD, crooked(), with_a_short_leg()], ids=lambda robot: robot.name
)
def test_feet_are_where_mujoco_has_them(robot):
    kinematics, rng = FootKinematics(foot_chains(robot), robot.joint_names), np.random.default_rng(1)
    positions = rng.uniform(-3.0, 3.0, (20, len(robot.joint_names)))
    found = kinematics.positions_b(np.sin(positions), np.cos(positions))
    data = mujoco.MjData(robot.model)
    for joint_pos, feet_b in zip(positions, found, strict=True):
        data.qpos[:7], data.qpos[7:] = rng.normal(size=7), joint_pos
        mujoco.mj_kinematics(robot.model, data)
        base = data.body(robot.base_body)
        feet_w = [data.site(site).xpos - base.xpos for site in robot.foot_sites]
        np.testing.assert_allclose(feet_b, feet_w @ base.xmat.reshape(3, 3), atol=1e-7)
    tables = FootKinematics(
        foot_chains(robot), robot.joint_names, lambda table: torch.tensor(table, dtype=torch.float32)
    )
    tensor = torch.tensor(positions, dtype=torch.float32)
    np.testing.assert_allclose(tables.positions_b(tensor.sin(), tensor.cos()), found, atol=1e-5)


def test_feet_and_their_front_back_images():
    for robot, expected in (
        (HEXAPOD, ["LH", "LM", "LF", "RH", "RM", "RF"]),
        (ROBOTS["anymal_c"], ["LH", "LF", "RH", "RF"]),
    ):
        assert [robot.foot_sites[i][:2] for i in foot_partners(robot)] == expected
    assert foot_partners(ROBOTS["go2"]) == (0, 1, 2, 3)


def torn() -> Robot:
    """Its reflection exchanges two knees alone."""
    knees = {"LF_KNEE": ("RH_KNEE", 1.0), "RH_KNEE": ("LF_KNEE", 1.0), "LH_KNEE": ("RF_KNEE", 1.0),
             "RF_KNEE": ("LH_KNEE", 1.0)}  # fmt: skip
    pairs = dict(zip(HEXAPOD.joint_names, HEXAPOD.joint_reverse, strict=True)) | knees
    return replace(HEXAPOD, joint_reverse=tuple(pairs[name] for name in HEXAPOD.joint_names))


def with_a_foot_on(body: str) -> Robot:
    """One foot where no joint moves it."""

    def build(visuals: bool) -> mujoco.MjSpec:
        spec = HEXAPOD.build_spec(visuals)
        parent = spec.worldbody.add_body(name="rock") if body == "rock" else spec.body(body)
        parent.add_site(name="STONE")
        return spec

    return replace(HEXAPOD, foot_sites=("STONE", *HEXAPOD.foot_sites[1:]), build_spec=build)


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        (torn(), "joint_reverse must take all joints of a leg to those of one other leg"),
        (with_a_foot_on(HEXAPOD.base_body), "no joint moves the foot 'STONE' relative to"),
        (with_a_foot_on("rock"), "no joint moves the foot 'STONE' relative to"),
    ],
    ids=["torn legs", "a foot on the base", "a foot on a rock"],
)
def test_robots_with_impossible_legs_are_refused(robot, message):
    with pytest.raises(ArriveError, match=message):
        check_model(robot)
