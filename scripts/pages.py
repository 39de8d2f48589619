"""What the scripts that make pages of the documentation share."""

import sys
from pathlib import Path


def write_or_check(file: Path, text: str) -> None:
    """Write the page; with --check leave it, and exit with status 1 where it is not up to date."""
    if "--check" in sys.argv:
        sys.exit(file.read_text() != text)
    file.write_text(text)
