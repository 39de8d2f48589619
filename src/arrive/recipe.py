"""Makes a configuration from a preset, a task, terrains and changes by name."""

from collections.abc import Sequence
from dataclasses import replace

from arrive.config import Config, check_config, override
from arrive.errors import ArriveError
from arrive.learning.networks import choose_precision
from arrive.presets import get_preset
from arrive.robots import get_robot
from arrive.sizing import for_robot
from arrive.task.registry import get_task
from arrive.terrain import Family

DEFAULT_PRESET = "robust"
CHOSEN = {
    "preset": "--preset",
    "robot": "--robot, which fits lengths and masses to it",
    "task.name": "--task",
    "terrain.families": "the names of terrains",
}
"""Fields that determine other fields, and the option that sets them."""


def make_config(
    families: Sequence[Family],
    preset: str | None = None,
    task: str | None = None,
    num_envs: int | None = None,
    seed: int | None = None,
    overrides: tuple[str, ...] = (),
    robot: str | None = None,
    base: Config | None = None,
) -> Config:
    """Make a configuration. Arguments that are None keep the preset's value.

    Args:
        overrides: PATH=VALUE, applied last.
        robot: name of the robot. The preset's lengths, masses and weights are scaled to its size.
        base: configuration to change instead of a preset, such as another run's.

    Raises:
        ArriveError: an unknown name, or a value out of range.
    """
    for path, option in CHOSEN.items():
        if any(assignment.partition("=")[0].strip() == path for assignment in overrides):
            raise ArriveError(f"{path} cannot be set with --set: choose it with {option}")
    config = base or get_preset(preset or DEFAULT_PRESET)
    config = replace(
        config,
        terrain=replace(config.terrain, families=tuple(family.name for family in families)),
        task=config.task if base else get_task(task or config.task.name).from_preset(config.task),
        num_envs=config.num_envs if num_envs is None else num_envs,
        seed=config.seed if seed is None else seed,
    )
    if base is None:
        config = for_robot(config, get_robot(robot or config.robot))
    config = override(config, overrides)
    # Chosen once, so that a run resumed on another machine keeps it.
    config = replace(config, ppo=replace(config.ppo, precision=choose_precision(config.ppo.precision)))
    check_config(config)
    return config
