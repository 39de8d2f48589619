"""The shipped policies: each comes from its preset, by one command."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from arrive.config import saved_config, to_dict
from arrive.learning.policy import load_policy
from arrive.policies import SHIPPED, shipped_names
from arrive.recipe import make_config
from arrive.report.card import card_text
from arrive.report.records import read_run
from arrive.terrain import parse_families

ROOT = Path(__file__).parents[1]
LARGEST_TREE = 25e6
"""Of all files in git [bytes]: a clone must stay quick."""
OF_THE_MACHINE = {"ppo.precision"}
"""`auto` in a preset: which one it was is the machine's."""
OLDER = {"gap", "joystick", "pit", "slope", "stairs", "walk"}
"""Made by a preset as it was before; a policy that is trained again leaves this list."""


def leaves(data: dict, path: str = "") -> dict:
    found = {}
    for name, value in data.items():
        found |= leaves(value, f"{path}{name}.") if isinstance(value, dict) else {f"{path}{name}": value}
    return found


@pytest.mark.parametrize("name", shipped_names())
def test_a_policys_configuration_is_its_presets_but_for_seed_and_terrain(name):
    path = SHIPPED / name / "config.json"
    found = saved_config(json.loads(path.read_text())["config"], path)
    families = parse_families(",".join(found.terrain.families))
    expected = make_config(families, found.preset, found.task.name, seed=found.seed, robot=found.robot)
    ours, theirs = leaves(to_dict(found)), leaves(to_dict(expected))
    differ = {field for field in ours | theirs if ours.get(field) != theirs.get(field)} - OF_THE_MACHINE
    assert bool(differ) is (name in OLDER), differ


@pytest.mark.parametrize("name", shipped_names())
def test_a_policy_and_its_results_name_the_commit_of_its_record(name):
    """What is exported and measured from now on takes it from the policy."""
    commit = json.loads((SHIPPED / name / "config.json").read_text())["commit"]
    assert load_policy(SHIPPED / name).commit == commit
    results = [path for path in (SHIPPED / name).glob("*.json") if path.name in ("difficulty.json", "reach.json")]
    assert [json.loads(path.read_text())["policy"]["commit"] for path in results] == [commit] * len(results)


@pytest.mark.parametrize("name", shipped_names())
def test_a_policys_card_says_what_its_results_say(name):
    run = read_run(SHIPPED / name)
    card = SHIPPED / name / "card.md"
    assert card.exists() == (run.difficulty is not None or run.reach is not None)
    assert not card.exists() or card.read_text() == card_text(run, with_curves=True)


@pytest.mark.skipif(not (ROOT / ".git").exists() or shutil.which("git") is None, reason="not a git checkout")
def test_the_tree_is_small():
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    files = [ROOT / name.decode() for name in listed.split(b"\0") if name]
    assert len(files) > 100
    assert sum(path.stat().st_size for path in files if path.is_file()) < LARGEST_TREE
