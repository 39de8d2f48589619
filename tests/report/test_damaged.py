"""Reports of damaged results: an error of one line, or a page. Texts from files are never HTML."""

import contextlib
import json
import random
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

from arrive.config import Config, to_dict
from arrive.errors import ArriveError, shown
from arrive.learning.logs import read_log
from arrive.learning.rundir import read_config
from arrive.report.card import card_text
from arrive.report.records import Run, read_run
from arrive.report.text import markdown
from arrive.report.write import write_report
from arrive.results.read import read_result
from small_results import RESULTS, damages, marked, refusal

MARK = "<script>alert(1)</script><img src=x onerror=alert(1)>\"'&$x_{$\x00\ud800"
RECORD = {
    "config": to_dict(Config()),
    "commit": "abc",
    "command": "arrive train gap",
    "seed": 1,
    "samples_before": 0,
    "imports": {},
}
LOG = "iteration,progress/samples,progress/elapsed_s,arrival/all,level/gap\n1,100.0,1.0,nan,0.0\n2,200.0,2.0,0.5,1.0\n"
PAGES = 3
OPTIONS = {"energy": "energy", "gait": "gait", "stability": "stability", "window": "time_window"}
"""Name of each option's format."""


def write_run(run_folder: Path, mark: str = "", **results) -> Run:
    """A measured run."""
    contents = {kind: results.get(kind, make()) for kind, make in RESULTS.items()}
    run_folder.mkdir(exist_ok=True)
    (run_folder / "config.json").write_text(json.dumps(results.get("record", RECORD)))
    (run_folder / "log.csv").write_text(LOG)
    for kind in ("difficulty", "reach"):
        (run_folder / f"{kind}.json").write_text(json.dumps(marked(contents[kind], mark)))
    return read_run(run_folder)


def report(folder: Path, run: str = "run", mark: str = "", **results) -> str:
    """The page of one run with all results."""
    read = write_run(folder / run, mark, **results)
    contents = {kind: results.get(kind, make()) for kind, make in RESULTS.items()}
    files = {option: folder / f"{kind}.json" for option, kind in OPTIONS.items()}
    for option, kind in OPTIONS.items():
        files[option].write_text(json.dumps(marked(contents[kind], mark)))
    assert card_text(read, with_curves=False)
    page, data = write_report([read], folder / "page.html", files)
    assert json.loads(data.read_text())["runs"][0]["difficulty"]["protocol"]["name"] == "difficulty"
    return page.read_text()


class Tags(HTMLParser):
    """Collects tags and attributes of a page."""

    def __init__(self, text: str):
        super().__init__()
        self.found: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.found |= {tag, *(name for name, _ in attributes)}


def test_texts_from_files_stay_texts(tmp_path):
    """In names of runs, policies, gaits, feet, variants, commands, commits and notes, on the page and in its charts."""
    assert Tags("<p onerror=x><script>").found == {"p", "onerror", "script"}
    clean = report(tmp_path)
    record = RECORD | {"commit": MARK, "command": f"arrive {MARK}"}
    page = report(tmp_path, "<script>$\"'&", MARK, record=record | {"config": RECORD["config"] | {"preset": MARK}})
    assert Tags(page).found == Tags(clean).found
    assert "<script" not in page
    assert page.count("&lt;script&gt;alert(1)") > 30


def rendered(text: str) -> tuple[list[str], str]:
    """Tags and attributes of a card on a page, and the texts in it."""
    page = Words(MarkdownIt("commonmark").enable(["table", "strikethrough"]).render(text))
    return sorted(page.found), page.text


class Words(Tags):
    """Collects the texts too."""

    text = ""

    def handle_data(self, data):
        self.text += data


