"""Configurations: changed by name, checked, saved and read back."""

import dataclasses
import json
import math
import random
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, get_args

import pytest

from arrive.config import Config, check_config, from_dict, override, to_dict
from arrive.errors import ArriveError
from arrive.fields import hints_of, is_interval, rows, split_range
from arrive.presets import PRESETS, get_preset, robust
from arrive.recipe import make_config
from arrive.task.registry import TASKS, get_task
from arrive.terrain import parse_families


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_unchanged_by_json(name):
    config = get_preset(name)
    assert config.preset == name
    text = json.dumps(to_dict(config), allow_nan=False)
    assert from_dict(Config, json.loads(text)) == config


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
        ("task.rewards.stall_cost.weight=-2", lambda c: c.task.rewards.stall_cost.weight, -2.0),
        ("task.rewards.approach.radius=0.1", lambda c: c.task.rewards.approach.radius, 0.1),
        ("observation.heights.noise=0", lambda c: c.observation.heights.noise, 0.0),
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


@pytest.mark.parametrize(
    ("short", "whole"),
    [
        ("task.rewards.approach=3", "task.rewards.approach.weight=3"),
        ("task.rewards.stall_cost=-2", "task.rewards.stall_cost.weight=-2"),
        ("observation.heights=0.2", "observation.heights.noise=0.2"),
        ("observation.gravity=0", "observation.gravity.noise=0"),
    ],
)
def test_a_number_alone_is_a_terms_weight_or_noise_and_keeps_its_other_parameters(short, whole):
    assert override(robust(), (short,)) == override(robust(), (whole,)) != robust()


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
        ("task.rewards.tusk=1", ["no 'tusk'", "Did you mean 'task'"]),
        ("observation.noise_heights=0", ["Did you mean observation.heights.noise?"]),
        ("observation.grid_step=0.2", ["Did you mean observation.heights.step?"]),
        ("task.approach_radius=0.2", ["Did you mean task.rewards.approach.radius?"]),
        ("episode_s=3", ["Did you mean task.episode_s?"]),
    ],
)
def test_a_wrong_assignment_says_what_would_be_right(assignment, words):
    with pytest.raises(ArriveError) as error:
        override(get_preset("paper"), (assignment,))
    for word in words:
        assert word in str(error.value)


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


# Ranges.

TASKS_OF = {name: lambda name=name: replace(robust(), task=get_task(name).from_preset(robust().task)) for name in TASKS}
CONFIGS = PRESETS | TASKS_OF


@pytest.mark.parametrize("name", CONFIGS)
def test_every_preset_and_task_is_within_its_ranges(name):
    check_config(CONFIGS[name]())


def fields_of(config, where: str = "") -> Iterator[tuple[str, Any]]:
    """Path and type of every number, and of every list of numbers."""
    for name, hint in hints_of(type(config)).items():
        value = getattr(config, name)
        first = value[0] if isinstance(value, tuple) else value
        if dataclasses.is_dataclass(value):
            yield from fields_of(value, f"{where}{name}.")
        elif isinstance(first, float | int) and not isinstance(first, bool):
            yield f"{where}{name}", hint


def outside(hint: Any, rng: random.Random) -> Iterator[Any]:
    """Values from outside the range of a field: NaN, infinities, and numbers beyond each end."""
    base, limits = split_range(hint)
    kind = base if base in (int, float) else get_args(base)[0]
    numbers = [] if kind is int else [math.nan, math.inf, -math.inf]
    away = [rng.uniform(0.1, 10.0), 10.0 ** rng.uniform(-2, 6)]
    for end, sign, excluded in ((limits.low, -1, limits.above), (limits.high, 1, limits.below)):
        if math.isfinite(end):
            numbers += [kind(end + sign * math.ceil(step) if kind is int else end + sign * step) for step in away]
            numbers += [end] if excluded else []
    if is_interval(base):
        inside = [value for value in (limits.low, limits.high, 1.0, 2.0) if limits.holds(value)]
        yield from ((number, max(inside)) for number in numbers if not number > max(inside))
        yield from ((min(inside), number) for number in numbers)
        yield max(inside) + 0.0, max(inside) - 1e-3
    elif kind is not base:
        yield ()
        yield from ((number,) for number in numbers)
    else:
        yield from numbers


