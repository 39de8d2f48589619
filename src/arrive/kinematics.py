"""Where the feet are, from the joints' positions. Used by training (torch) and by the controller (NumPy only)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Link:
    """A hinge joint on the way from the base to a foot, in the base frame, with all joint positions 0."""

    joint: str
    pos_m: Sequence[float]
    """(3,) a point on its axis [m]."""
    axis: Sequence[float]
    """(3,) unit vector."""


@dataclass(frozen=True)
class FootChain:
    """All joints from the base to a foot, and where it is with all joint positions 0."""

    links: Sequence[Link]
    foot_m: Sequence[float]
    """(3,) in the base frame."""


class FootKinematics:
    """Positions of all feet. Its tables have one row per joint of the longest leg, counted from the base.

    A joint moves a point that is `arm` away from it by `(sin * cross + (1 - cos) * square) @ arm` (Rodrigues). Both
    matrices are 0 for the links that a shorter leg lacks.
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
        cross = np.zeros((depth, feet, 3, 3))
        for foot, chain in enumerate(chains):
            for k, link in enumerate(chain.links):
                x, y, z = link.axis
                joint[k, foot], pos[k, foot] = joint_names.index(link.joint), link.pos_m
                cross[k, foot] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
        self._joint = joint.tolist()
        self._pos, self._cross, self._square = map(to_array, (pos, cross, cross @ cross))
        self._foot = to_array(np.array([chain.foot_m for chain in chains]))

    def positions_b(self, sin: Any, cos: Any) -> Any:
        """(n, feet, 3) in the base frame [m].

        Args:
            sin, cos: (n, joints) of the joint positions.
        """
        place = self._foot
        for k in reversed(range(len(self._joint))):
            s, c = (part[:, self._joint[k]][..., None, None] for part in (sin, cos))
            arm = (place - self._pos[k])[..., None]
            place = place + ((s * self._cross[k] + (1.0 - c) * self._square[k]) @ arm)[..., 0]
        return place
