"""Command lines as a hostile or careless person may type them: every option of every command with values that it must
refuse, or that it may take, drawn from a seed."""

import os
import random
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

BAD, GOOD = True, False
"""Whether an option must refuse a value, or may take it."""
Values = list[tuple[str, bool]]

NO_NUMBERS = ["", " ", "nan", "NaN", "-nan", "inf", "-inf", "Infinity", "1e999", "x", "0x10", "1,5", "1/2", "--",
              "true", "[1]", "½", "一", "\u200b1", "1e", "9" * 5000, "1;2", "$(id)", "\udcff"]  # fmt: skip
NEGATIVE = ["-1", "-0.5", "-1e308", "-9223372036854775808", "-1e-300"]
FRACTIONS = ["1.5", "0.1", "1e3", "1e-320", "-0.0"]
HUGE = ["1000000000000", "18446744073709551616", "1" + "0" * 400]


def bad(*texts: str) -> Values:
    return [(text, BAD) for text in texts]


def good(*texts: str) -> Values:
    return [(text, GOOD) for text in texts]


COUNT = bad(*NO_NUMBERS, *NEGATIVE, *FRACTIONS, "0")
HELD = COUNT + bad(*HUGE)
"""A count of what is kept in memory: so many do not fit."""
SEED = bad(*NO_NUMBERS, *NEGATIVE, *FRACTIONS, *HUGE, "9007199254740992", "4294967296")
SEED += good("0", "4294967295", "007", "+3")
POSITIVE = bad(*NO_NUMBERS, *NEGATIVE, "0", "-0.0", "0.0")
THREADS = bad(*NO_NUMBERS, *NEGATIVE, *FRACTIONS, *HUGE, "1000000") + good("1", "2")
LEVEL = bad(*NO_NUMBERS, *NEGATIVE, *FRACTIONS, *HUGE, "99")
TERRAIN = bad("", " ", ",", "flat,", ",flat", "flat,flat", "flt", "FLAT", "all,flat", "../flat", "flat;pit", "\udcff",
              "一", "f" * 3000, "-", "[]", "gap=nan", "gap==1", "=1", "gap=1e9")  # fmt: skip
NAME = bad("", " ", "robst", "ROBUST", "../paper", "\udcff", "x" * 3000, "0")
CHOICE = bad("", "CPU", "tpu", "0", "\udcff", "cpu,cuda")
ASSIGNMENTS = bad("", "=", "==", "ppo", "ppo.gamma", "=1", ".=1", "ppo.=1", ".ppo=1", "ppo..gamma=1", "ppo.gama=1",
                  "ppo=1", "ppo.gamma=", "ppo.gamma=high", "ppo.gamma=[1]", "ppo.gamma={}", "ppo.gamma=null",
                  "ppo.gamma=true", "ppo.hidden=8", "ppo.hidden=[[8]]", "ppo.hidden=[8,\"a\"]", "ppo.hidden=[8.5]",
                  "num_envs=1.5", "num_envs=\"2\"", "num_envs=true", "ppo.gamma.x=1", "task.rewards=3",
                  "task.rewards.=1", "task.rewards.tasks=1", "task.rewards.task.x=1", "terrain.families=flat",
                  "terrain.families=[1]", "terrain.shares.pitt=1", "terrain.shares=[]", "physics.motor=steam",
                  "physics.motor_file=/dev/zero", "robot=cat", "robot=3", "preset=3", "task.name=fnal",
                  "ppo.gamma=" + "9" * 5000, "ppo.hidden=" + "[" * 5000, "ppo.hidden=[8", "ppo.gamma={\"a\":",
                  "__class__=1", "__class__.__name__=x", "physics.__init__=1", "\udcff=1",
                  "observation.heights.clip=[1]", "observation.heights.clip=[1,2,3]", "一=1", "ppo.precision=float8",
                  "physics.cone=round", "physics.motor_clip=none", "schedule.enabled=1", "-1")  # fmt: skip
OUT_OF_RANGE = bad("physics.timestep_s=1e9", "physics.solver_tolerance=NaN",
                  "physics.decimation=1000000000", "physics.contact_time_s=-1", "physics.contact_impedance=2",
                  "randomisation.push_interval_s=0", "randomisation.start_yaw_rad=NaN", "randomisation.push_speed=NaN",
                  "randomisation.payload_kg=[0,1e9]", "randomisation.friction=[2,1]",
                  "ppo.value_loss=-1", "ppo.entropy=1e30", "ppo.value_loss=1e30", "ppo.learning_rate=2",
                  "task.rewards.task.weight=1e30", "task.rewards.torque_cost=-1e30", "randomisation.start_speed=1e9",
                  "physics.impratio=1e30", "physics.solver_iterations=2147483648", "ppo.epochs=1000000000000",
                  "observation.heights.clip=[-1e30,1e30]", "task.target_height=1e9", "schedule.climb_entropy=1e9",
                  "task.target_distance=[-5,-1]", "task.exploration_until=NaN", "seed=-1", "seed=18446744073709551616",
                  "num_envs=0", "ppo.gamma=1.5", "ppo.lam=-0.1",
                  "ppo.learning_rate=Infinity")  # fmt: skip