@pytest.mark.parametrize("name", ["robust", "velocity", "continuous"])
def test_whatever_is_outside_a_fields_range_is_refused_in_one_line(name):
    config, rng, refused = CONFIGS[name](), random.Random(0), 0
    for path, hint in fields_of(config):
        values = list(outside(hint, rng))
        assert values, f"{path} takes any number"
        for value in values:
            with pytest.raises(ArriveError) as error:
                check_config(changed(config, path.split("."), value))
            assert "\n" not in str(error.value)
            assert f"{path} must be" in str(error.value), (path, value)
            refused += 1
    assert refused > 300


def changed(config: Any, path: list[str], value: Any) -> Any:
    name, *rest = path
    return replace(config, **{name: changed(getattr(config, name), rest, value) if rest else value})


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("randomisation.push_interval_s=0", ["randomisation.push_interval_s", "above 0, not", "not 0.0"]),
        ("randomisation.friction=[-1,0.5]", ["randomisation.friction", "above 0", "[-1.0, 0.5]"]),
        ("randomisation.friction=[1,0.5]", ["randomisation.friction", "the smaller first"]),
        ("randomisation.payload_kg=[-30,0]", ["randomisation.payload_kg", "the base's own mass"]),
        ("observation.heights.noise=-1", ["observation.heights.noise", "at least 0, not", "not -1.0"]),
        ("observation.heights.noise=2e6", ["observation.heights.noise", "0 to 1e+06, not 2000000.0"]),
        ("num_envs=3000000000", ["num_envs", "1 to 2147483647, not 3000000000"]),
        ("seed=4294967296", ["seed", "0 to 4294967295"]),
        ("randomisation.payload_kg=[-1,2e6]", ["randomisation.payload_kg", "the smaller first, -1e+06 to 1e+06"]),
        ("observation.heights.noise=NaN", ["observation.heights.noise", "at least 0, not", "not nan"]),
        ("task.reward_window_s=10", ["task.reward_window_s", "at most task.episode_min_s, 5", "not 10.0"]),
        ("task.target_distance=[1,50]", ["task.target_distance", "0 to 6.5", "[1.0, 50.0]"]),
        ("task.target_height=-0.1", ["task.target_height", "at least 0, not"]),
        ("task.episode_min_s=9", ["task.episode_min_s", "at most task.episode_s, 8"]),
        ("task.rewards.stall_cost=1", ["task.rewards.stall_cost.weight", "at most 0, not", "not 1.0"]),
        ("task.stop_share=0.2", ["task.stop_share", "0 where task.retarget_s is 0"]),
        (
            "task.rewards.approach.max_speed=0.5",
            ["task.rewards.approach.max_speed", "0, or at least task.rewards.approach.speed, 1"],
        ),
        ("ppo.mini_batches=2000000", ["ppo.mini_batches", "at most the batch of 12288"]),
        ("ppo.hidden=[]", ["ppo.hidden", "at least one"]),
        ("physics.contact_time_s=0.001", ["physics.contact_time_s", "at least 2 physics steps"]),
        ("observation.heights.clip=[0.1,1]", ["observation.heights.clip", "the first below 0"]),
        ("num_envs=0", ["num_envs", "at least 1", "not 0"]),
        ("preset=paper", ["preset", "--preset"]),
        ("task.name=velocity", ["task.name", "--task"]),
    ],
)
def test_a_bad_value_is_refused_before_anything_is_built(assignment, words):
    with pytest.raises(ArriveError) as error:
        make_config(parse_families("gap"), overrides=(assignment,))
    for word in words:
        assert word in str(error.value)


def test_a_field_of_another_task_is_an_error():
    with pytest.raises(ArriveError, match="no 'crossing_share'"):
        make_config(parse_families("gap"), task="velocity", overrides=("task.crossing_share=0.5",))
    make_config(parse_families("gap"), task="velocity", overrides=("task.heading_gain=1",))


@pytest.mark.parametrize("name", CONFIGS)
def test_every_field_has_documentation(name):
    for row in rows(CONFIGS[name]()):
        assert row.meaning or row.path.count(".") > 2, row.path
        if isinstance(row.value, float | int) and not isinstance(row.value, bool):
            assert row.range, row.path


def test_an_integer_that_is_no_float_is_out_of_range():
    config = override(get_preset("paper"), ("ppo.gamma=1" + "0" * 400,))
    with pytest.raises(ArriveError, match=r"ppo\.gamma must be 0 to 1, not 1e\+300"):
        check_config(config)


def test_a_saved_configuration_is_read_with_no_other_module_imported():
    """Its task's fields must be known: a program for a robot may import nothing else."""
    program = (
        "from arrive.config import Config, from_dict, to_dict; assert from_dict(Config, to_dict(Config())) == Config()"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
