"""Makes sure that a configuration can be run before anything is built from it."""

import math
from collections.abc import Iterator

from arrive.config import Config
from arrive.errors import ArriveError


def validate(config: Config) -> None:
    """Check the ranges of all fields whose bad values would fail late or silently.

    Raises:
        ArriveError: lists every field that is out of range, with its value and what it must be.
    """
    problems = [f"{path} must be {rule}, not {value!r}" for path, value, rule, fine in _rules(config) if not fine]
    if problems:
        raise ArriveError("; ".join(problems))


def _rules(config: Config) -> Iterator[tuple[str, object, str, bool]]:
    """(path, value, what it must be, whether it is)."""
    yield from _positive(config)
    ppo, task, terrain = config.ppo, config.task, config.terrain
    batch = config.num_envs * ppo.num_steps
    yield "ppo.mini_batches", ppo.mini_batches, f"at most the batch of {batch}", batch < 1 or ppo.mini_batches <= batch
    yield "ppo.hidden", ppo.hidden, "at least one positive size", bool(ppo.hidden) and min(ppo.hidden) > 0
    for name in ("gamma", "lam"):
        yield f"ppo.{name}", getattr(ppo, name), "between 0 and 1", 0.0 <= getattr(ppo, name) <= 1.0
    yield "terrain.families", terrain.families, "at least one family", bool(terrain.families)
    for name, share in terrain.shares.items():
        yield f"terrain.shares.{name}", share, "positive and finite", 0.0 < share < math.inf
    least = config.observation.noise_least
    yield "observation.noise_least", least, "between 0 and 1", 0.0 <= least <= 1.0
    yield "ppo.warm_std", ppo.warm_std, "0 or more and finite", 0.0 <= ppo.warm_std < math.inf
    start = terrain.start_level
    yield "terrain.start_level", start, f"between 0 and {terrain.levels - 1}", 0 <= start < max(terrain.levels, 1)
    yield "terrain.review", terrain.review, "at least 0 and less than 1", 0.0 <= terrain.review < 1.0
    yield "task.episode_min_s", task.episode_min_s, "at most task.episode_s", task.episode_min_s <= task.episode_s
    yield "task.retarget_s", task.retarget_s, "0 or more and finite", 0.0 <= task.retarget_s < math.inf
    for name in ("stop_share", "crossing_share", "demotion_share"):
        yield f"task.{name}", getattr(task, name), "between 0 and 1", 0.0 <= getattr(task, name) <= 1.0
    yield "seed", config.seed, "0 or more", config.seed >= 0
    low, high = config.observation.height_clip
    yield "observation.height_clip", (low, high), "a height above 0 and one below", low < 0.0 < high
    for name in ("friction", "payload_kg"):
        low, high = getattr(config.randomisation, name)
        yield f"randomisation.{name}", (low, high), "a range from low to high", low <= high


def _positive(config: Config) -> Iterator[tuple[str, object, str, bool]]:
    fields = {
        "": ("num_envs",),
        "physics": ("timestep_s", "decimation", "solver_iterations", "line_search_iterations", "impratio"),
        "terrain": ("levels", "variants"),
        "observation": ("height_scale", "grid_step", "grid_length", "grid_width"),
        "task": (
            "episode_s",
            "episode_min_s",
            "reward_window_s",
            "arrival_radius",
            "approach_speed",
            "approach_radius",
        ),
        "ppo": (
            "num_steps",
            "epochs",
            "mini_batches",
            "learning_rate",
            "init_std",
            "clip",
            "max_grad_norm",
        ),
    }
    for part, names in fields.items():
        section = getattr(config, part) if part else config
        for name in names:
            value = getattr(section, name)
            rule = "at least 1" if isinstance(value, int) else "positive and finite"
            yield f"{part}.{name}".lstrip("."), value, rule, 0 < value < math.inf
