"""The controller's output in every step."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class JointCommand:
    """Command for the drives until the next step. They run with the gains of the policy file."""

    targets: np.ndarray
    """(joints,) position targets, always finite and within the joints' ranges [rad]."""
    mode: str
    """`target`, `hold`, `joystick`, `stop` or `way_points`; `safe` or `fallen` if the policy does not act."""
    reason: str
    """Why the controller does not follow the goal exactly; empty if it does."""
