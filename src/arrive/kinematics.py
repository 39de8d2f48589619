"""Where the feet are, from the joints' positions. Used by training (torch) and by the controller (NumPy only)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Link:
    """A hinge joint on the way from the base to a foot. Its frame moves with it."""

    joint: str
    pos_m: Sequence[float]
    """(3,) of the joint in the frame of the link before it, for the first one in the base frame."""
    rotation: Sequence[Sequence[float]]
    """(3, 3) matrix that rotates from this frame to the one before it, at joint position 0."""
    axis: Sequence[float]
    """(3,) the joint's axis in this frame, a unit vector."""


@dataclass(frozen=True)
class FootChain:
    """All joints from the base to a foot."""

    links: Sequence[Link]
    foot_m: Sequence[float]
    """(3,) the foot in the frame of the last link."""


class FootKinematics:
    """Positions of all feet. Its tables have one row per joint of the longest leg, counted from the base.

    A shorter leg ends with links that do not move. Rotation by a joint is `fixed + sin * cross + (1 - cos) * square`
    (Rodrigues), where each is (links, feet, 3, 3).
    """

    def __init__(
        self,
        chains: Sequence[FootChain],
        joint_names: Sequence[str],
        to_array: Callable[[np.ndarray], Any] = np.asarray,
    ):
        """Prepare the tables.

        Args:
            chains: one for each foot.
            joint_names: the order of the joint positions.
            to_array: makes the tables what `positions_b` is to compute with, such as torch tensors.
        """
        depth, feet = max(len(chain.links) for chain in chains), len(chains)
        joint, pos = np.zeros((depth, feet), dtype=int), np.zeros((depth, feet, 3))
        fixed = np.tile(np.eye(3), (depth, feet, 1, 1))
        cross, square = np.zeros_like(fixed), np.zeros_like(fixed)
        for foot, chain in enumerate(chains):
            for k, link in enumerate(chain.links):
                turn, (x, y, z) = np.array(link.rotation), link.axis
                across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
                joint[k, foot] = joint_names.index(link.joint)
                pos[k, foot], fixed[k, foot] = link.pos_m, turn
                cross[k, foot], square[k, foot] = turn @ across, turn @ across @ across
        self._joint = joint.tolist()
        self._pos, self._fixed, self._cross, self._square = map(to_array, (pos, fixed, cross, square))
        self._foot = to_array(np.array([chain.foot_m for chain in chains]))

    def positions_b(self, sin: Any, cos: Any) -> Any:
        """(n, feet, 3) in the base frame [m].

        Args:
            sin, cos: (n, joints) of the joint positions.
        """
        place = self._foot
        for k in reversed(range(len(self._joint))):
            s, c = (part[:, self._joint[k]][..., None, None] for part in (sin, cos))
            turn = self._fixed[k] + s * self._cross[k] + (1.0 - c) * self._square[k]
            place = self._pos[k] + (turn @ place[..., None])[..., 0]
        return place
