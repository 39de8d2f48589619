"""The grid of ground heights around the robot, sampled from a height map or a point cloud."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from arrive.deployment.specs import GridSpec

FILL_RADIUS = 0.3
"""An unseen grid point takes the height of the nearest seen grid point within this distance [m]."""


@dataclass(frozen=True, eq=False)
class GridHeights:
    """Heights that the caller has sampled at the grid's points."""

    heights_w: Any
    """(points,) ground height in the world frame, NaN where nothing was seen [m]."""
    time_s: float
    """Time of the last measurement of the ground [s]."""


@dataclass(frozen=True, eq=False)
class HeightMap:
    """A robot-centric or global elevation map."""

    origin_w: Any
    """(2,) world position of the outer corner of cell (0, 0) [m]."""
    resolution_m: float
    """Edge of a cell [m]."""
    heights_w: Any
    """(nx, ny) ground heights in the world frame, first index x, second y, NaN where nothing was seen [m]."""
    time_s: float
    """Time of the map's last update [s]."""


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points on the ground, without those on the robot itself."""

    points_w: Any
    """(n, 3) in the world frame [m]. Rows with NaN are ignored."""
    time_s: float
    """Time of the newest point [s]."""


class HeightSampler:
    """Samples ground heights at the network's grid points, and fills in unseen ones.

    An unseen point takes the height of the nearest seen grid point within `FILL_RADIUS`. If there is none, it takes the
    height of the ground under the robot, estimated as base height minus standing height.
    """

    def __init__(self, spec: GridSpec):
        """Prepare each point's neighbours, nearest first."""
        self.points = np.array(spec.points_m)
        """(points, 2) in the heading frame [m]."""
        self._step = spec.step_m
        self._low = self.points.min(axis=0)
        self._shape = spec.shape
        distance = np.linalg.norm(self.points[:, None] - self.points[None], axis=-1)
        near = distance <= FILL_RADIUS + 1e-6
        order = np.argsort(np.where(near, distance, np.inf), axis=1, kind="stable")[:, : near.sum(1).max()]
        # Rows of points with fewer neighbours are filled up with the point itself.
        own = np.arange(len(self.points))[:, None]
        self._neighbours = np.where(np.take_along_axis(near, order, axis=1), order, own)

    def from_map(
        self, origin: np.ndarray, resolution: float, heights: np.ndarray, pos: np.ndarray, yaw: float
    ) -> np.ndarray:
        """(points,) height of the map cell that contains each point, NaN outside the map and in its unseen cells.

        Args:
            pos: (3,) base position in the map's frame [m].
            yaw: heading [rad].
        """
        x, y = np.floor((self._in_world(pos, yaw) - origin) / resolution).T
        inside = (x >= 0) & (x < heights.shape[0]) & (y >= 0) & (y < heights.shape[1])
        x, y = (np.where(inside, cell, 0.0).astype(int) for cell in (x, y))
        return np.where(inside, heights[x, y], np.nan)

    def from_cloud(self, points: np.ndarray, pos: np.ndarray, yaw: float) -> np.ndarray:
        """(points,) median height of the cloud's points in the square around each grid point, NaN where it is empty.

        The median (for an even number of points, the lower of the middle two) ignores single stray returns.
        """
        points = points[~np.isnan(points).any(axis=1)]
        cos, sin = math.cos(yaw), math.sin(yaw)
        offset = points[:, :2] - pos[:2]
        local = offset @ np.array([[cos, -sin], [sin, cos]])
        cells = np.rint((local - self._low) / self._step)
        inside = ((cells >= 0) & (cells < self._shape)).all(axis=1)
        index = (cells[inside] @ (self._shape[1], 1)).astype(int)
        z = points[inside, 2]
        order = np.lexsort((z, index))
        seen, start, count = np.unique(index[order], return_index=True, return_counts=True)
        heights = np.full(len(self.points), np.nan)
        heights[seen] = z[order][start + (count - 1) // 2]
        return heights

    def fill(self, heights: np.ndarray, standing_on: float) -> tuple[np.ndarray, float]:
        """Apply the rule for unseen points.

        Args:
            heights: (points,) [m], NaN where nothing was seen.
            standing_on: height of the ground under the robot [m].

        Returns:
            (points,) heights without NaN, and the share of points that were seen or had a seen neighbour.
        """
        unseen = np.isnan(heights)
        if not unseen.any():
            return heights, 1.0
        candidates = heights[self._neighbours[unseen]]
        first = np.argmax(~np.isnan(candidates), axis=1)
        filled = heights.copy()
        filled[unseen] = candidates[np.arange(len(first)), first]
        blind = np.isnan(filled)
        filled[blind] = standing_on
        return filled, 1.0 - np.count_nonzero(blind) / len(blind)

    def _in_world(self, pos: np.ndarray, yaw: float) -> np.ndarray:
        cos, sin = math.cos(yaw), math.sin(yaw)
        return pos[:2] + self.points @ np.array([[cos, sin], [-sin, cos]])
