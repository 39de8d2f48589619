"""One recorded episode, ready to be drawn."""

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np


@dataclass(frozen=True, eq=False)
class Episode:
    """One robot's episode, ready to be drawn; the model's first joint is the robot's free joint."""

    model: mujoco.MjModel
    qpos: np.ndarray
    """(steps, nq) positions after each policy step, the first at time 0 [m, rad, quaternions]."""
    target_w: tuple[float, float, float]
    """The place to reach [m]."""
    target_radius: float
    """A robot that is nearer to it has arrived [m]."""
    control_dt: float
    """Time between two rows of `qpos` [s]."""
    outcome: str
    """How the episode ended, such as "arrived"."""
    caption: str

    @cached_property
    def ground_path_w(self) -> np.ndarray:
        """(steps + 1, 3) the ground below the base at every step and, last, below the target [m]."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.qpos[0]
        data.qpos[2] += 1000.0  # the robot itself must not stop the rays
        mujoco.mj_kinematics(self.model, data)
        points = np.vstack([self.qpos[:, :3], self.target_w]).astype(float)
        heights = [_ground_height(self.model, data, point) for point in points]
        return np.column_stack([points[:, :2], heights])

    def index_at(self, time_s: float) -> int:
        """The row of `qpos` nearest to a time [s]."""
        return min(round(time_s / self.control_dt), len(self.qpos) - 1)


def _ground_height(model: mujoco.MjModel, data: mujoco.MjData, point: np.ndarray) -> float:
    """Height of the terrain (visible geoms of group 0) below a point, or the point's own where there is none [m]."""
    start = point + np.array([0.0, 0.0, 0.3])
    groups = np.array([1, 0, 0, 0, 0, 0], np.uint8)
    distance = mujoco.mj_ray(model, data, start, np.array([0.0, 0.0, -1.0]), groups, 1, -1, np.zeros(1, np.int32))
    return start[2] - distance if distance >= 0 else point[2]
