"""Air time of the feet."""

from torch import Tensor


def follow_feet(air_s: Tensor, touched: Tensor, touches: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """Advance the feet's air times by one policy step. Losing contact for one step does not end a stance (legged_gym).

    Args:
        air_s: (n, feet) air time of each foot before the step [s].
        touched, touches: (n, feet) bool: in contact before and after the step.
        dt: length of the step [s].

    Returns:
        (n, feet) air times after the step [s]; and (n, feet) the full air time of feet that have just landed, 0 for
        the others [s].
    """
    stands = touches | touched
    longer = air_s + dt
    return longer * ~stands, longer * (stands & (air_s > 0.0))
