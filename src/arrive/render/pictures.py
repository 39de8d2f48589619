"""Pictures and films of an episode, drawn offscreen by MuJoCo's renderer."""

import copy
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import imageio.v2 as imageio
import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from arrive.evaluation.episode import Episode
from arrive.files import whole
from arrive.render.graphics import open_renderer

FRAME_SIZE = (400, 320)
"""Width and height of one frame of a strip [pixels]."""
FILM_SIZE = (768, 432)
"""Width and height of a film [pixels]."""
DOT_SPACING = 0.1
"""Distance between the dots of the path walked [m]."""
MARGIN = 0.7
"""Free space around the path and the target [m]."""
FARTHEST_VIEW = 4.2
"""Largest distance of the camera from the point that it looks at. It follows the robot along longer paths [m]."""
AHEAD = 0.5
"""The camera looks at a point this far in front of the robot [m]."""
VIEWS_DEG = tuple((side, down) for down in (-22.0, -35.0, -50.0) for side in (52.0, -52.0, 28.0, -28.0))
"""Azimuth relative to the direction of the target, and elevation. The first view in which the ground hides the robot
least is taken."""
SUN = np.array([0.45, 0.35, -1.0]) / np.linalg.norm([0.45, 0.35, -1.0])
"""Direction of the sunlight."""
SHADOWED_M = 8.0
"""Smallest half edge of the area with shadows. In a smaller one, level ground gets speckles from its own shadow [m]."""
SMOOTH_S = 1.0
"""The camera follows the robot's mean position over this time, so that it does not shake with every step [s]."""
SKY = (0.80, 0.87, 0.94)
TARGET_COLOR = (0.10, 0.75, 0.25)
PATH_COLOR = (0.95, 0.45, 0.05)


