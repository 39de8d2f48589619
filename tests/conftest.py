"""What several test files need."""

from pathlib import Path

import pytest

from arrive.deployment.export import export_policy
from arrive.learning.policy import load_policy
from arrive.policies import DEFAULT


@pytest.fixture(scope="session")
def exported(tmp_path_factory) -> Path:
    """The default policy as a file of `arrive export`."""
    file = tmp_path_factory.mktemp("exported") / "robot.onnx"
    export_policy(load_policy(Path(DEFAULT)), file)
    return file
