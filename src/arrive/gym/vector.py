"""`ArriveEnv` as a Gymnasium vector environment."""

import math
from dataclasses import dataclass
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from arrive.build import Placement, build_env
from arrive.commands.threads import check_threads
from arrive.config import Config
from arrive.env import POLICY, Finished
from arrive.errors import ArriveError
from arrive.gym.pictures import LivePictures
from arrive.recipe import make_config
from arrive.task.curriculum import assign_families
from arrive.terrain import parse_families
from arrive.terrain.levels import level_values

RenderMode = Literal["rgb_array"]
METADATA = {"render_modes": ["rgb_array"], "render_fps": 50}
"""Metadata of every environment. `render_fps` follows the configuration."""
FARTHEST_TARGET_RAD = math.pi
"""Bound of actions: a joint target this far from the default pose."""


class ArriveVectorEnv(VectorEnv):
    """Robots that must reach places by given times.

    Observations are (num_envs, size) float32, scaled and noisy as in training. Actions are (num_envs, joints) joint
    targets relative to the default pose, in units of the robot's action scale. Their bounds are half a turn from the
    default pose; actions beyond them are not clipped, because motors limit the torque.

    With `AutoresetMode.SAME_STEP` (default), a robot whose episode ends starts the next one in the same step. The
    observation is then the new episode's; `info["final_obs"]` has the last one of the old episode, and
    `info["final_info"]` its result: `is_success`, `level`, `distance` (to the target [m]) and `failure` (its cause,
    empty for a success). With `NEXT_STEP`, the observation is the old episode's, `info` itself has the result, and the
    robot's next step only starts the new episode: its action is ignored and its reward is 0.

    A crash or fall terminates an episode. So does the end of its time, because the remaining time is observed and the
    task is over (paper, section Method). Where time is not observed (the task `velocity`), the end of time
    truncates.
    """

    metadata = METADATA | {"autoreset_mode": AutoresetMode.SAME_STEP}

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
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        render_mode: RenderMode | None = None,
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
            autoreset_mode: `SAME_STEP` or `NEXT_STEP`, or the value of one.
            render_mode: `rgb_array` for `render`; None for no pictures.

        Raises:
            ArriveError: an unknown name or value out of range.
        """
        mode = _autoreset(autoreset_mode)
        self._next_step = mode is AutoresetMode.NEXT_STEP
        if render_mode not in (None, "rgb_array"):
            raise ArriveError(f"render_mode must be 'rgb_array' or None, not {render_mode!r}")
        check_threads(threads)
        config = make_config(parse_families(terrain), preset, task, num_envs, None, tuple(overrides), robot)
        self.num_envs = config.num_envs
        self._env = build_env(config, _placement(config, level), threads)
        self._env.final_observations = True
        self._waiting = np.zeros(self.num_envs, dtype=bool)
        """Robots whose next step starts an episode, with `NEXT_STEP`."""
        self.render_mode = render_mode
        self.metadata = METADATA | {"autoreset_mode": mode, "render_fps": round(1.0 / self._env.control_dt)}
        self._pictures = None if render_mode is None else LivePictures(self._env)
        bound = FARTHEST_TARGET_RAD / self._env.robot.action_scale
        self.single_observation_space = _box(np.inf, self._env.observer.size)
        self.single_action_space = _box(bound, self._env.num_actions)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start every robot's episode. The same seed gives bit-identical episodes on the same terrain.

        Without a seed, the random generator continues and levels stay.

        Raises:
            ArriveError: options were given, or the environment is closed.
        """
        self._check_open()
        if options:
            raise ArriveError(f"reset takes no options, not {options!r:.100}; robots restart by themselves")
        super().reset(seed=seed)
        self._env.restart(None if seed is None else int(self.np_random.integers(2**63)))
        self._waiting[:] = False
        self._look()
        return self._env.get_observations()[POLICY].numpy(), {}

    def next_episodes(self) -> np.ndarray:
        """End every robot's episode without a result, start the next one, and return its first observations."""
        self._env.begin_episodes(torch.arange(self.num_envs))
        self._waiting[:] = False
        self._look()
        return self._env.get_observations()[POLICY].numpy()

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every robot by one policy step.

        Returns:
            observations, rewards (float32), terminations, truncations and infos, see the class.

        Raises:
            ArriveError: actions of another shape, or not finite; or the environment is closed.
        """
        self._check_open()
        observations, rewards, dones, extras = self._env.step(as_actions(actions, self.action_space.shape))
        ended = dones.bool()
        truncated = extras["time_outs"].bool() if "time_outs" in extras else torch.zeros_like(ended)
        step = _Step(observations[POLICY].numpy(), rewards.numpy(), (ended & ~truncated).numpy(), truncated.numpy(), {})
        if self._next_step:
            self._start_late(step)
        elif self._env.log.finished is not None:
            step.info.update(_final(self._env.log.finished, self.num_envs))
        self._look()
        return step.observations, step.rewards, step.terminated, step.truncated, step.info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """One (height, width, 3) picture per robot, 8 bits per colour; None without a render mode.

        Raises:
            GraphicsUnavailable: this machine cannot draw.
        """
        return None if self._pictures is None else self._pictures.draw()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the renderers."""
        if self._pictures is not None:
            self._pictures.close()

    def _start_late(self, step: "_Step") -> None:
        """Turn a step into one of `NEXT_STEP`, which shows an episode's end now and the next start a step later."""
        waiting = self._waiting.copy()
        if waiting.any():
            self._env.begin_episodes(torch.from_numpy(waiting).nonzero().squeeze(-1))
            step.observations[waiting] = self._env.get_observations()[POLICY].numpy()[waiting]
            step.rewards[waiting], step.terminated[waiting], step.truncated[waiting] = 0.0, False, False
        self._waiting = step.terminated | step.truncated
        finished = self._env.log.finished
        if finished is None or not self._waiting.any():
            return
        final = _final(finished, self.num_envs)
        for env_id in np.flatnonzero(self._waiting):
            step.observations[env_id] = final["final_obs"][env_id]
        for name, value in final["final_info"].items():
            step.info[name] = value & self._waiting if name.startswith("_") else value

    def _look(self) -> None:
        if self._pictures is not None:
            self._pictures.note()

    def _check_open(self) -> None:
        if self.closed:
            raise ArriveError("the environment is closed: make a new one")


