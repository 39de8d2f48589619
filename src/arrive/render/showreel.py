"""One animated picture of robots on the terrains that their policies solve."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from arrive.errors import ArriveError
from arrive.evaluation.episode import Episode
from arrive.files import whole
from arrive.play.playground import DURATION_S, Playground
from arrive.play.skills import Skill
from arrive.render.pictures import open_stage
from arrive.terrain.ground import Ground

SIZE = (480, 300)
"""Width and height [pixels]."""
FPS = 15
LARGEST_BYTES = 3_000_000
QUALITIES = (80, 65, 50, 35, 20)
"""Qualities of the encoder. The first one that keeps the file below its limit is taken."""
EASIER = (1.0, 0.9, 0.8, 0.7)
"""Shares of the hardest value. They are tried in this order until the robot arrives."""
REST_S = 0.8
"""How long a robot is shown at its target [s]."""


def record_episode(skill: Skill, ground: Ground) -> Episode | None:
    """An episode to a target beyond the terrain, with the deployment controller. None if the robot does not arrive."""
    for share in EASIER:
        easier = Ground(ground.family, max(share * ground.value, ground.family.lowest), ground.layout)
        episode = _attempt(Playground(skill, easier))
        if episode is not None:
            return episode
    return None


def _attempt(playground: Playground) -> Episode | None:
    playground.go(DURATION_S)
    places, radius = [playground.robot.data.qpos.copy()], playground.skill.policy.task.arrival_radius_m
    arrived_s = None
    while arrived_s is None or playground.time_s < arrived_s + REST_S:
        playground.step()
        if playground.falls or playground.time_s > DURATION_S + REST_S:
            return None
        places.append(playground.robot.data.qpos.copy())
        # Within half of the radius, so that it does not only run through.
        if arrived_s is None and playground.distance < radius / 2:
            arrived_s = playground.time_s
    ground = playground.ground
    caption = f"{ground.family.name} {ground.amount}".strip()
    return Episode(
        model=playground.robot.model,
        qpos=np.array(places),
        target_w=playground.aim,
        target_radius=radius,
        control_dt=playground.control_dt,
        outcome="arrived",
        caption=caption,
    )


def frames(episode: Episode) -> Iterator[Image.Image]:
    """Pictures of an episode in real time.

    Raises:
        GraphicsUnavailable: this machine cannot draw.
    """
    font = ImageFont.load_default(20)
    duration_s = (len(episode.qpos) - 1) * episode.control_dt
    with open_stage(episode, *SIZE) as stage:
        for number in range(int(duration_s * FPS) + 1):
            image = Image.fromarray(stage.draw(episode.index_at(number / FPS)))
            ImageDraw.Draw(image).text((12, 8), episode.caption, "black", font)
            yield image


def write_showreel(pictures: Sequence[Image.Image], out: Path) -> int:
    """Write a WebP that repeats, of at most `LARGEST_BYTES`, and return its size in bytes.

    Raises:
        ArriveError: it would be larger even with the lowest quality, or cannot be written.
    """
    with whole(out) as file:
        for quality in QUALITIES:
            options = {"duration": 1000 // FPS, "loop": 0, "quality": quality, "method": 4}
            pictures[0].save(file, "WEBP", save_all=True, append_images=pictures[1:], **options)
            if (size := file.stat().st_size) <= LARGEST_BYTES:
                return size
        raise ArriveError(
            f"{len(pictures) / FPS:.0f} s do not fit into {LARGEST_BYTES / 1e6:g} MB; name fewer policies"
        )
