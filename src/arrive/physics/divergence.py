"""The bound for diverged simulations, and silencing MuJoCo's warnings about them."""

import ctypes
from pathlib import Path

import mujoco

MAX_SPEED = 300.0
"""A simulation whose base or joint speed exceeds this has diverged [m/s, rad/s]."""


def silence_mujoco() -> None:
    """Keep MuJoCo from filling a log file and the terminal when a simulation diverges. `read` reports it instead.

    The warning handler must be a C function, because worker threads call it without Python's lock. strlen takes the
    same argument and has no effect.
    """
    library = ctypes.CDLL(str(next(Path(mujoco.__file__).parent.glob("libmujoco*"))))
    handler = ctypes.c_void_p.in_dll(library, "mju_user_warning")
    handler.value = ctypes.cast(ctypes.CDLL(None).strlen, ctypes.c_void_p).value
