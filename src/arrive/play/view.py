"""Where a browser's camera stands at first, and what its sky looks like from there."""

from dataclasses import dataclass

import numpy as np

from arrive.play.colours import Rgb

FIELD_OF_VIEW_RAD = 0.85
"""Vertical."""
WIDE, NARROW = 1.0, 0.6
"""Width over height of a picture from which on the camera stands well beside the robot, and below which behind it."""
BESIDE_DEG, BEHIND_DEG = 48.0, 20.0
"""Direction of the way to the target against that in which the camera looks, in a wide and in a narrow picture."""
DOWN_DEG, STEEPER_DEG = 15.0, 24.0
"""How far down the camera looks in a wide and in a narrow picture, where the target lies above the robot."""
ROBOT_RADIUS, TARGET_RADIUS = 1.25, 0.8
"""Radii of what is to be in the picture, around the base of ANYmal C and around the target [m]."""
NEAREST, FARTHEST = 4.0, 14.0
"""Distance between the camera and the point it looks at [m]."""
SHARES = np.linspace(0.1, 0.6, 11)
"""The camera looks at one of these shares of the way from the robot to its target: that from which it sees both from
nearest."""
HORIZON: Rgb = (214, 226, 238)
ZENITH: Rgb = (84, 138, 198)
SKY_DEG = 35.0
"""Height above the horizon at which the sky has the zenith's colour."""


@dataclass(frozen=True)
class View:
    """A camera's place and the point it looks at, both (3,) [m]."""

    position: np.ndarray
    look_at: np.ndarray


def first_view(base: np.ndarray, target: np.ndarray, aspect: float) -> View:
    """The view along the way that has the robot and its target in the picture, from as near as can be.

    Args:
        base, target: (3,) places [m].
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
    """(3, 3) rows: forward, right and up of a camera that looks there [rad]."""
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    forward = np.cos(elevation) * level + np.array([0.0, 0.0, np.sin(elevation)])
    right = np.array([level[1], -level[0], 0.0])
    return np.stack([forward, right, np.cross(right, forward)])


def _fit(points: np.ndarray, axes: np.ndarray, tan_right: float, tan_up: float) -> float:
    """Least distance from the point looked at, the origin, at which robot and target are in the picture [m]."""
    forward, right, up = axes @ points.T
    radii = np.array([ROBOT_RADIUS, TARGET_RADIUS])
    return float(np.max(np.maximum((np.abs(right) + radii) / tan_right, (np.abs(up) + radii) / tan_up) - forward))


def pitch(forward: np.ndarray) -> float:
    """How far up a camera looks, from the horizontal [rad]."""
    return float(np.arctan2(forward[2], np.hypot(forward[0], forward[1])))


def sky(pitch_rad: float, fov_rad: float = FIELD_OF_VIEW_RAD, rows: int = 256) -> np.ndarray:
    """(rows, 8, 3) what is behind everything for a camera that looks up so far: a sky with its horizon in place.

    Below the horizon it has the horizon's colour, into which the ground fades.
    """
    place = np.linspace(1.0, -1.0, rows) * np.tan(fov_rad / 2)
    height = np.degrees(pitch_rad + np.arctan(place))
    share = np.clip(height / SKY_DEG, 0.0, 1.0)[:, None] ** 0.7
    column = np.array(HORIZON) + share * (np.array(ZENITH) - np.array(HORIZON))
    return np.repeat(column[:, None], 8, axis=1).round().astype(np.uint8)
