"""Observations: named terms in a fixed order. Sizes, scales, noise and reflections are computed from them."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor

from arrive.errors import ArriveError, unknown_name
from arrive.fields import NotNegative, Share
from arrive.robots.legs import foot_partners
from arrive.robots.robot import Robot
from arrive.task.heights import FootGrid, FootHeightsConfig, HeightGrid, HeightsConfig
from arrive.task.rotation import rotate, rotate_inverse, yaw_of
from arrive.task.state import Command, State
from arrive.terms import TERMS, TermMeaning

HEIGHT_OFFSET = 0.5
"""Heights are relative to a point this far below the base, for a robot of ANYmal C's size (legged_gym) [m]."""


@dataclass(frozen=True)
class Noise:
    """An observation without other parameters."""

    MAIN: ClassVar[str] = "noise"

    noise: NotNegative = 0.0
    """Half-width of the uniform noise."""


def _noise(width: float) -> Noise:
    return field(default=Noise(width))


@dataclass(frozen=True)
class ObservationConfig:
    """What the policy observes."""

    noise: bool = True
    """Whether to add noise."""
    noise_least: Share = 1.0
    """Lowest noise factor in training. Each robot has a fixed factor on its noise; the factors are evenly spaced from
    this to 1."""
    base_lin_vel: Noise = _noise(0.1)
    """Base linear velocity [m/s]."""
    base_ang_vel: Noise = _noise(0.2)
    """Base angular velocity [rad/s]."""
    gravity: Noise = _noise(0.05)
    """Direction of gravity [1]."""
    joint_pos: Noise = _noise(0.01)
    """Joint positions [rad]."""
    joint_vel: Noise = _noise(1.5)
    """Joint velocities [rad/s]."""
    foot_heights: FootHeightsConfig = field(default_factory=FootHeightsConfig)
    heights: HeightsConfig = field(default_factory=HeightsConfig)


@dataclass(frozen=True)
class ObservationTerm:
    """One named slice of the observation."""

    name: str
    """A name from `arrive.terms`."""
    labels: tuple[str, ...]
    """Meaning of each entry."""
    scale: float
    """The policy receives value * scale."""
    noise: float
    """Half-width of the uniform noise, in the term's unit."""
    reverse: tuple[tuple[int, float], ...]
    """Front-back reflection: for each entry, the entry that it comes from, and its sign. It is not used for a robot
    without that symmetry."""
    compute: Callable[[State, Any], Tensor]
    """Computes the term from the state and the task's own command."""
    reference: str = ""
    """Text added to the term's frame, where it depends on the robot."""

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ArriveError: an unknown name, a scale of 0 or that is not finite, a noise below 0, or a reflection that does
                not take every entry once.
        """
        if self.name not in TERMS:
            raise unknown_name("observation", self.name, TERMS)
        if not (math.isfinite(self.scale) and self.scale and 0.0 <= self.noise < math.inf):
            raise ArriveError(
                f"the observation {self.name!r} needs a finite scale other than 0 and a noise of at least 0, "
                f"not {self.scale!r} and {self.noise!r}"
            )
        if sorted(source for source, _ in self.reverse) != list(range(self.size)):
            raise ArriveError(f"the reflection of the observation {self.name!r} must name every entry once")

    @property
    def meaning(self) -> TermMeaning:
        """Unit and frame."""
        return TERMS[self.name]

    @property
    def size(self) -> int:
        return len(self.labels)


VECTOR_REVERSE = ((0, -1.0), (1, 1.0), (2, 1.0))
AXIAL_REVERSE = ((0, 1.0), (1, -1.0), (2, -1.0))
XYZ = ("x", "y", "z")


def reverse_map(robot: Robot) -> tuple[tuple[int, float], ...]:
    """The robot's front-back map by index. For a robot without that symmetry, every joint maps to itself."""
    index = {name: i for i, name in enumerate(robot.joint_names)}
    partners = robot.joint_reverse or tuple((name, 1.0) for name in robot.joint_names)
    return tuple((index[partner], sign) for partner, sign in partners)


