"""Shared by the scripts that generate pages of the documentation."""

import sys
from pathlib import Path


def write_or_check(pages: dict[Path, str]) -> None:
    """Write the pages. With --check, write nothing and exit with status 1 if one is not up to date."""
    if "--check" in sys.argv:
        sys.exit(any(file.read_text() != text for file, text in pages.items()))
    for file, text in pages.items():
        file.write_text(text)