def as_actions(actions: Any, shape: tuple[int, ...] | None) -> Tensor:
    """A copy of actions as float32. Integers and bools are numbers; complex and masked ones are not.

    Raises:
        ArriveError: actions of another shape or kind, or not finite.
    """
    try:
        found = np.asarray(actions)
    except ValueError as error:
        raise ArriveError(f"actions must be {shape} finite numbers: {error}") from error
    if found.shape != shape or found.dtype.kind not in "fiub" or np.ma.is_masked(actions):
        masked = " with masked entries" if np.ma.is_masked(actions) else ""
        raise ArriveError(f"actions must be {shape} finite numbers, not {found.dtype} {found.shape}{masked}")
    with np.errstate(over="ignore"):
        found = found.astype(np.float32, order="C")
    wrong = np.count_nonzero(~np.isfinite(found))
    if wrong:
        raise ArriveError(f"actions must be {shape} finite numbers; {wrong} of {found.size} are not finite")
    return torch.from_numpy(found)


def result_of(info: dict[str, Any], env_id: int) -> dict[str, Any]:
    """The result of a robot whose episode has ended, from the `info` of a step with `SAME_STEP`."""
    return {name: value[env_id] for name, value in info["final_info"].items() if not name.startswith("_")}


@dataclass
class _Step:
    """Result of a step. Each array has one entry or row per robot."""

    observations: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    info: dict[str, Any]


def _autoreset(mode: AutoresetMode | str) -> AutoresetMode:
    """The mode, from the mode itself, its name or its value.

    Raises:
        ArriveError: it is neither `SAME_STEP` nor `NEXT_STEP`.
    """
    for valid in (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP):
        if mode in (valid, valid.name, valid.value):
            return valid
    raise ArriveError(f"autoreset_mode must be SAME_STEP or NEXT_STEP, not {mode}")


def _box(bound: float, size: int) -> gymnasium.spaces.Box:
    return gymnasium.spaces.Box(-bound, bound, (size,), np.float32)


def _placement(config: Config, level: int | None) -> Placement:
    """Robots spread over the families on a fixed level; None for the curriculum."""
    if level is None:
        return Placement()
    if type(level) is not int or not 0 <= level < config.terrain.levels:
        raise ArriveError(f"level {level!r} is out of range: levels are 0 to {config.terrain.levels - 1}")
    families = parse_families(",".join(config.terrain.families))
    # A family without a parameter has one level only.
    available = torch.tensor([min(level, len(level_values(f, config.terrain.levels)) - 1) for f in families])
    family = assign_families(config.num_envs, len(families))
    return Placement(assignment=(family, available[family]))


def _final(finished: Finished, num_envs: int) -> dict[str, Any]:
    """Results of ended episodes in Gymnasium's layout for vector environments: an array and a mask per entry."""
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