def picture_strip(episode: Episode, path: Path, frames: int = 6) -> None:
    """Write a PNG with evenly spaced moments of the episode side by side, and the time below each.

    Raises:
        GraphicsUnavailable: this machine cannot draw.
    """
    width, height = FRAME_SIZE
    top, bottom, gap = 34, 28, 4
    strip = Image.new("RGB", (frames * (width + gap) - gap, top + height + bottom), "white")
    draw = ImageDraw.Draw(strip)
    draw.text((8, 7), f"{episode.caption}: {episode.outcome}", "black", ImageFont.load_default(18))
    steps = np.linspace(0, len(episode.qpos) - 1, frames).round().astype(int)
    with open_stage(episode, *FRAME_SIZE) as stage:
        for place, step in enumerate(steps):
            left = place * (width + gap)
            strip.paste(Image.fromarray(stage.draw(step)), (left, top))
            stamp = f"{step * episode.control_dt:.1f} s"
            middle = (left + width // 2, top + height + bottom // 2)
            draw.text(middle, stamp, "black", ImageFont.load_default(16), anchor="mm")
    with whole(path) as file:
        strip.save(file, format="PNG")


def film(episode: Episode, path: Path, fps: int = 25) -> None:
    """Write an MP4 (H.264) of the episode in real time.

    Raises:
        GraphicsUnavailable: this machine cannot draw.
    """
    duration_s = (len(episode.qpos) - 1) * episode.control_dt
    font = ImageFont.load_default(18)
    with whole(path) as file, open_stage(episode, *FILM_SIZE) as stage:
        writer = imageio.get_writer(
            file,
            format="FFMPEG",
            fps=fps,
            codec="libx264",
            pixelformat="yuv420p",
            macro_block_size=2,
            output_params=["-preset", "veryfast"],
        )
        with writer:
            for frame in range(int(duration_s * fps) + 1):
                image = Image.fromarray(stage.draw(episode.index_at(frame / fps)))
                ended = frame == int(duration_s * fps)
                label = f"{episode.caption}: {episode.outcome}" if ended else episode.caption
                ImageDraw.Draw(image).text((12, 10), f"{label}   {frame / fps:.1f} s", "black", font)
                writer.append_data(np.asarray(image))


@contextmanager
def open_stage(episode: Episode, width: int, height: int) -> Iterator["Stage"]:
    """A stage that draws moments of an episode in pictures of this size [pixels], closed at the end.

    Raises:
        GraphicsUnavailable: this machine cannot draw.
    """
    model = copy.copy(episode.model)
    _set_look(model, episode)
    with open_renderer(model, width, height) as renderer:
        yield Stage(episode, model, renderer)


class LiveStage:
    """Draws the newest moment of running episodes, all in one world."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int):
        """The renderer is opened at the first picture.

        Args:
            model: the world, with its visual shapes.
        """
        self.model = copy.copy(model)
        self._size, self._open = (width, height), ExitStack()
        self._renderer: mujoco.Renderer | None = None

    def draw(self, episode: Episode) -> np.ndarray:
        """(height, width, 3) picture of the last row of an episode's `qpos`, 8 bits per colour.

        Raises:
            GraphicsUnavailable: this machine cannot draw.
        """
        _set_look(self.model, episode)
        if self._renderer is None:
            # The renderer keeps the shadow size and the number of samples that the model has when it is opened.
            self._renderer = self._open.enter_context(open_renderer(self.model, *self._size))
        return Stage(episode, self.model, self._renderer).draw(len(episode.qpos) - 1)

    def close(self) -> None:
        """Close the renderer."""
        self._open.close()


class Stage:
    """Draws moments of an episode, with light, camera, target and path."""

    def __init__(self, episode: Episode, model: mujoco.MjModel, renderer: mujoco.Renderer):
        self._episode, self._model, self._renderer = episode, model, renderer
        self._data = mujoco.MjData(model)
        self._options = mujoco.MjvOption()
        self._options.geomgroup[:] = (1, 0, 1, 0, 0, 0)
        if not (model.geom_group == 2).any():
            self._options.geomgroup[3] = 1
        self._aspect = renderer.width / renderer.height
        steps = np.linalg.norm(np.diff(episode.qpos[:, :2], axis=0), axis=1)
        self._walked = np.concatenate([[0.0], np.cumsum(steps)])
        self._cameras = _Cameras(episode, self._aspect, model.vis.global_.fovy)
        places = np.vstack([episode.qpos[:, :3], episode.target_w])
        self._middle = (places.min(0) + places.max(0)) / 2

    def draw(self, step: int) -> np.ndarray:
        """(height, width, 3) picture of a row of `qpos`, 8 bits per colour."""
        self._data.qpos[:] = self._episode.qpos[step]
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        camera = self._cameras.at(step)
        self._renderer.update_scene(self._data, camera, self._options)
        self._mark_target()
        self._mark_path(step)
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
        _add_sun(self._renderer.scene, self._middle)
        _add_sky(self._renderer.scene, camera)
        return self._renderer.render()

    def _mark_target(self) -> None:
        ground = self._episode.ground_path_w[-1] + np.array([0.0, 0.0, 0.04])
        scene, target = self._renderer.scene, np.asarray(self._episode.target_w)
        disc, color = (self._episode.target_radius, 0.02, 0), (*TARGET_COLOR, 0.25)
        _add_geom(scene, mujoco.mjtGeom.mjGEOM_CYLINDER, disc, ground, color, emission=0.4)
        _add_geom(scene, mujoco.mjtGeom.mjGEOM_SPHERE, (0.1, 0, 0), target, (*TARGET_COLOR, 0.6))

    def _mark_path(self, step: int) -> None:
        marks = np.arange(0.0, self._walked[step], DOT_SPACING)
        for place in np.searchsorted(self._walked, marks):
            point = self._episode.ground_path_w[place] + np.array([0.0, 0.0, 0.02])
            _add_geom(self._renderer.scene, mujoco.mjtGeom.mjGEOM_SPHERE, (0.022, 0, 0), point, (*PATH_COLOR, 1.0))


def _set_look(model: mujoco.MjModel, episode: Episode) -> None:
    """Soft light, haze towards the sky, and clipping planes for a scene of a few metres."""
    model.vis.headlight.active = 1
    model.vis.headlight.ambient[:] = 0.45
    model.vis.headlight.diffuse[:] = 0.25
    model.vis.headlight.specular[:] = 0.0
    model.vis.rgba.fog[:] = (*SKY, 1.0)
    model.vis.quality.shadowsize = 4096
    model.vis.quality.offsamples = 4
    model.stat.extent = 1.0  # makes the lengths below metres
    reach = float(np.ptp(np.vstack([episode.qpos[:, :3], episode.target_w]), axis=0).max()) + 2 * MARGIN
    model.vis.map.znear, model.vis.map.zfar = 0.05, 100.0
    model.vis.map.fogstart, model.vis.map.fogend = 3 * reach, 8 * reach + 10
    model.vis.map.shadowclip = max(SHADOWED_M, reach)


class _Cameras:
    """The camera at each step. It follows the robot smoothly, from the side where the ground hides it least."""

    def __init__(self, episode: Episode, aspect: float, fovy_deg: float):
        base = episode.qpos[:, :3]
        self._places, target = np.vstack([base, episode.target_w]), np.asarray(episode.target_w)
        way = target[:2] - base[0, :2]
        self._heading = np.degrees(np.arctan2(way[1], way[0]))
        ahead = AHEAD * np.array([*way, 0.0]) / max(float(np.hypot(*way)), 1e-6)
        self._looked_at = _smoothed(base + ahead, SMOOTH_S / episode.control_dt)
        tangent = np.tan(np.radians(fovy_deg) / 2)
        self._tangents = tangent * aspect, tangent
        hidden = {view: _hidden_share(episode, self._positions(view)) for view in VIEWS_DEG}
        self._view = min(VIEWS_DEG, key=hidden.__getitem__)

    def at(self, step: int) -> mujoco.MjvCamera:
        """The camera at a row of `qpos`."""
        return self._camera(self._view, step)

    def _camera(self, view: tuple[float, float], step: int) -> mujoco.MjvCamera:
        camera = mujoco.MjvCamera()
        camera.azimuth, camera.elevation = self._heading + view[0], view[1]
        camera.lookat[:] = self._looked_at[step]
        camera.distance = min(
            _fit_distance(self._places - camera.lookat, _axes(camera), *self._tangents), FARTHEST_VIEW
        )
        return camera

    def _positions(self, view: tuple[float, float]) -> np.ndarray:
        """(steps, 3) positions of the camera [m]."""
        cameras = [self._camera(view, step) for step in range(len(self._looked_at))]
        return np.array([camera.lookat - camera.distance * _axes(camera)[0] for camera in cameras])


def _smoothed(path: np.ndarray, steps: float) -> np.ndarray:
    """(n, 3) moving average of a path over this number of steps; its ends are repeated."""
    half = max(round(steps / 2), 1)
    padded = np.pad(path, ((half, half), (0, 0)), mode="edge")
    window = np.ones(2 * half + 1) / (2 * half + 1)
    return np.column_stack([np.convolve(column, window, "valid") for column in padded.T])


def _hidden_share(episode: Episode, cameras: np.ndarray, samples: int = 25) -> float:
    """Share of the steps at which the ground is between camera and robot."""
    data = mujoco.MjData(episode.model)
    groups, hidden = np.array([1, 0, 0, 0, 0, 0], np.uint8), 0
    mujoco.mj_kinematics(episode.model, data)
    steps = np.linspace(0, len(cameras) - 1, samples).round().astype(int)
    for start, base in zip(cameras[steps], episode.qpos[steps, :3], strict=True):
        way = base - start
        length = float(np.linalg.norm(way))
        distance = mujoco.mj_ray(episode.model, data, start, way / length, groups, 1, -1, None)
        hidden += 0.0 <= distance < length
    return hidden / samples


def _axes(camera: mujoco.MjvCamera) -> np.ndarray:
    """(3, 3) rows: the camera's forward, right and up directions in the world."""
    azimuth, elevation = np.radians([camera.azimuth, camera.elevation])
    forward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    return np.stack([forward, right, np.cross(right, forward)])


def _fit_distance(points: np.ndarray, axes: np.ndarray, tan_right: float, tan_up: float) -> float:
    """Smallest distance from the look-at point at which all points are in view with MARGIN around them [m]."""
    forward, right, up = axes @ points.T
    return float(np.max(np.maximum((np.abs(right) + MARGIN) / tan_right, (np.abs(up) + MARGIN) / tan_up) - forward))


def _add_sun(scene: mujoco.MjvScene, middle: np.ndarray) -> None:
    """A light that casts shadows. It is fixed to the world, because shadows flicker if it moves with the camera."""
    if scene.nlight >= len(scene.lights):
        return
    sun = scene.lights[scene.nlight]
    sun.type, sun.castshadow, sun.headlight = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, 1, 0
    sun.dir[:] = SUN
    sun.pos[:] = middle - 20 * SUN
    sun.ambient[:], sun.diffuse[:], sun.specular[:] = 0.0, 0.6, 0.1
    scene.nlight += 1


def _add_sky(scene: mujoco.MjvScene, camera: mujoco.MjvCamera) -> None:
    """A luminous wall behind everything, because the model has no sky."""
    forward, right, up = _axes(camera)
    position = camera.lookat + 60.0 * forward
    frame = np.column_stack([right, up, -forward])
    _add_geom(scene, mujoco.mjtGeom.mjGEOM_BOX, (100, 100, 0.1), position, (*SKY, 1.0), frame, emission=1.0)


def _add_geom(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    size: tuple[float, float, float],
    position: np.ndarray,
    rgba: tuple[float, float, float, float],
    frame: np.ndarray | None = None,
    emission: float = 0.0,
) -> None:
    """Add a decoration, if the scene has room for it."""
    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    frame = np.eye(3) if frame is None else frame
    mujoco.mjv_initGeom(
        geom, kind, np.array(size, float), np.array(position, float), frame.ravel(), np.array(rgba, np.float32)
    )
    geom.emission = emission
    scene.ngeom += 1
