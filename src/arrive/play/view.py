"""The first view of a browser's camera, and the sky that it sees."""

from dataclasses import dataclass

import numpy as np

from arrive.play.colours import Rgb

FIELD_OF_VIEW_RAD = 0.85
"""Vertical field of view."""
WIDE, NARROW = 1.0, 0.6
"""Width over height of a wide picture (camera beside the robot) and of a narrow one (camera behind it)."""
BESIDE_DEG, BEHIND_DEG = 48.0, 20.0
"""Angle between the camera's direction and the way to the target, in a wide and in a narrow picture."""
DOWN_DEG, STEEPER_DEG = 15.0, 24.0
"""Angle by which the camera looks down, in a wide and in a narrow picture."""
ROBOT_RADIUS, TARGET_RADIUS = 1.25, 0.8
"""Radii around the base of ANYmal C and around the target that must be in the picture [m]."""
NEAREST, FARTHEST = 4.0, 14.0
"""Distance between the camera and the point it looks at [m]."""
SHARES = np.linspace(0.1, 0.6, 11)
"""Candidates for the point that the camera looks at, as shares of the way from robot to target. The one that lets the
camera come nearest is chosen."""
HORIZON: Rgb = (214, 226, 238)
ZENITH: Rgb = (84, 138, 198)
SKY_DEG = 35.0
"""Angle above the horizon at which the sky has the colour of the zenith."""


@dataclass(frozen=True)
class View:
    """A camera's position and the point that it looks at, both (3,) [m]."""

    position: np.ndarray
    look_at: np.ndarray


def first_view(base: np.ndarray, target: np.ndarray, aspect: float) -> View:
    """The nearest view along the way that shows both the robot and its target.

    Args:
        base, target: (3,) positions [m].
        aspect: width of the picture over its height.
    """
    share = np.clip((aspect - NARROW) / (WIDE - NARROW), 0.0, 1.0)
    way = target - base
    heading = np.arctan2(way[1], way[0]) if np.hypot(way[0], way[1]) > 0.1 else 0.0
    azimuth = heading + np.radians(BEHIND_DEG + share * (BESIDE_DEG - BEHIND_DEG))
    axes = camera_axes(azimuth, -np.radians(STEEPER_DEG + share * (DOWN_DEG - STEEPER_DEG)))
    up = np.tan(FIELD_OF_VIEW_RAD / 2)
    distances = [_fit(np.array([base, target]) - (base + part * way), axes, up * aspect, up) for part in SHARES]
    best = int(np.argmin(distances))
    look_at = base + SHARES[best] * way
    return View(look_at - np.clip(distances[best], NEAREST, FARTHEST) * axes[0], look_at)


def camera_axes(azimuth: float, elevation: float) -> np.ndarray:
    """(3, 3) forward, right and up vectors of a camera with this azimuth and elevation [rad]."""
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    forward = np.cos(elevation) * level + np.array([0.0, 0.0, np.sin(elevation)])
    right = np.array([level[1], -level[0], 0.0])
    return np.stack([forward, right, np.cross(right, forward)])


def _fit(points: np.ndarray, axes: np.ndarray, tan_right: float, tan_up: float) -> float:
    """Shortest distance from the camera to the point that it looks at, with robot and target in the picture [m].

    Args:
        points: (2, 3) robot and target, relative to that point [m].
    """
    forward, right, up = axes @ points.T
    radii = np.array([ROBOT_RADIUS, TARGET_RADIUS])
    return float(np.max(np.maximum((np.abs(right) + radii) / tan_right, (np.abs(up) + radii) / tan_up) - forward))


def pitch(forward: np.ndarray) -> float:
    """Elevation of a camera's direction [rad]."""
    return float(np.arctan2(forward[2], np.hypot(forward[0], forward[1])))


def sky(pitch_rad: float, fov_rad: float = FIELD_OF_VIEW_RAD, rows: int = 256) -> np.ndarray:
    """(rows, 8, 3) background image for a camera with this pitch: a sky with its horizon.

    Below the horizon it has the horizon's colour, into which the ground fades.
    """
    place = np.linspace(1.0, -1.0, rows) * np.tan(fov_rad / 2)
    height = np.degrees(pitch_rad + np.arctan(place))
    share = np.clip(height / SKY_DEG, 0.0, 1.0)[:, None] ** 0.7
    column = np.array(HORIZON) + share * (np.array(ZENITH) - np.array(HORIZON))
    return np.repeat(column[:, None], 8, axis=1).round().astype(np.uint8)
