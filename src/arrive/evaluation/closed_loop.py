"""The exported controller in the loop, over the very episodes in which `arrive eval` measures the network."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from arrive.build import OnProgress
from arrive.deployment import Controller, GridHeights, Sensors, Target
from arrive.deployment.policy_file import PolicyFile
from arrive.env import ArriveEnv
from arrive.errors import ArriveError
from arrive.evaluation.arrival import Cell, CellResult, evaluate
from arrive.learning.policy import Policy
from arrive.task.heights import HeightGrid
from arrive.task.observations import relative_heights
from arrive.task.rotation import rotate, rotate_inverse

COMPARED = ("final", "continuous")
"""Tasks whose commands the controller can be given as targets with deadlines."""


class ControlledRobots:
    """A controller for every robot of an environment, instead of the network.

    A controller receives what the network would, noise included, but as measurements: from each slice of the noisy
    observation follows a sensor reading. Noise of the direction of gravity tilts the measured orientation; the target
    is turned along, so that its direction from the base is as free of noise as in training. The ground at all points of
    a cell has the cell's noise; a network that observes the ground around its feet has separate noise there. What else
    differs is the controller's own: it tells half a second when less is left, leads robots to far targets in parts, and
    limits joint targets.
    """

    def __init__(self, env: ArriveEnv, file: PolicyFile):
        """Controllers as after switching on, all of the same file."""
        self._env = env
        self._controllers = [Controller(file) for _ in range(env.num_envs)]
        self._slices = {term.name: (slice(term.start, term.stop), term.scale) for term in file.terms}
        robot = file.robot
        self._default = torch.tensor(robot.default_joint_pos_rad, dtype=torch.double)
        self._action_scale, self._height_offset, self._clip = (
            robot.action_scale_rad,
            file.grid.offset_m,
            file.grid.clip_m,
        )
        self._grid = HeightGrid(env.config.observation.heights)

    def act(self, observation: Tensor) -> Tensor:
        """(num_envs, joints) float32 actions that stand for the controllers' joint targets.

        Args:
            observation: (num_envs, size) the environment's present observation, scaled and noisy.
        """
        now_s = (self._env.episode_length_buf * self._env.control_dt).tolist()
        readings, goals = self._measured(observation.double()), self._targets_w.numpy()
        left_s = self._env.task.command.time_left_s.tolist()
        joint_targets = self._default.repeat(self._env.num_envs, 1)
        for i in (~self._env.inactive).nonzero().squeeze(-1).tolist():
            sensors = Sensors(**{name: values[i] for name, values in readings.items()}, time_s=now_s[i])
            terrain = GridHeights(self._heights_w[i], now_s[i])
            goal = Target(goals[i], now_s[i] + left_s[i])
            joint_targets[i] = torch.from_numpy(self._controllers[i].step(sensors, goal, terrain, now_s[i]).targets)
        return ((joint_targets - self._default) / self._action_scale).float()

    def _measured(self, observation: Tensor) -> dict[str, np.ndarray]:
        """What all robots measure; also where their targets and the ground then are."""
        state = self._env.state
        pos, quat = state.base_pos_w.double(), state.base_quat_w.double()
        value = {name: observation[:, where] / scale for name, (where, scale) in self._slices.items()}
        tilted = with_measured_gravity(quat, state.gravity_b.double(), value["gravity"])
        way_b = rotate_inverse(quat, self._env.task.command.target_w.double() - pos)
        self._targets_w = pos + rotate(tilted, way_b)
        below = self._grid.spread(value["heights"])
        if "foot_heights" in value:  # needs what lies within a cell
            exact = relative_heights(state, state.heights_w, self._height_offset).clamp(*self._clip)
            below = exact + below - self._grid.spread(self._grid.pooled(exact))
        self._heights_w = (pos[:, 2:] - self._height_offset - below).numpy()
        return {
            "joint_pos": (value["joint_pos"] + self._default).numpy(),
            "joint_vel": value["joint_vel"].numpy(),
            "base_pos_w": pos.numpy(),
            "base_quat_w": tilted.numpy(),
            "base_lin_vel_b": value["base_lin_vel"].numpy(),
            "base_ang_vel_b": value["base_ang_vel"].numpy(),
        }


def with_measured_gravity(quat: Tensor, gravity_b: Tensor, measured_b: Tensor) -> Tensor:
    """(n, 4) the nearest orientations in which gravity has the measured direction.

    Args:
        quat: (n, 4) orientations (w, x, y, z).
        gravity_b: (n, 3) gravity's direction in them, unit vectors.
        measured_b: (n, 3) the measured direction, of about unit length.
    """
    measured_b = measured_b / measured_b.norm(dim=-1, keepdim=True)
    # The shortest rotation from the measured to the true direction, applied in the base frame.
    w = 1.0 + (measured_b * gravity_b).sum(-1, keepdim=True)
    xyz = torch.linalg.cross(measured_b, gravity_b)
    scalar = quat[:, :1] * w - (quat[:, 1:] * xyz).sum(-1, keepdim=True)
    vector = quat[:, :1] * xyz + w * quat[:, 1:] + torch.linalg.cross(quat[:, 1:], xyz)
    product = torch.cat([scalar, vector], dim=-1)
    return product / product.norm(dim=-1, keepdim=True)


@dataclass(frozen=True)
class Comparison:
    """One cell, measured twice over the same episodes."""

    network: CellResult
    controller: CellResult
    agreed: int
    """Episodes with the same outcome, success or not."""

    @property
    def difference(self) -> float:
        """Success of the controller less that of the network."""
        return self.controller.success - self.network.success


def compare(
    policy: Policy,
    file: PolicyFile,
    cells: Sequence[Cell],
    episodes: int,
    seed: int,
    threads: int = 0,
    progress: OnProgress = lambda done, total: None,
) -> list[Comparison]:
    """Measure a policy and its export over the same starts, targets and worlds.

    Noise and pushes come from one generator, and are the same too until an episode first ends at another time.

    Raises:
        ArriveError: the export is not of this policy, or its task has no targets.
    """
    check_pair(policy, file)
    network = evaluate(policy, cells, episodes, seed, threads, lambda i, n: progress(i, 2 * n))
    controlled = evaluate(
        policy,
        cells,
        episodes,
        seed,
        threads,
        lambda i, n: progress(n + i, 2 * n),
        pilot=lambda env: ControlledRobots(env, file),
    )
    first, second = (torch.cat([part.success for part in answer.played]) for answer in (network, controlled))
    agreed = [int((first == second)[network.cell_of_episode == i].sum()) for i in range(len(cells))]
    return [Comparison(*row) for row in zip(network.results, controlled.results, agreed, strict=True)]


def check_pair(policy: Policy, file: PolicyFile) -> None:
    """Make sure that a file is the export of a policy, by the actions both give.

    Raises:
        ArriveError: it is not, or its task has no targets.
    """
    if file.task.name not in COMPARED:
        raise ArriveError(f"the task {file.task.name!r} has no targets to give to the controller, {COMPARED} have")
    golden = torch.tensor(file.meta["golden"]["observations"])
    size = policy.schema[-1]["stop"]
    exported = torch.from_numpy(file.act(golden.numpy()))
    if golden.shape[1] != size or not torch.allclose(policy.act(golden), exported, atol=1e-4):
        raise ArriveError(f"{file.path} is not the export of {policy.path}: their actions differ")


def comparison_summary(comparison: Comparison) -> str:
    """One cell in a line."""
    network, controller = comparison.network, comparison.controller
    low, high = network.interval
    return (
        f"{network.cell.caption}: network {network.success:.1%} ({low:.1%} to {high:.1%}), controller "
        f"{controller.success:.1%}, difference {100.0 * comparison.difference:+.1f} points; "
        f"{comparison.agreed} of {network.episodes} episodes with the same outcome"
    )
