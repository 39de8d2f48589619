"""Plays one episode per robot and keeps what happened."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from arrive.build import OnProgress
from arrive.env import POLICY, ArriveEnv
from arrive.evaluation.episode import Episode
from arrive.evaluation.motion import MotionMeter
from arrive.physics.world import compile_world
from arrive.task.final import arrival_radius


def in_part(progress: OnProgress, index: int, parts: int) -> OnProgress:
    """The progress of one of several equal parts, told as that of the whole."""
    return lambda done, total: progress(index * total + done, parts * total)


class Pilot(Protocol):
    """What acts for the robots of an environment: a `Policy`, or something in its place."""

    def act(self, observation: Tensor) -> Tensor:
        """(num_envs, joints) actions for the present (num_envs, size) observations."""


@dataclass
class Played:
    """The first episode of every robot of an environment, in the CPU's memory."""

    success: Tensor
    """(n,) bool."""
    distance: Tensor
    """(n,) distance left at the end [m]."""
    steps: Tensor
    """(n,) policy steps it took."""
    reached: Tensor
    """(n,) policy steps until it first would have been a success, 0 where it never was."""
    cause: list[str]
    """(n,) why it failed, empty where it did not."""
    tile: Tensor
    """(n,) tile it was played on."""
    target_w: Tensor
    """(n, 3) [m]."""
    trace_w: Tensor
    """(longest episode + 1, n, 3) base positions; after the end of an episode the last one is repeated [m]."""
    qpos: np.ndarray
    """(longest episode + 1, watched robots, nq) poses in MuJoCo's order."""
    watched: Tensor
    """(watched robots,) which robots were recorded."""
    motion: dict[str, Tensor]
    """(n,) each, how the robots moved."""


def play(env: ArriveEnv, pilot: Pilot, watched: Tensor, progress: OnProgress = lambda done, total: None) -> Played:
    """Let the pilot act until every robot's first episode is over.

    Args:
        watched: robots whose poses are recorded.
        progress: called with the policy steps done so far and their total.
    """
    n = env.num_envs
    played = Played(
        success=torch.zeros(n, dtype=torch.bool),
        distance=torch.zeros(n),
        steps=torch.zeros(n, dtype=torch.long),
        reached=torch.zeros(n, dtype=torch.long),
        cause=[""] * n,
        tile=env.tile_of_env.to("cpu", copy=True),
        target_w=env.task.destination_w.to("cpu", copy=True),
        trace_w=env.state.base_pos_w.cpu().repeat(env.max_episode_length + 1, 1, 1),
        qpos=np.zeros(0),
        watched=watched,
        motion={},
    )
    meter = MotionMeter(env)
    waiting = torch.ones(n, dtype=torch.bool)
    observation, poses = env.get_observations()[POLICY], [poses_of(env, watched)]
    for step in range(env.max_episode_length):
        observation = env.step(pilot.act(observation))[0][POLICY]
        poses.append(poses_of(env, watched))
        assert env.log.success is not None  # after a step
        played.reached[waiting & env.log.success.cpu() & (played.reached == 0)] = step + 1
        _note_ended(env, played, waiting, step + 1)
        meter.take(env.state, waiting, step + 1)
        played.trace_w[step + 1] = torch.where(waiting[:, None], env.state.base_pos_w.cpu(), played.trace_w[step])
        progress(step + 1, env.max_episode_length)
        if not bool(waiting.any()):
            break
    played.qpos, played.motion = np.stack(poses), meter.means()
    return played


def _note_ended(env: ArriveEnv, played: Played, waiting: Tensor, step: int) -> None:
    ended = env.log.finished
    if ended is None:
        return
    ended_ids, success, distance = ended.env_ids.cpu(), ended.success.cpu(), ended.distance.cpu()
    new = waiting[ended_ids]
    ids = ended_ids[new]
    played.success[ids], played.distance[ids], played.steps[ids] = success[new], distance[new], step
    for cause, mask in ended.failures.items():
        for env_id in ended_ids[new & mask.cpu()].tolist():
            played.cause[env_id] = cause
    waiting[ids] = False
    env.deactivate(ids.to(env.device))


def poses_of(env: ArriveEnv, env_ids: Tensor) -> np.ndarray:
    """(n, nq) present poses of robots in MuJoCo's order [m, quaternion, rad]."""
    state = env.state
    parts = (state.base_pos_w, state.base_quat_w, state.joint_pos)
    return torch.cat([part[env_ids.to(part.device)] for part in parts], dim=-1).cpu().numpy()


def episode(env: ArriveEnv, played: Played, column: int, caption: str) -> Episode:
    """One recorded robot's episode, in a world with the shapes that are looked at.

    Args:
        column: which of the watched robots.
    """
    env_id = int(played.watched[column])
    tile = env.pool.tiles[int(played.tile[env_id])]
    return Episode(
        model=compile_world(env.robot, tile, env.config.physics, visuals=True),
        # The last pose is left out: the robot has been reset by then.
        qpos=played.qpos[: int(played.steps[env_id]), column],
        target_w=tuple(played.target_w[env_id].tolist()),
        target_radius=arrival_radius(env.config.task),
        control_dt=env.control_dt,
        outcome="arrived" if bool(played.success[env_id]) else played.cause[env_id],
        caption=caption,
    )
