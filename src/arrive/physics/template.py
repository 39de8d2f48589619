"""One model for all worlds: a template with their common layout, and a table of the fields in which they differ.

A GPU steps all robots with a single model whose fields may have one value per robot. Worlds differ in terrain geoms,
friction and payload. A height field gets its own geom, because the type of a geom cannot differ between robots.
"""

from collections.abc import Collection, Sequence

import mujoco
import numpy as np

from arrive.errors import ArriveError
from arrive.physics.options import PhysicsConfig, apply_options
from arrive.physics.scene import PARKED_Z
from arrive.physics.world import world_spec
from arrive.robots.robot import Robot
from arrive.terrain.rasterise import assemble

THIN_FIELD_BASE = 0.1
"""Thickness of height fields below their lowest point [m]. With 1 m, float32 collision fails more often."""
NOT_COMPARED = (
    "bvh_",  # MuJoCo's own search trees; the GPU engine has another broad phase
    "name",
    "hfield_",  # the template has the height fields of all worlds
    "sensor_",  # the template has sensors of its own
    "body_geom",  # addresses, which the added geom of the height fields shifts; the same for body_bvh
    "body_bvh",
    "geom_rgba",
    "geom_sameframe",  # a short-cut of MuJoCo's kinematics
    "dof_M0",  # read by MuJoCo's compiler alone
)
"""Prefixes of fields that do not affect the template's physics."""


def build_template(robot: Robot, worlds: Sequence[mujoco.MjModel], config: PhysicsConfig) -> mujoco.MjModel:
    """Compile the robot with unused boxes, all height fields of the worlds, and one geom that can be any of them.

    Only the foot velocity sensors are kept, because the engine counts contacts itself.
    """
    spec = world_spec(robot, assemble([]), config, places=terrain_geoms(worlds[0]))
    fields = [world for world in worlds if world.nhfield]
    for index, world in enumerate(fields):
        spec.add_hfield(
            name=f"field_{index}",
            size=(*world.hfield_size[0, :3], THIN_FIELD_BASE),
            nrow=int(world.hfield_nrow[0]),
            ncol=int(world.hfield_ncol[0]),
            userdata=world.hfield_data,
        )
    if fields:
        geom = spec.worldbody.add_geom(
            name="field", type=mujoco.mjtGeom.mjGEOM_HFIELD, contype=0, conaffinity=1, condim=3, group=0
        )
        geom.hfieldname, geom.pos = "field_0", (0.0, 0.0, PARKED_Z)
    apply_options(spec, config)  # of the added geom
    for sensor in spec.sensors:
        if sensor.type == mujoco.mjtSensor.mjSENS_CONTACT:
            spec.delete(sensor)
    return spec.compile()


def differing_fields(
    template: mujoco.MjModel, worlds: Sequence[mujoco.MjModel], batched: Collection[str]
) -> dict[str, np.ndarray]:
    """Every field in which a world differs from the template.

    Args:
        batched: names of the fields that may have one value per robot.

    Returns:
        (num_worlds, ...) values of each field in the template's layout.

    Raises:
        ArriveError: worlds differ in a field that must be the same for all robots.
    """
    for world in worlds:
        _check_options(template, world)
    tables: dict[str, np.ndarray] = {}
    for name in _field_names(template):
        expected = getattr(template, name)
        if not any(_differs(name, world, template) for world in worlds):
            continue
        if name not in batched:
            raise ArriveError(
                f"worlds differ in {name}, which MuJoCo Warp cannot vary between robots: train on the CPU "
                "(--device cpu), or make it the same in every world"
            )
        tables[name] = np.stack([_in_layout(name, world, template) for world in worlds]).astype(expected.dtype)
    if template.nhfield:
        tables["geom_dataid"] = _field_ids(template, worlds)
    return tables


def _field_names(model: mujoco.MjModel) -> list[str]:
    """The model's array fields that are compared."""
    names = (name for name in dir(model) if not name.startswith(("_", *NOT_COMPARED)) and name != "geom_dataid")
    return [name for name in names if isinstance(getattr(model, name), np.ndarray)]


def _differs(name: str, world: mujoco.MjModel, template: mujoco.MjModel) -> bool:
    return not np.array_equal(_in_layout(name, world, template), getattr(template, name))


def _in_layout(name: str, world: mujoco.MjModel, template: mujoco.MjModel) -> np.ndarray:
    """A world's field in the template's layout. Geoms that the world lacks are the template's own."""
    value = getattr(world, name)
    if not name.startswith("geom_"):
        return value
    placed = getattr(template, name).copy()
    placed[_geom_places(world, template)] = value
    return placed


def _geom_places(world: mujoco.MjModel, template: mujoco.MjModel) -> np.ndarray:
    """(world.ngeom,) index in the template of every geom of a world.

    Both begin with the terrain. If any world has a height field, the template has one more terrain geom for it, at the
    end. In a world, the height field is the last terrain geom.
    """
    places, terrain = np.arange(world.ngeom), terrain_geoms(world)
    places[terrain:] += template.ngeom - world.ngeom
    if world.nhfield:
        places[terrain - 1] = terrain
    return places


def _field_ids(template: mujoco.MjModel, worlds: Sequence[mujoco.MjModel]) -> np.ndarray:
    """(num_worlds, template.ngeom) data of each geom: the world's own height field, or else the unused first one."""
    ids = np.repeat(template.geom_dataid[None], len(worlds), axis=0)
    own = np.cumsum([world.nhfield for world in worlds]) - 1
    ids[:, terrain_geoms(worlds[0])] = [index if world.nhfield else 0 for index, world in zip(own, worlds, strict=True)]
    return ids


def _check_options(template: mujoco.MjModel, world: mujoco.MjModel) -> None:
    """Check that a world has the template's solver settings."""
    for name in dir(template.opt):
        value = getattr(template.opt, name)
        if name.startswith("_") or callable(value):
            continue
        if not np.array_equal(getattr(world.opt, name), value):
            raise ArriveError(f"a world was compiled with another value of option {name} than in the configuration")


def terrain_geoms(world: mujoco.MjModel) -> int:
    """Number of a world's terrain geoms; they come first."""
    return int(world.body_geomnum[0])


def static_geoms(template: mujoco.MjModel) -> slice:
    """The geoms that are fixed to the world; they come first."""
    return slice(0, int(np.count_nonzero(template.body_weldid[template.geom_bodyid] == 0)))
