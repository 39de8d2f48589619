"""Fixtures for several test files."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from arrive.deployment.export import export_policy
from arrive.learning.policy import load_policy
from arrive.policies import DEFAULT
from arrive.render.graphics import GraphicsUnavailable, graphics_backend


@pytest.fixture(scope="session")
def exported(tmp_path_factory) -> Path:
    """The default policy as a file of `arrive export`."""
    file = tmp_path_factory.mktemp("exported") / "robot.onnx"
    export_policy(load_policy(Path(DEFAULT)), file)
    return file


@pytest.fixture(scope="session", autouse=True)
def _hear_interrupts() -> Iterator[None]:
    """A job in the background ignores Ctrl-C, and so would the programs that tests start."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def hears_hangups() -> Iterator[None]:
    """For a test that closes a terminal: under `nohup`, hangups would be ignored."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture
def graphics_or_skip() -> None:
    """For a test that draws: skips it on a machine that cannot."""
    try:
        graphics_backend()
    except GraphicsUnavailable as missing:
        pytest.skip(str(missing))
