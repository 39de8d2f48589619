"""Finds a graphics library that can draw without a screen."""

import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

import mujoco

from arrive.errors import ArriveError

_PROBE = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 32, 32) as renderer:
    renderer.update_scene(data)
    assert renderer.render().any()
"""


class GraphicsUnavailable(ArriveError):
    """No library on this machine can draw without a screen. Everything except pictures works."""

    def __init__(self) -> None:
        super().__init__(
            "no pictures: no offscreen graphics library works here; install the Debian package libosmesa6 "
            "(software), or libegl1 and libopengl0 (a graphics driver), and the Python extra mujoco-core[rendering]"
        )


@lru_cache(maxsize=1)
def graphics_backend() -> str:
    """The value of MUJOCO_GL with which MuJoCo can draw offscreen here: the one that is set, otherwise EGL or OSMesa.

    Each candidate is tested in a process of its own, because a broken driver can crash the process.

    Raises:
        GraphicsUnavailable: none of them works.
    """
    fallback = ("egl", "osmesa") if sys.platform == "linux" else ("",)
    chosen = os.environ.get("MUJOCO_GL")
    for backend in (chosen,) if chosen else fallback:
        environment = os.environ | {"MUJOCO_GL": backend}
        try:
            done = subprocess.run([sys.executable, "-c", _PROBE], env=environment, capture_output=True, timeout=60)
        except (OSError, subprocess.TimeoutExpired):
            continue
        if done.returncode == 0:
            return backend
    raise GraphicsUnavailable


@contextmanager
def open_renderer(model: mujoco.MjModel, width: int, height: int) -> Iterator[mujoco.Renderer]:
    """A renderer for pictures of this size [pixels], closed at the end. It may enlarge the model's offscreen buffer.

    Raises:
        GraphicsUnavailable: this machine cannot draw.
    """
    os.environ["MUJOCO_GL"] = graphics_backend()
    # MuJoCo chose its graphics library when it was first imported, before MUJOCO_GL was known.
    importlib.reload(mujoco.rendering.classic.gl_context)
    model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
    model.vis.global_.offheight = max(height, model.vis.global_.offheight)
    try:
        renderer = mujoco.Renderer(model, height, width)
    except (ImportError, RuntimeError, mujoco.FatalError) as error:
        raise GraphicsUnavailable from error
    with renderer:
        yield renderer
