"""Parameters of a family's levels, and the seed offset that separates evaluation terrain from training terrain."""

from arrive.errors import ArriveError
from arrive.terrain.family import Family

EVALUATION_SEED_OFFSET = 1_000_003
"""Added to the seed in evaluation, so that policies are evaluated on terrain they were not trained on."""


def level_values(family: Family, num_levels: int) -> tuple[float, ...]:
    """Parameters of a family's levels. A family without a varying parameter has one level."""
    if num_levels < 1:
        raise ArriveError(f"terrain.levels must be at least 1, not {num_levels}")
    count = 1 if family.lowest == family.highest else num_levels
    return tuple(family.value(level, count) for level in range(count))