HELD_ASSIGNMENTS = bad("num_envs=1000000000", "terrain.variants=1000000", "terrain.levels=1000000000",
                       "ppo.num_steps=1000000000", "ppo.hidden=[100000000]", "ppo.hidden=[30000,30000]",
                       "observation.heights.length=1e9", "observation.heights.step=1e-9",
                       "observation.heights.step=1e-300",
                       "num_envs=" + "1" + "0" * 400)  # fmt: skip
WORDS = good("一", "\udcff", "a b", "", "--x", "x" * 3000)


@dataclass(frozen=True)
class Line:
    """A command line."""

    words: tuple[str, ...]
    bad: tuple[str, ...]
    """Values that it must refuse; empty where it may be done."""


@dataclass(frozen=True)
class Sample:
    """A command that is done at once, and what to put in place of its arguments.

    `options` maps the fields of the command's class; an argument without a name is given by its place among `words`.
    """

    words: list[str]
    options: dict[str, Values]
    places: dict[int, Values]
    share: int = 1
    """How many lines it gets, relative to the others."""
    done: bool = True
    """Whether it may be done, or is always given something to refuse."""


def damage(folder: Path, source: Path) -> list[Path]:
    """Copies of a file with what happens to files; of text without a digest only what can be told from other text."""
    data, suffix = source.read_bytes(), source.suffix
    middle = len(data) // 2
    versions = {
        "empty": b"",
        "cut": data[:middle],
        "bit": data[:middle] + bytes([data[middle] ^ 4]) + data[middle + 1 :],
        "long": data + b"\0" * 10,
        "text": b"hello\nworld\n",
        "nul": b"\0" * len(data),
        "nested": b"[" * 100_000,
        "binary": random.Random(5).randbytes(5000),
    }
    if source.suffix == ".csv":
        del versions["bit"], versions["long"]
    paths = []
    for name, content in versions.items():
        paths.append(folder / f"{source.stem}-{name}{suffix}")
        paths[-1].write_bytes(content)
    with zipfile.ZipFile(folder / f"{source.stem}-zip{suffix}", "w") as archive:
        archive.writestr("../../evil", b"evil")
    return [*paths, folder / f"{source.stem}-zip{suffix}"]


def bad_inputs(folder: Path) -> Values:
    """Paths that lead to nothing that can be read."""
    os.mkfifo(folder / "pipe")
    (folder / "loop").symlink_to(folder / "loop")
    (folder / "dangling").symlink_to(folder / "nothing")
    (folder / "empty").mkdir()
    with (folder / "huge").open("wb") as file:
        file.truncate(2**43)
    own = [str(folder / name) for name in ("pipe", "loop", "dangling", "empty", "huge", "nothing", "a\nb")]
    return bad(*own, "", " ", "/", "/dev/null", "/dev/zero", "/dev/urandom", "/dev/full", "/proc/self/mem",
               "/etc/passwd", "/etc/passwd/x", "n" * 300, "d/" * 3000, "~", "\udcff", "一", "-", "$HOME")  # fmt: skip


def bad_outputs(folder: Path) -> Values:
    """Paths where nobody can write, not even an administrator."""
    (folder / "file").write_text("in the way")
    return bad(str(folder), str(folder / "file" / "x"), "/proc/x", "/dev/full", "/dev/full/x", "n" * 300, "d/" * 3000)


def draw(samples: list[Sample], count: int, seed: int) -> Iterator[Line]:
    """So many lines, each with one to several values in place of those of a sample."""
    rng = random.Random(seed)
    pairs = [
        (sample, where, value)
        for sample in samples
        for where in (*sample.options, *sample.places)
        for value in (sample.options.get(where) or sample.places[where])
        if sample.done or value[1]
    ]
    weights = [pair[0].share for pair in pairs]
    for _ in range(count):
        sample, where, value = rng.choices(pairs, weights)[0]
        chosen = {where: value}
        while rng.random() < 0.3:  # more than one thing wrong at a time
            other = rng.choice([*sample.options, *sample.places])
            chosen.setdefault(other, rng.choice(sample.options.get(other) or sample.places[other]))
        yield put(sample, chosen)


def put(sample: Sample, chosen: dict[str | int, tuple[str, bool]]) -> Line:
    """The sample's words with these values."""
    words = list(sample.words)
    for where, (text, _) in chosen.items():
        if isinstance(where, int):
            words[where] = text
    for where, (text, _) in chosen.items():
        if isinstance(where, int):
            continue
        flag = "--" + where.replace("_", "-")
        if flag in words:
            place = words.index(flag) + 1
            # Of two assignments to one field the later would hold.
            kept = [word for word in words[place + 1 :] if word.partition("=")[0] != text.partition("=")[0]]
            words[place:] = [text, *kept]
        else:
            words += [flag, text]
    return Line(tuple(words), tuple(f"{where}={text[:60]!r}" for where, (text, refuse) in chosen.items() if refuse))
