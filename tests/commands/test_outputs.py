"""Files that commands write are checked before the work: they can be written, and replace no other by accident."""

from dataclasses import fields
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from arrive import cli
from arrive.commands.limits import Suffix
from arrive.policies import SHIPPED, find_policy, results_folder

WORDS = {
    ("Bench", "json"): "bench nowhere --json",
    ("Drive", "log"): "drive nowhere --log",
    ("Energy", "json"): "energy nowhere --json",
    ("Eval", "json"): "eval nowhere --json",
    ("Export", "out"): "export nowhere -o",
    ("Fit", "out"): "actuator fit nowhere.npz -o",
    ("Gait", "json"): "gait nowhere --json",
    ("Import", "out"): "actuator import nowhere.npz -o",
    ("Record", "out"): "actuator record --period-s 0.0003 -o",
    ("Report", "out"): "report nowhere -o",
    ("Show", "out"): "actuator show nowhere.safetensors -o",
    ("Showreel", "out"): "showreel nowhere -o",
}
"""A command for each option that names a file to write. The work itself fails at once, with another message."""


def outputs(hint) -> dict[tuple[str, str], Suffix]:
    """All such options of a command, of its subcommands, or of a choice of commands."""
    if not (isinstance(hint, type) and hint.__module__.startswith("arrive.commands")):
        return {key: suffix for part in get_args(hint) for key, suffix in outputs(part).items()}
    hints, found = get_type_hints(hint, include_extras=True), {}
    for field in fields(hint):
        suffix = next((part for part in get_args(hints[field.name]) if isinstance(part, Suffix)), None)
        found |= {(hint.__name__, field.name): suffix} if suffix else outputs(hints[field.name])
    return found


OUTPUTS = outputs(cli.AnyCommand)


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def refused(capsys, words: str) -> str:
    with pytest.raises(SystemExit) as stopped:
        cli.main(words.split())
    err = capsys.readouterr().err
    assert stopped.value.code == 1, err
    assert err.count("\n") == 1
    return err


def test_every_option_that_names_a_file_is_tried():
    assert set(OUTPUTS) == set(WORDS)


@pytest.mark.parametrize("option", WORDS, ids=" ".join)
def test_a_file_that_cannot_be_written_is_told_before_the_work(capsys, option):
    Path("file").write_text("not a folder")
    out = Path("file") / f"out{OUTPUTS[option].suffixes[0]}"
    assert f"cannot write {Path.cwd() / out}: Not a directory" in refused(capsys, f"{WORDS[option]} {out}")
    folder = Path(f"folder{OUTPUTS[option].suffixes[0]}")
    folder.mkdir()
    assert "it is a folder" in refused(capsys, f"{WORDS[option]} {folder}")
    assert sorted(path.name for path in Path().iterdir()) == ["file", folder.name], "nothing else is there"


@pytest.mark.parametrize("option", WORDS, ids=" ".join)
def test_a_file_that_exists_is_kept_unless_forced(capsys, option):
    """But for results of measurements, whose commands replace shorter ones of their own; see test_reach.py."""
    suffix = OUTPUTS[option]
    for path in suffix.files(Path("new") / f"out{suffix.suffixes[0]}"):
        if path.suffix == ".json":
            continue
        path.parent.mkdir()
        path.write_text("mine")
        words = f"{WORDS[option]} {path.with_suffix(suffix.suffixes[0])}"
        assert f"{path} exists; give --force to replace it, or name another file" in refused(capsys, words)
        assert "exists" not in refused(capsys, f"{words} --force")
        assert path.read_text() == "mine"
        path.unlink()
        path.parent.rmdir()


@pytest.mark.parametrize("protocol", ["arrival", "difficulty"])
def test_a_folder_of_pictures_that_cannot_be_written_is_told_before_the_work(capsys, protocol):
    Path("file").write_text("not a folder")
    options = f"--protocol {protocol} --json out.json --threads 1 --terrain flat --pictures file"
    assert "cannot write" in refused(capsys, f"eval walk {options}")
    assert not Path("out.json").exists()


def test_measuring_a_shipped_policy_by_its_name_changes_no_tracked_file():
    """By its path it is asked for, as by whoever maintains it."""
    assert results_folder(find_policy("gap") / "policy.pt") == Path("runs/shipped/gap")
    link = Path("policies")
    link.symlink_to(SHIPPED)
    assert results_folder(find_policy("policies/gap") / "policy.pt") == Path("policies/gap")


def test_a_picture_is_replaced_with_its_result_alone(capsys):
    Path("energy.json").write_text('{"protocol": {"name": "energy"}}')
    Path("energy.png").write_text("of an earlier measurement")
    assert "there is no policy 'nowhere'" in refused(capsys, "energy nowhere")
    Path("energy.json").unlink()
    assert "energy.png exists" in refused(capsys, "energy nowhere")
