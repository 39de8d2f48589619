"""The documentation site builds without warnings or dead links."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parent.parent / "docs"
SOURCE = DOCS.parent / "src" / "arrive"
pytest.importorskip("sphinx", reason="the generator of the site is not installed: pip install -e '.[docs]'")


def build(source: Path, out: Path) -> subprocess.CompletedProcess:
    strict = ["-W", "--keep-going", "-q", "-b", "html", "-c", DOCS]
    command = [sys.executable, "-m", "sphinx", *strict, source, out]
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=300)


def test_the_site_builds_without_a_warning(tmp_path):
    result = build(DOCS, tmp_path)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "index.html").exists()


@pytest.mark.parametrize(("link", "complaint"), [("missing.md", "missing"), ("#nowhere", "nowhere")])
def test_a_link_that_leads_nowhere_is_an_error(tmp_path, link, complaint):
    (tmp_path / "index.md").write_text(f"# A page\n\n[there]({link})\n")
    result = build(tmp_path, tmp_path / "out")
    assert result.returncode != 0
    assert complaint in result.stderr


def test_the_architecture_page_names_every_package_and_only_files_that_exist():
    table = (DOCS / "architecture.md").read_text().split("## The folders")[1]
    named = set()
    for folders, _, files in re.findall(r"^\| (`.+?) \| (.+) \| (`.+`) \|$", table, re.MULTILINE):
        packages = re.findall(r"`(\w+)/`", folders)
        named.update(packages)
        for package, file in zip(packages, re.findall(r"`(\w+\.py)`", files), strict=True):
            assert (SOURCE / package / file).exists(), f"{package}/{file}"
    assert named == {path.parent.name for path in SOURCE.glob("*/__init__.py")}


def test_files_of_this_checkout_that_pages_name_exist():
    """All pages but the diary, which names files of its time."""
    root = DOCS.parent
    pages = [root / "README.md", root / "CONTRIBUTING.md", *root.glob("examples/*.md"), *DOCS.glob("*.md")]
    path = re.compile(r"\b(?:(?:tests|scripts|benchmarks|examples|src)/[\w/]+\.\w+|(?:results|policies)/[\w-]+)")
    named = {(page.name, name) for page in pages if page.stem != "diary" for name in path.findall(page.read_text())}
    assert len(named) > 20
    assert sorted((page, name) for page, name in named if not (root / name).exists()) == []
