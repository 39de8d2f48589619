"""The showreel: which episodes it shows, and the size of its file."""

import numpy as np
import pytest
from PIL import Image

from arrive.commands import showreel as command
from arrive.errors import ArriveError
from arrive.play.skills import open_skill
from arrive.policies import shipped_names
from arrive.policies.solved import solved_beside
from arrive.render import showreel
from arrive.render.showreel import FPS, SIZE, frames, record_episode, write_showreel
from arrive.terrain.ground import ground_of

ABLE = next(name for name in shipped_names() if solved_beside(command.SHIPPED / name))
"""A policy that was measured to solve some terrain."""


@pytest.fixture(scope="module")
def episode():
    skill = open_skill(ABLE)
    return record_episode(skill, skill.ground("evaluation"))


def test_an_episode_ends_where_the_robot_stands_at_its_target(episode):
    assert np.linalg.norm(episode.qpos[-1, :3] - episode.target_w) < 0.5
    assert np.linalg.norm(episode.qpos[0, :2]) < 0.1
    assert len(episode.qpos) * episode.control_dt < 9.0
    assert episode.caption.startswith(open_skill(ABLE).ground("evaluation").family.name)


def test_a_robot_that_does_not_arrive_is_not_shown(monkeypatch):
    monkeypatch.setattr(showreel, "EASIER", (1.0,))
    assert record_episode(open_skill(ABLE), ground_of("gap=1.4", layout="evaluation")) is None


def test_every_terrain_shows_the_policy_that_solves_the_hardest(tmp_path, monkeypatch):
    solved = {"a": {"gap": 0.3, "pit": 0.2}, "b": {"gap": 0.5}, "c": {}}
    monkeypatch.setattr(command, "shipped_names", lambda: list(solved))
    monkeypatch.setattr(command, "solved_beside", lambda folder: solved[folder.name])
    assert command._scenes(()) == [("b", "gap"), ("a", "pit")]
    assert command._scenes(("c",)) == [("c", None)]
    solved.update(a={}, b={})
    with pytest.raises(ArriveError, match="--protocol difficulty"):
        command._scenes(())


def test_frames_follow_real_time_and_move(episode, graphics_or_skip, monkeypatch):
    monkeypatch.setattr(showreel, "FPS", 1)
    shown = [np.asarray(frame, dtype=float) for frame in frames(episode)]
    assert len(shown) == int((len(episode.qpos) - 1) * episode.control_dt) + 1
    assert shown[0].shape == (SIZE[1], SIZE[0], 3)
    assert np.abs(shown[1] - shown[0]).mean() > 1.0


def test_the_picture_is_endless_and_as_good_as_fits(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    noise = [Image.fromarray(rng.integers(0, 255, (60, 90, 3), dtype=np.uint8)) for _ in range(4)]
    out = tmp_path / "reel.webp"
    best = write_showreel(noise, out)
    with Image.open(out) as picture:
        assert (picture.n_frames, picture.info["loop"]) == (4, 0)
        assert picture.info.get("duration", 1000 // FPS) == pytest.approx(1000 / FPS, abs=1)
    monkeypatch.setattr(showreel, "LARGEST_BYTES", best - 1)
    assert write_showreel(noise, out) < best
    monkeypatch.setattr(showreel, "LARGEST_BYTES", 100)
    before = out.read_bytes()
    with pytest.raises(ArriveError, match="fewer policies"):
        write_showreel(noise, out)
    assert out.read_bytes() == before
