"""Configurations: changed by name, checked, saved and read back."""

import dataclasses
import json

import pytest

from arrive.config import Config, from_dict, override, to_dict
from arrive.errors import ArriveError
from arrive.presets import PRESETS, get_preset


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_survives_the_way_through_json(name):
    config = get_preset(name)
    assert config.preset == name
    text = json.dumps(to_dict(config), allow_nan=False)
    assert from_dict(Config, json.loads(text)) == config


def test_presets_share_nothing_that_can_be_changed():
    """The reward weights are a dict: changing one run's must not change the next one's."""
    for name in PRESETS:
        get_preset(name).task.rewards["task"] = -1.0
        assert get_preset(name).task.rewards["task"] > 0


@pytest.mark.parametrize(
    ("assignment", "read", "value"),
    [
        ("num_envs=7", lambda c: c.num_envs, 7),
        ("ppo.gamma=0.5", lambda c: c.ppo.gamma, 0.5),
        ("ppo.gamma=1", lambda c: c.ppo.gamma, 1.0),  # a whole number where a float belongs
        (" ppo.lam = 0.25", lambda c: c.ppo.lam, 0.25),
        ("ppo.learning_rate=3e-4", lambda c: c.ppo.learning_rate, 3e-4),
        ("ppo.hidden=[32]", lambda c: c.ppo.hidden, (32,)),
        ("ppo.symmetry=true", lambda c: c.ppo.symmetry, True),
        ("ppo.symmetry=True", lambda c: c.ppo.symmetry, True),
        ("observation.noise=false", lambda c: c.observation.noise, False),
        ("randomisation.friction=[1, 2]", lambda c: c.randomisation.friction, (1.0, 2.0)),
        ("physics.motor=ideal", lambda c: c.physics.motor, "ideal"),
        ('terrain.families=["pit", "gap"]', lambda c: c.terrain.families, ("pit", "gap")),
        ("task.rewards.stall_cost=-2", lambda c: c.task.rewards["stall_cost"], -2.0),
        ("task.rewards.pose_cost=-0.5", lambda c: c.task.rewards["pose_cost"], -0.5),  # new in this preset
    ],
)
def test_an_assignment_changes_its_field_and_no_other(assignment, read, value):
    before = get_preset("paper")
    after = override(before, (assignment,))
    assert read(after) == value
    assert type(read(after)) is type(value)
    if isinstance(value, tuple):
        assert [type(entry) for entry in read(after)] == [type(entry) for entry in value]
    old, new = _leaves(to_dict(before)), _leaves(to_dict(after))
    changed = {path for path in old | new if old.get(path) != new.get(path)}
    assert changed == {assignment.partition("=")[0].strip()}
    assert before == get_preset("paper")


def _leaves(data: dict, path: str = "") -> dict:
    leaves = {}
    for name, value in data.items():
        leaves |= _leaves(value, f"{path}{name}.") if isinstance(value, dict) else {f"{path}{name}": value}
    return leaves


def test_the_last_of_several_assignments_wins():
    assert override(get_preset("paper"), ("seed=2", "ppo.clip=0.1", "seed=3")).seed == 3


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("ppo.gama=0.5", ["gama", "Did you mean 'gamma'", "entropy", "learning_rate", "symmetry"]),
        ("pppo.gamma=0.5", ["pppo", "Did you mean 'ppo'", "terrain", "randomisation"]),
        ("num_robots=5", ["num_robots", "num_envs", "seed"]),
        ("ppo.gamma.x=1", ["ppo.gamma.x", "gamma"]),
        ("ppo.gamma", ["PATH=VALUE"]),
        ("=3", ["unknown field"]),
        ("ppo.gamma=high", ["ppo.gamma", "float", "'high'"]),
        ("ppo.gamma=true", ["ppo.gamma", "float"]),
        ("num_envs=1.5", ["num_envs", "int", "1.5"]),
        ("num_envs=true", ["num_envs", "int"]),
        ("num_envs=null", ["num_envs", "int"]),
        ("ppo.symmetry=1", ["ppo.symmetry", "bool"]),
        ("ppo.hidden=128", ["ppo.hidden", "list"]),
        ("ppo.hidden=[1.5]", ["ppo.hidden", "int"]),
        ("randomisation.friction=[1]", ["randomisation.friction", "2 entries"]),
        ("randomisation.friction=[1, true]", ["randomisation.friction", "float"]),
        ("physics.motor=steam", ["physics.motor", "steam", "dc", "ideal"]),
        ("task.rewards.task=big", ["task.rewards.task", "float"]),
    ],
)
def test_a_wrong_assignment_says_what_would_be_right(assignment, words):
    with pytest.raises(ArriveError) as error:
        override(get_preset("paper"), (assignment,))
    for word in words:
        assert word in str(error.value)


def test_a_share_of_the_robots_is_set_by_its_familys_name():
    assert override(get_preset("paper"), ("terrain.shares.gap=3",)).terrain.shares == {"gap": 3.0}


def test_a_saved_field_that_no_longer_exists_is_named():
    data = to_dict(get_preset("paper"))
    data["ppo"]["momentum"] = 0.9
    with pytest.raises(ArriveError, match=r"ppo\.momentum.*Valid:.*gamma"):
        from_dict(Config, data)


def test_a_saved_value_of_the_wrong_type_is_named():
    data = to_dict(get_preset("paper"))
    data["task"]["episode_s"] = "long"
    with pytest.raises(ArriveError, match=r"task\.episode_s must be float"):
        from_dict(Config, data)


def test_a_field_that_an_older_run_lacks_gets_its_default():
    data = to_dict(get_preset("paper"))
    del data["ppo"]["clip"]
    assert from_dict(Config, data).ppo.clip == Config().ppo.clip


def test_an_unknown_preset_lists_the_known_ones():
    with pytest.raises(ArriveError) as error:
        get_preset("papr")
    assert all(name in str(error.value) for name in PRESETS)


def test_a_configuration_cannot_be_changed_in_place():
    with pytest.raises(dataclasses.FrozenInstanceError):
        get_preset("paper").ppo.gamma = 0.5
