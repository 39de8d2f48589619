"""A world: one robot on one tile, compiled with its own friction and payload."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from arrive.actuation import add_motors
from arrive.errors import ArriveError
from arrive.physics.options import PhysicsConfig, apply_options
from arrive.physics.scene import add_tile, pave
from arrive.robots.robot import Robot
from arrive.terrain.tile import Tile

FOOT_VELOCITY = "foot_velocity"
CONTACTS = "contacts"


@dataclass(frozen=True)
class SensorLayout:
    """Positions of the sensors' readings in `sensordata`, the same for every world of a robot."""

    foot_velocity: slice
    """World-frame velocity of each foot site, 3 per foot [m/s]."""
    crash_contacts: slice
    """Contacts of each crash body."""
    collision_contacts: slice
    """Contacts of each collision body."""
    foot_contacts: slice
    """Contacts of each foot body."""


def sensor_layout(robot: Robot) -> SensorLayout:
    """The layout that `add_sensors` produces."""
    vectors, crash, collision = 3 * len(robot.foot_sites), len(robot.crash_bodies), len(robot.collision_bodies)
    sizes = (vectors, crash, collision, len(robot.foot_bodies))
    starts = [sum(sizes[:i]) for i in range(len(sizes) + 1)]
    return SensorLayout(*(slice(a, b) for a, b in itertools.pairwise(starts)))


def add_sensors(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add only the sensors that the task uses, because each costs time at every physics step."""
    for site in robot.foot_sites:
        spec.add_sensor(
            name=f"{FOOT_VELOCITY}_{site}",
            type=mujoco.mjtSensor.mjSENS_FRAMELINVEL,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=site,
        )
    _add_contact_counts(spec, (*robot.crash_bodies, *robot.collision_bodies, *robot.foot_bodies))


def _add_contact_counts(spec: mujoco.MjSpec, bodies: Sequence[str]) -> None:
    """Add one sensor per body for its number of contacts."""
    found = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)
    for body in bodies:
        sensor = spec.add_sensor(
            name=f"{CONTACTS}_{body}",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            objname=body,
        )
        sensor.intprm[:3] = [found, 0, 1]


def let_legs_collide(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Let the collision geoms of different legs collide. Geoms of the same leg, and legs and base, do not collide.

    A leg is a child of the base with all its descendants. In MuJoCo two geoms collide if the `contype` of one and the
    `conaffinity` of the other share a bit. Bit 0 belongs to the terrain, and every leg gets its own bit.
    """
    legs = spec.body(robot.base_body).bodies
    bits = [2 << leg for leg in range(len(legs))]
    for own, leg in zip(bits, legs, strict=True):
        for geom in _collision_geoms(leg):
            geom.contype |= own
            geom.conaffinity |= sum(bits) - own


def _collision_geoms(body: mujoco.MjsBody) -> Iterator[mujoco.MjsGeom]:
    """The geoms of a body and its descendants that collide with the terrain."""
    yield from (geom for geom in body.geoms if geom.contype)
    for child in body.bodies:
        yield from _collision_geoms(child)


def world_spec(
    robot: Robot, tile: Tile, config: PhysicsConfig, visuals: bool = False, places: int | None = None
) -> mujoco.MjSpec:
    """The uncompiled robot on a tile. `visuals` adds the visual shapes; for `places` see `add_tile`."""
    spec = robot.build_spec(visuals)
    if config.leg_contacts:
        let_legs_collide(spec, robot)
    add_tile(spec, tile, places)
    if visuals:
        pave(spec)
    apply_options(spec, config)
    add_motors(spec, robot.joint_names, robot.motors, config.motor)
    add_sensors(spec, robot)
    return spec


def compile_world(
    robot: Robot,
    tile: Tile,
    config: PhysicsConfig,
    friction: float = 1.0,
    payload_kg: float = 0.0,
    visuals: bool = False,
    places: int | None = None,
) -> mujoco.MjModel:
    """Compile the robot on a tile.

    Args:
        friction: sliding friction coefficient of every contact (see `PhysicsConfig.cone`).
        payload_kg: mass added to the base at its centre of mass, may be negative [kg].
        places: number of terrain geoms, see `add_tile`.

    Raises:
        ArriveError: the payload removes more mass than the base has.
    """
    spec = world_spec(robot, tile, config, visuals, places)
    for geom in spec.geoms:
        geom.friction[0] = friction
    _add_payload(spec, robot, payload_kg)
    return spec.compile()


def _add_payload(spec: mujoco.MjSpec, robot: Robot, payload_kg: float) -> None:
    """Scale the base's mass and inertia, whether the robot gives them as a matrix, by principal axes, or by geoms.

    Raises:
        ArriveError: the base would have no mass left.
    """
    base = spec.body(robot.base_body)
    if np.isnan(base.ipos[0]):  # MuJoCo then sums up the geoms
        alone = robot.model.body(robot.base_body)
        base.mass, base.ipos, base.iquat, base.inertia = alone.mass[0], alone.ipos, alone.iquat, alone.inertia
        base.explicitinertial = True
    scale = (base.mass + payload_kg) / base.mass
    if not scale > 0.0:
        raise ArriveError(
            f"a payload of {payload_kg:.3g} kg leaves nothing of the {base.mass:.3g} kg of {robot.name}'s base: "
            "raise the lower end of randomisation.payload_kg"
        )
    base.mass *= scale
    base.fullinertia = [component * scale for component in base.fullinertia]
    base.inertia = [component * scale for component in base.inertia]
