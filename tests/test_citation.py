"""CITATION.cff names the version that is packaged."""

import tomllib
from pathlib import Path

import pytest

yaml = pytest.importorskip("yaml", reason="comes with the extra docs")
ROOT = Path(__file__).parent.parent


def test_the_citation_is_of_this_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert (citation["title"], citation["version"], citation["license"]) == (
        project["name"],
        project["version"],
        project["license"],
    )
    assert {"cff-version", "message", "authors"} <= set(citation)