def observation_terms(robot: Robot, config: ObservationConfig, episode_s: float) -> tuple[ObservationTerm, ...]:
    """The paper's observations (section Observation and Action Space) with legged_gym's scales and noise.

    The time left is clamped to the longest episode in training, because the policy has never seen more.
    """
    target_and_time = (
        ObservationTerm("target", XYZ, 0.5, 0.0, VECTOR_REVERSE,
                        lambda s, c: rotate_inverse(s.base_quat_w, c.target_w - s.base_pos_w)),
        ObservationTerm("time_left", ("t",), 2.0 / episode_s, 0.0, ((0, 1.0),),
                        lambda s, c: c.time_left_s.clamp(max=episode_s).unsqueeze(-1)),
    )  # fmt: skip
    return around_command(robot, config, target_and_time)


def around_command(
    robot: Robot, config: ObservationConfig, command_terms: tuple[ObservationTerm, ...]
) -> tuple[ObservationTerm, ...]:
    """The observation terms of every task, with the task's own command terms inserted.

    The direction of gravity is not in the paper's list. It is in the set-up of Rudin et al. 2021, on which the paper
    builds.
    """
    joints = robot.joint_names
    reverse_joints = reverse_map(robot)
    grid, offset = HeightGrid(config.heights), height_offset(robot)
    cells = tuple(f"({x:g}, {y:g})" for x, y in grid.cells.tolist())
    reverse_cells = tuple((i, 1.0) for i in grid.reverse())
    around_feet = (_foot_heights(robot, config, grid),) if config.foot_heights.enabled else ()
    return (
        ObservationTerm("base_lin_vel", XYZ, 2.0, config.base_lin_vel.noise, VECTOR_REVERSE,
                        lambda s, c: s.base_lin_vel_b),
        ObservationTerm("base_ang_vel", XYZ, 0.25, config.base_ang_vel.noise, AXIAL_REVERSE,
                        lambda s, c: s.base_ang_vel_b),
        ObservationTerm("gravity", XYZ, 1.0, config.gravity.noise, VECTOR_REVERSE,
                        lambda s, c: s.gravity_b),
        *command_terms,
        ObservationTerm("joint_pos", joints, 1.0, config.joint_pos.noise, reverse_joints, lambda s, c: s.joint_offset),
        ObservationTerm("joint_vel", joints, 0.05, config.joint_vel.noise, reverse_joints, lambda s, c: s.joint_vel),
        ObservationTerm("action", joints, 1.0, 0.0, reverse_joints, lambda s, c: s.action),
        *around_feet,
        ObservationTerm("heights", cells, config.heights.scale, config.heights.noise, reverse_cells,
                        lambda s, c: grid.pooled(relative_heights(s, s.heights_w, offset).clamp(*config.heights.clip)),
                        _below(offset)),
    )  # fmt: skip


def _foot_heights(robot: Robot, config: ObservationConfig, grid: HeightGrid) -> ObservationTerm:
    """The ground around each foot. Only points of the grid are used, so that a controller needs no others."""
    around, offset, heights = FootGrid(config.foot_heights), height_offset(robot), config.heights
    labels = tuple(f"{foot} ({x:g}, {y:g})" for foot in robot.foot_sites for x, y in around.offsets.tolist())
    samples = len(around.offsets)
    reverse = tuple((foot * samples + i, 1.0) for foot in foot_partners(robot) for i in around.reverse())

    def compute(state: State, command: Any) -> Tensor:
        points = grid.nearest(*around.around(feet_in_heading(state))).flatten(1)
        return relative_heights(state, state.heights_w.gather(1, points), offset).clamp(*heights.clip)

    return ObservationTerm("foot_heights", labels, heights.scale, heights.noise, reverse, compute, _below(offset))


def _below(offset: float) -> str:
    return f", {offset:g} m below the base, positive down"


