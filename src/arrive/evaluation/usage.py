"""How a policy uses its time and its body: when it arrives, how long its path is, how fast it is, how it moves."""

from typing import Any

import torch
from torch import Tensor

from arrive.evaluation.arrival import Arrival
from arrive.evaluation.motion import UNITS, summary
from arrive.evaluation.playing import Played

SAMPLE_S = 0.2
"""Positions are compared this far apart [s], so that the swaying of the base is no way covered."""


def usage_of(answer: Arrival, control_dt: float) -> list[dict[str, Any]]:
    """Arrival time, path length, speed profile and motion of the successful episodes of every cell.

    Arrival is the first moment at which the episode would have been a success if it had ended; the path is measured
    horizontally up to then, the profile over the whole episode.
    """
    stride = round(SAMPLE_S / control_dt)
    success = torch.cat([part.success for part in answer.played])
    arrival_s = torch.cat([part.reached for part in answer.played]) * control_dt
    ways = torch.cat([_ways(part, stride) for part in answer.played], dim=1)
    motion = {name: torch.cat([part.motion[name] for part in answer.played]) for name in UNITS}
    rows = []
    for index, result in enumerate(answer.results):
        mine = success & (answer.cell_of_episode == index)
        row: dict[str, Any] = {"value": result.cell.value, "episodes": int(mine.sum())}
        if mine.any():
            times = SAMPLE_S * torch.arange(1, len(ways) + 1)
            path = (ways[:, mine] * (times[:, None] <= arrival_s[mine] + SAMPLE_S / 2)).sum(0)
            row |= {
                "arrival_time_s": _quartiles(arrival_s[mine]),
                "path_length_m": _quartiles(path),
                "speed_profile": {
                    "time_s": [round(t, 3) for t in (times - SAMPLE_S / 2).tolist()],
                    "mean_m_s": [round(v, 4) for v in (ways[:, mine].mean(1) / SAMPLE_S).tolist()],
                },
                "motion": summary(motion, mine),
            }
        rows.append(row)
    return rows


def _ways(part: Played, stride: int) -> Tensor:
    """(samples, n) horizontal distance between neighbouring samples of the traces [m]."""
    return part.trace_w[::stride, :, :2].diff(dim=0).norm(dim=-1)


def _quartiles(values: Tensor) -> list[float]:
    """Lower quartile, median and upper quartile."""
    quantiles = torch.quantile(values.double(), torch.tensor([0.25, 0.5, 0.75], dtype=torch.double))
    return [round(value, 4) for value in quantiles.tolist()]
