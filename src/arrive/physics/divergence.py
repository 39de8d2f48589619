"""When a simulation has left what physics can mean, and how MuJoCo is kept quiet about it."""

import ctypes
from pathlib import Path

import mujoco

MAX_SPEED = 300.0
"""Base or joint speed beyond which a simulation counts as diverged [m/s, rad/s]."""


def silence_mujoco() -> None:
    """Keep MuJoCo from writing a log file and the terminal full when a simulation diverges; `read` reports it.

    Its warning handler must be a C function, for worker threads call it without Python's lock; strlen takes the same
    argument and does nothing.
    """
    library = ctypes.CDLL(next(Path(mujoco.__file__).parent.glob("libmujoco*")))
    handler = ctypes.c_void_p.in_dll(library, "mju_user_warning")
    handler.value = ctypes.cast(ctypes.CDLL(None).strlen, ctypes.c_void_p).value
