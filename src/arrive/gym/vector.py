"""`ArriveEnv` behind Gymnasium's interface of vector environments."""

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from arrive.build import Placement, build_env
from arrive.config import Config
from arrive.env import POLICY, Finished
from arrive.errors import ArriveError
from arrive.recipe import make_config
from arrive.task.curriculum import assign_families
from arrive.terrain import parse_families
from arrive.terrain.levels import level_values


class ArriveVectorEnv(VectorEnv):
    """Robots that must reach places by given times.

    Observations are (num_envs, size) float32, scaled and noisy as in training; actions are (num_envs, joints) joint
    targets relative to the default pose in units of the robot's action scale, without bounds: the motors limit them.

    A robot whose episode ends starts the next one in the same step (`AutoresetMode.SAME_STEP`). The observation is
    then the new episode's; `info["final_obs"]` has the last one of the old episode and `info["final_info"]` has
    `is_success`, `level`, `distance` (what was left of the way [m]) and `failure` (its cause, empty for a success).

    A crash or fall terminates an episode. So does the end of its time, because the remaining time is observed and the
    task is over (paper, section Method). Where time is not observed (the task `velocity`), the end of time
    truncates.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}  # noqa: RUF012 (Gymnasium's type)

    def __init__(
        self,
        num_envs: int = 1,
        terrain: str = "flat",
        preset: str | None = None,
        task: str | None = None,
        level: int | None = None,
        overrides: tuple[str, ...] = (),
        threads: int = 0,
        robot: str | None = None,
    ):
        """Build terrain and robots.

        Args:
            terrain: family, several joined by commas, or `all`.
            preset: named configuration; `robust` by default.
            task: named task; the preset's own by default.
            level: terrain level on which all robots stay. By default levels follow success as in training, whose
                first episodes are shortened to spread their ends.
            overrides: changes to the configuration as PATH=VALUE, like `task.rewards.stall_cost=-2`. `seed=2` changes
                the terrain; the seed of `reset` does not.
            threads: physics threads; 0 takes every CPU.
            robot: named robot; `anymal_c` by default.

        Raises:
            ArriveError: an unknown name or value out of range.
        """
        config = make_config(parse_families(terrain), preset, task, num_envs, None, tuple(overrides), robot)
        self.num_envs = config.num_envs
        self._env = build_env(config, _placement(config, level), threads)
        self._env.final_observations = True
        self.single_observation_space = _numbers(self._env.observer.size)
        self.single_action_space = _numbers(self._env.num_actions)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start every robot's episode; the same seed gives bit-identical episodes on the same terrain.

        Without a seed chance goes on from where it is, and levels stay.

        Raises:
            ArriveError: options were given, there are none.
        """
        if options:
            raise ArriveError(f"reset takes no options, not {', '.join(options)}; robots restart by themselves")
        super().reset(seed=seed)
        self._env.restart(None if seed is None else int(self.np_random.integers(2**63)))
        return self._env.get_observations()[POLICY].numpy(), {}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every robot by one policy step.

        Returns:
            observations, rewards (float32), terminations, truncations and infos, see the class.

        Raises:
            ArriveError: actions of another shape, or not finite.
        """
        actions = np.asarray(actions, dtype=np.float32)
        if actions.shape != self.action_space.shape or not np.isfinite(actions).all():
            raise ArriveError(f"actions must be {self.action_space.shape} finite numbers, not {actions.shape}")
        observations, rewards, dones, extras = self._env.step(torch.from_numpy(actions))
        ended = dones.bool()
        truncated = extras["time_outs"].bool() if "time_outs" in extras else torch.zeros_like(ended)
        finished = self._env.log.finished
        info = {} if finished is None else _final(finished, self.num_envs)
        return (
            observations[POLICY].numpy(),
            rewards.numpy(),
            (ended & ~truncated).numpy(),
            truncated.numpy(),
            info,
        )


def _numbers(size: int) -> gymnasium.spaces.Box:
    return gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)


def _placement(config: Config, level: int | None) -> Placement:
    """Robots spread over the families on a fixed level; None for the curriculum."""
    if level is None:
        return Placement()
    if not 0 <= level < config.terrain.levels:
        raise ArriveError(f"level {level} is out of range: levels are 0 to {config.terrain.levels - 1}")
    families = parse_families(",".join(config.terrain.families))
    # A family without a parameter has one level only.
    available = torch.tensor([min(level, len(level_values(f, config.terrain.levels)) - 1) for f in families])
    family = assign_families(config.num_envs, len(families))
    return Placement(assignment=(family, available[family]))


def _final(finished: Finished, num_envs: int) -> dict[str, Any]:
    """What ended, in the layout that Gymnasium asks of vector environments: an array and a mask per entry."""
    ids = finished.env_ids.numpy()
    mask = np.zeros(num_envs, dtype=bool)
    mask[ids] = True
    assert finished.observation is not None  # this environment asks for them
    observations = np.full(num_envs, None, dtype=object)
    for env_id, observation in zip(ids, finished.observation.numpy(), strict=True):
        observations[env_id] = observation
    values = {
        "is_success": _spread(finished.success, ids, num_envs),
        "level": _spread(finished.levels, ids, num_envs),
        "distance": _spread(finished.distance, ids, num_envs),
        "failure": _causes(finished, ids, num_envs),
    }
    final = {key: part for name, value in values.items() for key, part in ((name, value), (f"_{name}", mask.copy()))}
    return {"final_obs": observations, "_final_obs": mask, "final_info": final, "_final_info": mask.copy()}


def _spread(values: Tensor, ids: np.ndarray, num_envs: int) -> np.ndarray:
    """(num_envs,) the values at their environments, zero elsewhere."""
    array = np.zeros(num_envs, dtype=values.numpy().dtype)
    array[ids] = values.numpy()
    return array


def _causes(finished: Finished, ids: np.ndarray, num_envs: int) -> np.ndarray:
    """(num_envs,) cause of each failed episode, empty for a success, None where no episode ended."""
    causes = np.full(num_envs, None, dtype=object)
    causes[ids] = ""
    for cause, mask in finished.failures.items():
        causes[ids[mask.numpy()]] = cause
    return causes
