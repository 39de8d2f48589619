"""One robot as a Gymnasium environment."""

from typing import Any

import gymnasium
import numpy as np

from arrive.errors import ArriveError
from arrive.gym.vector import METADATA, ArriveVectorEnv, as_actions, result_of


class ArriveSingleEnv(gymnasium.Env):
    """A robot that must reach places by given times: `ArriveVectorEnv` with one robot.

    The result of an episode is in the `info` of its last step: `is_success`, `level`, `distance` and `failure`. To
    train, use a vector environment, which makes many times as many samples per second.
    """

    metadata = METADATA

    def __init__(self, **options: Any):
        """Build terrain and robot.

        Args:
            options: as of `ArriveVectorEnv`, without `num_envs` and `autoreset_mode`.

        Raises:
            ArriveError: an unknown name or value out of range.
        """
        self._robots = ArriveVectorEnv(num_envs=1, **options)
        self.observation_space = self._robots.single_observation_space
        self.action_space = self._robots.single_action_space
        self.render_mode = self._robots.render_mode
        self.metadata = {name: self._robots.metadata[name] for name in METADATA}
        self._ended = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; see `ArriveVectorEnv.reset`."""
        super().reset(seed=seed)
        if seed is not None or options:
            self._robots.reset(seed=seed, options=options)
        self._ended = False
        # The first episode after a reset of the robots is shortened, so this starts the next one.
        return self._robots.next_episodes()[0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance the robot by one policy step.

        Raises:
            ArriveError: an action of another shape or not finite, or the episode has ended.
        """
        if self._ended:
            raise ArriveError("the episode has ended, or none has begun; call reset")
        actions = as_actions(action, self.action_space.shape).numpy()[None]
        observations, rewards, terminated, truncated, info = self._robots.step(actions)
        self._ended = bool(terminated[0] or truncated[0])
        if not self._ended:
            return observations[0], float(rewards[0]), False, False, {}
        return info["final_obs"][0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), result_of(info, 0)

    def render(self) -> np.ndarray | None:
        """A (height, width, 3) picture, 8 bits per colour; None without a render mode.

        Raises:
            GraphicsUnavailable: this machine cannot draw.
        """
        pictures = self._robots.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Close the renderers."""
        self._robots.close()
