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
    return tuple(_chain(robot, site) for site in robot.foot_sites)


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


def _chain(robot: Robot, site: str) -> FootChain:
    """Fixed bodies between two joints become a part of the second one's link."""
    model = robot.model
    body = int(model.site_bodyid[model.site(site).id])
    bodies = []
    while body and model.body(body).name != robot.base_body:
        bodies.append(body)
        body = int(model.body_parentid[body])
    if not body or not model.body_jntnum[bodies].sum():
        raise ArriveError(f"robot {robot.name!r}: no joint moves the foot {site!r} relative to {robot.base_body!r}")
    links, pos, turn = [], np.zeros(3), np.eye(3)
    for body in reversed(bodies):
        pos, turn = pos + turn @ model.body_pos[body], turn @ _matrix(model.body_quat[body])
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            anchor, axis = model.jnt_pos[joint], model.jnt_axis[joint]
            pos = pos + turn @ anchor
            turn = turn @ _about(axis, -model.qpos0[model.jnt_qposadr[joint]])
            links.append(Link(model.joint(joint).name, _rounded(pos), [_rounded(row) for row in turn], _rounded(axis)))
            pos, turn = -anchor, np.eye(3)
    return FootChain(links, _rounded(pos + turn @ model.site(site).pos))


def _matrix(quat: np.ndarray) -> np.ndarray:
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, quat)
    return flat.reshape(3, 3)


def _about(axis: np.ndarray, angle: float) -> np.ndarray:
    quat = np.empty(4)
    mujoco.mju_axisAngle2Quat(quat, axis, angle)
    return _matrix(quat)


def _rounded(vector: np.ndarray) -> list[float]:
    return [round(float(value), DIGITS) for value in vector]