@pytest.mark.parametrize(
    "mark",
    [
        MARK,
        "[x](http://evil)",
        "![x](http://evil/x.png)",
        "| a | b |",
        "``` \n# x\n```\n",
        "*a* __b__ ~~c~~ `d` _e_",
        "\n\n# x\n- y\n",
        "<http://evil> http://evil www.evil.org a@evil.org",
        "\\",
        "&lt;b&gt; &#42;",
        "`",
        "#",
    ],
)
def test_texts_from_files_stay_texts_on_a_card(tmp_path, mark):
    """In the run's name, its command, commit and preset, in results and in the names of failures."""
    clean = rendered(card_text(write_run(tmp_path / "clean"), with_curves=False))
    record = RECORD | {"commit": mark, "command": f"arrive {mark}", "config": RECORD["config"] | {"preset": mark}}
    run = replace(write_run(tmp_path / "run", mark, record=record), name=shown(mark))
    run.difficulty["families"]["gap"]["levels"][0]["failures"][mark] = 1
    tags, words = rendered(card_text(run, with_curves=False))
    assert tags == clean[0]
    text = " ".join(shown(mark).split())
    assert " ".join(words.split()).count(text) >= 8


def test_a_card_of_plain_texts_has_no_escapes(tmp_path):
    assert "\\" not in card_text(replace(write_run(tmp_path / "run"), name="wide_gap-2.1"), with_curves=False)


def test_addresses_become_no_links():
    """GitHub makes links of addresses without any markup."""
    assert markdown("http://evil HTTPS://evil www.evil.org a@evil.org") == (
        r"http\://evil HTTPS\://evil www\.evil.org a\@evil.org"
    )


def test_accepted_damaged_results_give_a_page(tmp_path):
    """Each of them has one damage in every result."""
    rng = random.Random(24)
    for _ in range(PAGES):
        report(tmp_path, **{kind: taken(kind, rng, tmp_path / "one.json") for kind in RESULTS})


def taken(kind: str, rng: random.Random, path: Path) -> dict:
    """A damaged result that the reader takes."""
    while True:
        ((_, _, damage),) = damages(RESULTS[kind](), 1, rng.randrange(2**32))
        path.write_text(json.dumps(damage))
        with contextlib.suppress(ArriveError):
            return read_result(path, kind)


def test_damaged_records_are_refused_or_read_correctly(tmp_path):
    path, refused = tmp_path / "config.json", 0
    for place, _, damage in damages(RECORD, 400):
        path.write_text(json.dumps(damage))
        message = refusal(lambda: read_config(tmp_path))
        refused += message is not None
        if message is None:
            config, record = read_config(tmp_path)
            assert record["config"] == to_dict(config)
        else:
            assert str(path) in message, place
    assert refused > 200


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("progress/samples", "progress/sample", "has no column progress/samples"),
        ("progress/elapsed_s", "time", "has no column progress/elapsed_s"),
        ("200.0", "nan", "line 3: progress/samples must be a number from 0 to 1e"),
        ("200.0", "", "line 3: progress/samples must be a number from 0 to 1e"),
        ("100.0", "-1", "line 2: progress/samples must be a number from 0 to 1e"),
        ("2.0,0.5", "inf,0.5", "line 3: progress/elapsed_s must be a number from 0 to 1e"),
        ("0.5", "1e300", "line 3: arrival/all must be a number, not '1e300'"),
        ("200.0", "2_00", "line 3: progress/samples must be a number, not '2_00'"),
        ("0.5", "[1]", r"line 3: arrival/all must be a number, not '\[1\]'"),
        ("0.5", "0.5,1", "line 3: it has 6 values"),
        ("2,200", "0,200", "line 3: iteration 0 does not come after 1"),
    ],
)
def test_a_damaged_log_is_refused_with_its_line(tmp_path, before, after, words):
    (tmp_path / "log.csv").write_text(LOG)
    assert read_log(tmp_path)["progress/samples"] == [100.0, 200.0]
    (tmp_path / "log.csv").write_text(LOG.replace(before, after, 1))
    with pytest.raises(ArriveError, match=words):
        read_log(tmp_path)


def test_a_damaged_picture_is_named(tmp_path):
    report(tmp_path)
    picture = tmp_path / "run" / "pictures" / "difficulty" / "gap.png"
    picture.parent.mkdir(parents=True)
    picture.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(50))
    with pytest.raises(ArriveError, match=r"cannot read the picture .*gap.png"):
        write_report([read_run(tmp_path / "run")], tmp_path / "page.html", {})


def test_an_unknown_terrain_names_the_file(tmp_path):
    content = RESULTS["difficulty"]()
    content["families"]["moat"] = content["families"]["gap"]
    with pytest.raises(ArriveError, match=r"cannot read .*difficulty.json: unknown terrain 'moat'"):
        report(tmp_path, difficulty=content)
