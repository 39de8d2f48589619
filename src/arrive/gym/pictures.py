"""Pictures of robots while they are stepped, for Gymnasium's `render`."""

import numpy as np
import torch

from arrive.env import ArriveEnv
from arrive.evaluation.episode import Episode
from arrive.evaluation.playing import poses_of
from arrive.physics.world import compile_world
from arrive.render.pictures import FILM_SIZE, LiveStage
from arrive.task.final import arrival_radius

MOST_STAGES = 8
"""Number of worlds that stay ready for drawing. Each takes memory for its shapes and shadows."""


class LivePictures:
    """Pictures of each robot in its present episode."""

    def __init__(self, env: ArriveEnv):
        """Worlds are compiled when they are first drawn."""
        self._env = env
        self._poses: list[list[np.ndarray]] = [[] for _ in range(env.num_envs)]
        self._stages: dict[int, LiveStage] = {}
        """By tile, in the order of last use."""

    def note(self) -> None:
        """Record the robots' poses. Call it after every reset and step."""
        poses = poses_of(self._env, torch.arange(self._env.num_envs))
        starts = (self._env.episode_length_buf == 0).tolist()
        for known, pose, start in zip(self._poses, poses, starts, strict=True):
            if start:
                known.clear()
            known.append(pose)

    def draw(self) -> tuple[np.ndarray, ...]:
        """One (height, width, 3) picture per robot, 8 bits per colour.

        Raises:
            GraphicsUnavailable: this machine cannot draw.
        """
        return tuple(self._draw(robot) for robot in range(self._env.num_envs))

    def close(self) -> None:
        """Close the renderers."""
        while self._stages:
            self._stages.popitem()[1].close()

    def _draw(self, robot: int) -> np.ndarray:
        env = self._env
        stage = self._stage(int(env.tile_of_env[robot]))
        episode = Episode(
            model=stage.model,
            qpos=np.array(self._poses[robot]),
            target_w=tuple(env.task.destination_w[robot].tolist()),
            target_radius=arrival_radius(env.config.task),
            control_dt=env.control_dt,
            outcome="",
            caption="",
        )
        return stage.draw(episode)

    def _stage(self, tile: int) -> LiveStage:
        stage = self._stages.pop(tile, None)
        if stage is None:
            while len(self._stages) >= MOST_STAGES:
                self._stages.pop(next(iter(self._stages))).close()
            env = self._env
            model = compile_world(env.robot, env.pool.tiles[tile], env.config.physics, visuals=True)
            stage = LiveStage(model, *FILM_SIZE)
        self._stages[tile] = stage
        return stage
