"""What the levels of a family mean, and what keeps measured terrain apart from trained terrain."""

from arrive.errors import ArriveError
from arrive.terrain.family import Family

EVALUATION_SEED_OFFSET = 1_000_003
"""Keeps the terrain that policies are evaluated on apart from what they were trained on."""


def level_values(family: Family, num_levels: int) -> tuple[float, ...]:
    """Parameters of a family's levels; one level for a family whose parameter does not vary."""
    if num_levels < 1:
        raise ArriveError(f"terrain.levels must be at least 1, not {num_levels}")
    count = 1 if family.lowest == family.highest else num_levels
    return tuple(family.value(level, count) for level in range(count))
