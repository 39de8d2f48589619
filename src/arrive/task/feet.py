"""How long feet are in the air."""

from torch import Tensor


def follow_feet(air_s: Tensor, touched: Tensor, touches: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """Let one policy step pass. A contact that is lost for one step does not end a stance (legged_gym).

    Args:
        air_s: (n, feet) time each foot had been in the air [s].
        touched, touches: (n, feet) bool: in contact before and after the step.
        dt: length of the step [s].

    Returns:
        (n, feet) the same after the step [s], and (n, feet) for feet that have just landed how long they had been in
        the air, 0 for the others [s].
    """
    stands = touches | touched
    longer = air_s + dt
    return longer * ~stands, longer * (stands & (air_s > 0.0))
