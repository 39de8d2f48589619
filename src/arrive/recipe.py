"""The configuration that a preset, a task, terrains and changes by name add up to."""

from collections.abc import Sequence
from dataclasses import replace

from arrive.config import Config, override
from arrive.errors import ArriveError
from arrive.learning.networks import choose_precision
from arrive.presets import get_preset
from arrive.robots import get_robot
from arrive.sizing import for_robot
from arrive.task.registry import get_task
from arrive.terrain import Family
from arrive.validate import validate

DEFAULT_PRESET = "robust"


def make_config(
    families: Sequence[Family],
    preset: str | None = None,
    task: str | None = None,
    num_envs: int | None = None,
    seed: int | None = None,
    overrides: tuple[str, ...] = (),
    robot: str | None = None,
) -> Config:
    """Put a configuration together; what is None stays as the preset has it.

    Args:
        overrides: PATH=VALUE, applied last.
        robot: by name; lengths, masses and weights of the preset are fitted to its size.

    Raises:
        ArriveError: an unknown name, or a value out of range.
    """
    config = get_preset(preset or DEFAULT_PRESET)
    name = task or config.task.name
    config = replace(
        config,
        terrain=replace(config.terrain, families=tuple(family.name for family in families)),
        task=replace(config.task, name=name),
        num_envs=config.num_envs if num_envs is None else num_envs,
        seed=config.seed if seed is None else seed,
    )
    config = for_robot(get_task(name).configure(config), get_robot(robot or config.robot))
    config, fitted = override(config, overrides), config
    if config.robot != fitted.robot:
        raise ArriveError(
            f"choose the robot by --robot {config.robot}, which fits lengths and masses to it, and not by --set"
        )
    # Chosen once, so that a run keeps it wherever it goes on.
    config = replace(config, ppo=replace(config.ppo, precision=choose_precision(config.ppo.precision)))
    validate(config)
    return config
