"""Checks that a robot's model meets the assumptions of the rest of the software."""

import mujoco

from arrive.errors import ArriveError, unknown_name
from arrive.robots.legs import foot_chains, foot_partners
from arrive.robots.robot import Robot


def check_model(robot: Robot) -> None:
    """Compile a robot alone and compare it with what `Robot` says of it.

    Raises:
        ArriveError: it does not compile, or a name, the order of joints, a mass, a range, a geom or a leg is not as it
            must be; the message names the first.
    """
    _compiled(robot, True)  # what only pictures need fails now too, and not after a training
    model = _compiled(robot, False)
    _check_names(robot, model)
    problem = _problem(robot, model)
    if problem:
        raise ArriveError(f"robot {robot.name!r}: {problem}")
    foot_chains(robot)
    foot_partners(robot)


def _compiled(robot: Robot, visuals: bool) -> mujoco.MjModel:
    spec = robot.build_spec(visuals)
    if not isinstance(spec, mujoco.MjSpec):
        raise ArriveError(f"robot {robot.name!r}: build_spec must return an MjSpec, not {type(spec).__name__}")
    try:
        return spec.compile()
    except ValueError as error:
        raise ArriveError(f"robot {robot.name!r} does not compile: {' '.join(str(error).split())}") from error


def _check_names(robot: Robot, model: mujoco.MjModel) -> None:
    bodies = {model.body(i).name for i in range(1, model.nbody)}
    sites = {model.site(i).name for i in range(model.nsite)}
    roles = (*robot.foot_bodies, *robot.collision_bodies, *robot.crash_bodies)
    for kind, names, valid in (("body", (robot.base_body, *roles), bodies), ("site", robot.foot_sites, sites)):
        for name in names:
            if name not in valid:
                raise unknown_name(f"{kind} of robot {robot.name!r}", name, valid)


def _problem(robot: Robot, model: mujoco.MjModel) -> str:
    """Description of the fault, or an empty string."""
    kinds, joints = model.jnt_type, tuple(model.joint(i).name for i in range(1, model.njnt))
    if (
        not model.njnt
        or kinds[0] != mujoco.mjtJoint.mjJNT_FREE
        or model.jnt_bodyid[0] != model.body(robot.base_body).id
    ):
        return f"its first joint must be a free joint of {robot.base_body!r}"
    if joints != robot.joint_names:
        return f"joint_names must be those of the model in its order, {', '.join(joints)}"
    if (kinds[1:] != mujoco.mjtJoint.mjJNT_HINGE).any():
        return "every joint but the first must be a hinge"
    for name, position in zip(joints, robot.default_joint_pos, strict=True):
        low, high = model.joint(name).range
        if not low < high:
            return f"{name} has no range"
        if not low <= position <= high:
            return (
                f"the default position of {name}, {position:g} rad, is outside its range {low:g} to {high:g} rad; "
                "MjSpec takes degrees unless spec.compiler.degree is False"
            )
    if abs(model.body_mass.sum() - robot.mass) > 1e-3 * robot.mass:
        return f"its bodies weigh {model.body_mass.sum():g} kg, and mass is {robot.mass:g} kg"
    touching = model.geom_contype > 0
    if (model.geom_contype[touching] != 1).any() or (model.geom_conaffinity[touching] != 0).any():
        return "geoms that touch the terrain must have contype 1 and conaffinity 0"
    for name in robot.foot_bodies:
        if not touching[model.geom_bodyid == model.body(name).id].any():
            return f"the foot {name!r} has no geom that touches the terrain, with contype 1"
    if model.nu:
        return "its model must have no actuators; they are made from `motors`"
    return ""
