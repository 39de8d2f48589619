"""The kinematic chains of a robot's legs, read from its model."""

import mujoco
import numpy as np

from arrive.errors import ArriveError
from arrive.kinematics import FootChain, Link
from arrive.robots.robot import Robot

DIGITS = 9
"""Decimal places of all lengths and directions, so that they are the same on every machine."""


def foot_chains(robot: Robot) -> tuple[FootChain, ...]:
    """The chain of hinges from the base to each foot site, in the order of `robot.foot_sites`.

    Raises:
        ArriveError: no joint lies between the base and a foot, or it is not on the robot.
    """
    data = mujoco.MjData(robot.model)
    data.qpos[:] = 0.0
    data.qpos[3] = 1.0  # the base at the world's origin, not turned
    mujoco.mj_kinematics(robot.model, data)
    return tuple(_chain(robot, data, site) for site in robot.foot_sites)


def foot_partners(robot: Robot) -> tuple[int, ...]:
    """For each foot, the one that front-back reflection puts in its place: itself if the robot has no such symmetry.

    Raises:
        ArriveError: the reflection of the joints does not take whole legs to whole legs.
    """
    if robot.joint_reverse is None:
        return tuple(range(len(robot.foot_sites)))
    partner = dict(zip(robot.joint_names, (name for name, _ in robot.joint_reverse), strict=True))
    legs = [frozenset(link.joint for link in chain.links) for chain in foot_chains(robot)]
    reflected = [frozenset(partner[joint] for joint in leg) for leg in legs]
    if set(reflected) != set(legs):
        raise ArriveError(
            f"robot {robot.name!r}: joint_reverse must take all joints of a leg to those of one other leg"
        )
    return tuple(legs.index(leg) for leg in reflected)


def _chain(robot: Robot, data: mujoco.MjData, site: str) -> FootChain:
    model = robot.model
    body = int(model.site_bodyid[model.site(site).id])
    joints: list[int] = []
    while body and model.body(body).name != robot.base_body:
        first = model.body_jntadr[body]
        joints = [*range(first, first + model.body_jntnum[body]), *joints]
        body = int(model.body_parentid[body])
    if not body or not joints:
        raise ArriveError(f"robot {robot.name!r}: no joint moves the foot {site!r} relative to {robot.base_body!r}")
    links = [Link(model.joint(i).name, _rounded(data.xanchor[i]), _rounded(data.xaxis[i])) for i in joints]
    return FootChain(links, _rounded(data.site(site).xpos))


def _rounded(vector: np.ndarray) -> list[float]:
    return [round(float(value), DIGITS) for value in vector]
