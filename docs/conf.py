"""The documentation site: `make docs` builds it, and any warning is an error."""

import tomllib
from pathlib import Path

PROJECT = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text())["project"]

project = PROJECT["name"]
author = "arrive maintainers"
project_copyright = f"2026, {author}"
release = version = PROJECT["version"]

extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
nitpicky = True
myst_heading_anchors = 4
suppress_warnings = ["myst.header"]  # pages are also read on GitHub, where a level may be left out

html_theme = "furo"
html_title = f"{project} {release}"