def feet_in_heading(state: State) -> Tensor:
    """(n, feet, 2) horizontal positions of the feet, forward and left of the base [m]."""
    n, feet, _ = state.foot_pos_b.shape
    quat = state.base_quat_w.repeat_interleave(feet, dim=0)
    x, y, _ = rotate(quat, state.foot_pos_b.flatten(0, 1)).view(n, feet, 3).unbind(-1)
    yaw = yaw_of(state.base_quat_w).unsqueeze(-1)
    cos, sin = yaw.cos(), yaw.sin()
    return torch.stack([cos * x + sin * y, cos * y - sin * x], dim=-1)


def height_offset(robot: Robot) -> float:
    """Distance from the base down to the point that heights are relative to [m]."""
    return HEIGHT_OFFSET * robot.size


def relative_heights(state: State, heights_w: Tensor, offset: float) -> Tensor:
    """(n, k) how far (n, k) heights lie below the point that is `offset` below the base [m]."""
    return state.base_pos_w[:, 2:3] - offset - heights_w


class Observer:
    """Computes the observation vector from its terms."""

    def __init__(self, terms: tuple[ObservationTerm, ...], noisy: bool, device: torch.device, noise_least: float = 1.0):
        """Prepare scales and noise from the terms.

        Args:
            noise_least: factor on the first robot's noise. The last robot's is 1, and the others are evenly spaced.
        """
        self.terms = terms
        self.size = sum(term.size for term in terms)
        self._noisy, self._noise_least = noisy, noise_least
        self._scale = self._spread([term.scale for term in terms], device)
        self._noise = self._spread([term.scale * term.noise for term in terms], device)

    def _spread(self, values: list[float], device: torch.device) -> Tensor:
        sizes = torch.tensor([term.size for term in self.terms])
        return torch.tensor(values).repeat_interleave(sizes).to(device)

    def observe(self, state: State, command: Command, generator: torch.Generator) -> Tensor:
        """(n, size) scaled observation, with noise if this observer adds noise."""
        clean = torch.cat([_entries(term, state, command) for term in self.terms], dim=-1) * self._scale
        if not self._noisy:
            return clean
        noise = torch.rand(clean.shape, generator=generator, device=clean.device).mul_(2.0).sub_(1.0)
        if self._noise_least < 1.0:
            noise *= torch.linspace(self._noise_least, 1.0, len(clean), device=clean.device).unsqueeze(-1)
        return clean.addcmul_(noise, self._noise)

    def schema(self) -> list[dict[str, Any]]:
        """Name, slice, unit, frame, scale and labels of every term, as plain data for a checkpoint."""
        rows, start = [], 0
        for term in self.terms:
            rows.append({
                "name": term.name, "start": start, "stop": start + term.size, "unit": term.meaning.unit,
                "frame": term.meaning.frame + term.reference,
                "scale": term.scale, "labels": list(term.labels),
            })  # fmt: skip
            start += term.size
        return rows

    def reverse(self) -> tuple[Tensor, Tensor]:
        """Index and sign, (size,) each, of front-back reflection: reversed = observation[:, index] * sign."""
        index, sign, start = [], [], 0
        for term in self.terms:
            index += [start + source for source, _ in term.reverse]
            sign += [factor for _, factor in term.reverse]
            start += term.size
        return torch.tensor(index), torch.tensor(sign)

    def column(self, name: str, entry: int) -> int:
        """Index in the observation of an entry of a term."""
        return next(row["start"] for row in self.schema() if row["name"] == name) + entry


def _entries(term: ObservationTerm, state: State, command: Any) -> Tensor:
    """(n, size) values of a term.

    Raises:
        ArriveError: its function returned something else.
    """
    value, shape = term.compute(state, command), (len(state.base_pos_w), term.size)
    if not isinstance(value, Tensor) or value.shape != shape:
        found = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
        raise ArriveError(f"the observation {term.name!r} must be a tensor of the shape {shape}, not {found}")
    return value
