"""Pictures and films of an episode."""

import math
import os
import subprocess
import sys
from types import SimpleNamespace

import imageio.v2 as imageio
import mujoco
import numpy as np
import pytest
from PIL import Image

from arrive.render import graphics, pictures


def make_episode(target_radius: float = 0.5) -> pictures.Episode:
    """A box that slides 2 m over a plane, onto a step of 0.2 m."""
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><worldbody>
          <geom type="plane" size="0 0 0.1"/>
          <geom type="box" pos="2 0 0" size="0.5 1 0.2" rgba="0.6 0.5 0.4 1"/>
          <body pos="0 0 0.3"><freejoint/>
            <geom type="box" size="0.3 0.2 0.1" group="3" rgba="1 0 0 1"/></body>
        </worldbody></mujoco>""")
    qpos = np.zeros((51, 7))
    qpos[:, 0], qpos[:, 2], qpos[:, 3] = np.linspace(0, 2, 51), 0.5, 1.0
    return pictures.Episode(model, qpos, (2.0, 0.0, 0.5), target_radius, 0.02, "arrived", "box")


def test_the_path_lies_on_the_ground():
    path = make_episode().ground_path_w
    np.testing.assert_allclose(path[[0, -2, -1], 2], [0.0, 0.2, 0.2], atol=1e-9)


def test_path_and_target_are_in_view_at_every_step():
    episode = make_episode()
    cameras = pictures._Cameras(episode, 16 / 9, 45.0)
    for step in (0, 25, 50):
        camera = cameras.at(step)
        eye = camera.lookat - camera.distance * pictures._axes(camera)[0]
        points = np.vstack([episode.qpos[:, :3], episode.target_w])
        forward, right, up = pictures._axes(camera) @ (points - eye).T
        tangent = math.tan(math.radians(22.5))
        assert (forward > 0).all()
        assert (abs(right) < forward * tangent * 16 / 9).all()
        assert (abs(up) < forward * tangent).all()


def test_a_strip_shows_robot_and_target(graphics_or_skip, tmp_path):
    pictures.picture_strip(make_episode(), tmp_path / "strip.png", frames=2)
    pixels = np.asarray(Image.open(tmp_path / "strip.png")).astype(int)
    red, green, blue = np.moveaxis(pixels, -1, 0)
    half = pixels.shape[1] // 2
    robot, target = (red > 2 * green) & (red > 2 * blue), (green > 1.5 * red) & (green > 1.5 * blue)
    assert robot[:, :half].sum() > 200
    assert robot[:, half:].sum() > 200
    assert target[:, :half].sum() > 100
    assert [path.name for path in tmp_path.iterdir()] == ["strip.png"]


def test_the_disc_is_where_robots_arrive(graphics_or_skip):
    """A disc of twice the radius has four times the area: green beside the step's brown, at the last step."""
    seen = []
    for radius in (0.25, 0.5):
        with pictures.open_stage(make_episode(radius), 400, 320) as stage:
            red, green, blue = np.moveaxis(stage.draw(50).astype(int), -1, 0)
        seen.append(((green > 1.05 * red) & (green > 1.05 * blue)).sum())
    assert seen[1] > 2 * seen[0] > 0


def test_a_film_plays_in_real_time(graphics_or_skip, tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "FILM_SIZE", (160, 120))
    pictures.film(make_episode(), tmp_path / "film.mp4", fps=10)
    with imageio.get_reader(tmp_path / "film.mp4") as reader:
        meta = reader.get_meta_data()
        assert meta["codec"] == "h264"
        assert meta["pix_fmt"].startswith("yuv420p")
        assert sum(1 for _ in reader) == 11  # its len() is infinite
        assert meta["duration"] == pytest.approx(1.1, abs=0.11)


def test_without_graphics_the_error_names_the_packages(tmp_path, monkeypatch):
    graphics.graphics_backend.cache_clear()
    monkeypatch.setattr(graphics.subprocess, "run", lambda *args, **options: SimpleNamespace(returncode=-11))
    with pytest.raises(graphics.GraphicsUnavailable, match=r"libosmesa6.*libegl1"):
        pictures.picture_strip(make_episode(), tmp_path / "strip.png")
    assert not any(tmp_path.iterdir())
    graphics.graphics_backend.cache_clear()


def test_without_the_bindings_of_opengl_the_error_is_the_same():
    """In a process of its own, in which nothing has been drawn yet and PyOpenGL cannot be imported."""
    code = """
import sys
sys.modules["OpenGL"] = None
from arrive.render import graphics
graphics.graphics_backend = lambda: "egl"
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco/>")
try:
    with graphics.open_renderer(model, 32, 32):
        pass
except graphics.GraphicsUnavailable as error:
    print(error)
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=60)
    assert "libosmesa6" in done.stdout, done.stderr
