"""Target sampling: uniform in polar coordinates around the start, on ground that allows a target."""

import math
from typing import Protocol

import torch
from torch import Tensor

from arrive.errors import ArriveError
from arrive.task.heights import look_up
from arrive.terrain.rasters import Rasters
from arrive.terrain.tile import RASTER_CELL, RASTER_HALF

MAX_TRIES = 32
"""Candidates drawn per target. `build_tile` accepts only tiles on which at least a quarter of them are valid, so the
probability that all fail is at most 0.75^32, one in ten thousand. A fixed sweep then finds a valid point."""
EDGE = 0.5
"""Targets keep this distance from the edge of the tile's raster [m]."""
REACH = RASTER_HALF - EDGE
"""Largest distance of targets from the tile's origin along an axis [m]."""


class TargetConfig(Protocol):
    """The fields of a task's configuration that say which targets to draw."""

    @property
    def target_distance(self) -> tuple[float, float]: ...

    @property
    def target_height(self) -> float: ...

    @property
    def crossing_share(self) -> float: ...

    @property
    def nearest_share(self) -> float: ...


def sample_targets(
    rasters: Rasters, tile_ids: Tensor, start_w: Tensor, config: TargetConfig, generator: torch.Generator
) -> Tensor:
    """Draw a valid target for each robot (paper, section Episode Process).

    A share of the robots, `crossing_share`, get the first candidate beyond the obstacle, if there is one; of those
    robots a share, `nearest_share`, get the nearest one instead, where they have to stop and stand just behind it.

    Args:
        tile_ids: (n,) rasters of the robots' tiles.
        start_w: (n, 3) positions of the bases [m].

    Returns:
        (n, 3) targets, `target_height` above the ground [m].
    """
    shape = (len(tile_ids), MAX_TRIES)
    low, high = config.target_distance
    device = start_w.device
    radius = low + (high - low) * torch.rand(shape, generator=generator, device=device)
    angle = 2.0 * math.pi * torch.rand(shape, generator=generator, device=device)
    offset = torch.stack([radius * torch.cos(angle), radius * torch.sin(angle)], dim=-1)
    candidates = start_w[:, None, :2] + offset
    valid = _on_valid_ground(rasters, tile_ids, candidates)
    rank = valid.to(torch.uint8)
    if config.crossing_share > 0.0:
        across = torch.rand(shape[:1], generator=generator, device=device) < config.crossing_share
        rank += valid & across[:, None] & look_up(rasters.crossing, tile_ids, candidates)
    # The first of the best candidates, because argmax returns the first maximum of a row.
    chosen = rank.argmax(-1)
    if config.nearest_share > 0.0:
        close = torch.rand(shape[:1], generator=generator, device=device) < config.nearest_share
        nearest = torch.where(rank == 2, radius, math.inf).argmin(-1)
        chosen = torch.where(close & (rank == 2).any(-1), nearest, chosen)
    targets = candidates[torch.arange(len(tile_ids), device=device), chosen]
    none = ~valid.any(-1)
    if none.any():
        targets[none] = _any_valid(rasters, tile_ids[none], start_w[none], config)
    ground = look_up(rasters.heights, tile_ids, targets.unsqueeze(1)).squeeze(1)
    return torch.cat([targets, (ground + config.target_height).unsqueeze(-1)], dim=-1)


def _on_valid_ground(rasters: Rasters, tile_ids: Tensor, points: Tensor) -> Tensor:
    """(n, k) bool: a target is allowed at (n, k, 2) points. None is allowed outside the raster or near its edge."""
    inside = (points.abs() < REACH).all(-1)
    return inside & look_up(rasters.target_valid, tile_ids, points)


def _any_valid(rasters: Rasters, tile_ids: Tensor, start_w: Tensor, config: TargetConfig) -> Tensor:
    """(n, 2) the first valid point of a fine polar sweep, for robots whose candidates all failed."""
    device = start_w.device
    radius, angle = torch.meshgrid(
        torch.linspace(config.target_distance[1], config.target_distance[0], 41, device=device),
        torch.linspace(0.0, 2.0 * math.pi, 73, device=device),
        indexing="ij",
    )
    sweep = torch.stack([radius * torch.cos(angle), radius * torch.sin(angle)], dim=-1).view(1, -1, 2)
    candidates = start_w[:, None, :2] + sweep
    valid = _on_valid_ground(rasters, tile_ids, candidates)
    if not valid.any(-1).all():
        raise ArriveError("a terrain tile offers no valid target within the target distance")
    return candidates[torch.arange(len(tile_ids), device=device), valid.to(torch.uint8).argmax(-1)]


def next_valid(rasters: Rasters, tile_ids: Tensor, points: Tensor) -> Tensor:
    """(n, 2) the points themselves where a target is allowed, otherwise the next valid point on the origin's ray.

    Points farther out are tried first, the nearest first, then those closer to the origin.

    Args:
        tile_ids: (n,) rasters of the robots' tiles.
        points: (n, 2) in the tile's frame [m].
    """
    radius = points.norm(dim=-1, keepdim=True)
    steps = torch.arange(0.0, 2.0 * RASTER_HALF, RASTER_CELL, device=points.device)
    radii = torch.cat([radius + steps, (radius - steps).clamp(min=0.0)], dim=-1)
    candidates = points[:, None] * (radii / radius.clamp(min=1e-6))[..., None]
    chosen = _on_valid_ground(rasters, tile_ids, candidates).to(torch.uint8).argmax(-1)
    return candidates[torch.arange(len(points), device=points.device), chosen]
