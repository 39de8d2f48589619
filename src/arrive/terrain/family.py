"""A terrain family: tiles of one kind whose difficulty is a physical parameter."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from arrive.errors import ArriveError
from arrive.terrain.tile import Tile

Layout = Literal["training", "evaluation"]
"""`training` surrounds the robot with the terrain; `evaluation` puts 4 m of it ahead, between the robot and a target
5 m in front (paper, section Maximum Terrain Difficulty)."""

TileBuilder = Callable[[float, np.random.Generator, Layout, float], Tile]
"""Builds a tile from the parameter's value, a random generator, the layout, and the robot's size (1 for ANYmal C).
Lengths that give the robot room scale with its size. The parameter that makes the terrain hard does not."""


@dataclass(frozen=True)
class Family:
    """A kind of terrain; `build(value, rng, layout, size)` makes a tile whose parameter has the given value."""

    name: str
    description: str
    parameter: str
    unit: str
    lowest: float
    """Parameter at the first level."""
    highest: float
    """Parameter at the last level."""
    build: TileBuilder
    random: bool
    """Whether two tiles of the same parameter differ, so that several per level are worth building."""

    def value(self, level: int, num_levels: int) -> float:
        """Parameter at a level: linear from `lowest` at level 0 to `highest` at the last level."""
        if not 0 <= level < num_levels:
            raise ArriveError(f"level {level} of {self.name} is out of range: levels are 0 to {num_levels - 1}")
        return self.lowest + (self.highest - self.lowest) * level / max(num_levels - 1, 1)
