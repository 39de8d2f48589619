"""The robots as a vector environment of Stable-Baselines3.

    from stable_baselines3 import PPO
    from arrive.gym.sb3 import StableBaselinesEnv

    PPO("MlpPolicy", StableBaselinesEnv(64, terrain="gap")).learn(1_000_000)

Not imported by `arrive.gym`: it needs the extra `sb3`.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from arrive.errors import ArriveError
from arrive.gym.vector import ArriveVectorEnv, result_of


class StableBaselinesEnv(VecEnv):
    """`ArriveVectorEnv` with the interface of Stable-Baselines3.

    The `info` of a robot whose episode has ended has `terminal_observation`, `TimeLimit.truncated` and the result:
    `is_success`, which Stable-Baselines3 logs, `level`, `distance` and `failure`.
    """

    def __init__(self, num_envs: int = 1, **options: Any):
        """Build terrain and robots.

        Args:
            options: as of `ArriveVectorEnv`, without `autoreset_mode`.

        Raises:
            ArriveError: an unknown name or value out of range.
        """
        self.robots = ArriveVectorEnv(num_envs, **options)
        self._actions = np.zeros(0)
        super().__init__(num_envs, self.robots.single_observation_space, self.robots.single_action_space)

    def reset(self) -> np.ndarray:
        """Start every robot's episode, with the seed of `seed` if it was called since the last reset."""
        observations, _ = self.robots.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Advance every robot by one policy step."""
        observations, rewards, terminated, truncated, info = self.robots.step(self._actions)
        dones = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for env_id in np.flatnonzero(dones).tolist():
            infos[env_id] = result_of(info, env_id) | {
                "terminal_observation": info["final_obs"][env_id],
                "TimeLimit.truncated": bool(truncated[env_id]),
            }
        return observations, rewards, dones, infos

    def get_images(self) -> Sequence[np.ndarray | None]:
        """One (height, width, 3) picture per robot."""
        return self.robots.render() or [None] * self.num_envs

    def close(self) -> None:
        """Close the renderers."""
        self.robots.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute once per robot. All robots share it."""
        return [getattr(self.robots, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Not possible, because all robots share their attributes.

        Raises:
            ArriveError: always.
        """
        raise ArriveError(f"{attr_name} cannot be set; give options when the environment is made")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Not possible, because no robot has an environment of its own.

        Raises:
            ArriveError: always.
        """
        raise ArriveError(f"{method_name} cannot be called for single robots; call it on `robots`")

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None) -> list[bool]:
        """False for every robot, because none is wrapped by itself."""
        return [False] * len(list(self._get_indices(indices)))
