"""What the controller answers in every step."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class JointCommand:
    """What the drives are to do until the next step, with the gains that the policy file names."""

    targets: np.ndarray
    """(joints,) position targets, always finite and within the joints' ranges [rad]."""
    mode: str
    """`target`, `hold`, `joystick`, `stop`, `way_points`; `safe` or `fallen` where the policy does not act."""
    reason: str
    """Why the controller does not simply do as told; empty where it does."""
