"""500 hostile command lines: each is refused in one line, or done; none shows a traceback, hangs, asks for memory that
is not there, or takes a number outside its meaning."""

import contextlib
import os
import resource
import shutil
import signal
import socket
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from actuator_networks import lstm
from arrive import cli, room
from arrive.actuation.logs import COLUMNS
from arrive.actuation.network_file import write_network
from arrive.commands import actuator
from arrive.render import graphics
from hostile import (
    ASSIGNMENTS,
    CHOICE,
    COUNT,
    HELD,
    HELD_ASSIGNMENTS,
    LEVEL,
    NAME,
    OUT_OF_RANGE,
    POSITIVE,
    SEED,
    TERRAIN,
    THREADS,
    WORDS,
    Line,
    Sample,
    bad,
    bad_inputs,
    bad_outputs,
    damage,
    draw,
    good,
)

LINES = int(os.environ.get("ARRIVE_HOSTILE_LINES", "500"))
SEED_OF_LINES = int(os.environ.get("ARRIVE_HOSTILE_SEED", "24"))
LIMIT_S = 60.0
"""A command that has computed for longer hangs: the slowest takes a second. What else runs does not count [s]."""
PATIENCE_S = 900.0
"""One that is not over by then hangs too, whatever it waits for [s]."""
FREE = 2.0**30
"""What commands are told is free [bytes]."""
ROOM = 2**31
"""What they get before the system refuses more, libraries and threads included [bytes]."""
TINY = ("ppo.hidden=[8]", "ppo.num_steps=4", "terrain.levels=1", "terrain.variants=1", "task.episode_s=0.4",
        "task.episode_min_s=0.4", "task.reward_window_s=0.2")  # fmt: skip
CLASSES = {
    ("train",): cli.Train, ("eval",): cli.Eval, ("report",): cli.Report, ("energy",): cli.Energy, ("gait",): cli.Gait,
    ("drive",): cli.Drive, ("play",): cli.Play, ("export",): cli.Export, ("verify",): cli.Verify,
    ("bench",): cli.Bench, ("list",): cli.List, ("actuator", "record"): actuator.Record,
    ("actuator", "fit"): actuator.Fit, ("actuator", "show"): actuator.Show, ("actuator", "import"): actuator.Import,
}  # fmt: skip


class Hang(BaseException):
    """A command took too long."""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a sound file of each kind."""
    folder = tmp_path_factory.mktemp("hostile")
    before = Path.cwd()
    os.chdir(folder)
    try:
        options = ("--num-envs", "2", "--threads", "1", "--iterations", "1", "--out", "run")
        cli.main(["train", "flat", *options, "--set", *TINY])
        cli.main(["export", "run", "--out", "policy.onnx"])
    finally:
        os.chdir(before)
    time = np.arange(1000) * 0.005
    log = {"time": time} | {name: np.sin((i + 1) * time) for i, name in enumerate(COLUMNS[1:])}
    np.savez(folder / "log.npz", **log)
    np.savetxt(
        folder / "log.csv", np.stack(list(log.values()), axis=1), delimiter=",", header=",".join(log), comments=""
    )
    write_network(folder / "drive.safetensors", lstm())
    scales = {"in_scale": np.array([2.0, 0.25]), "out_scale": np.array([20.0])}
    np.savez(folder / "arrays.npz", **lstm().weights, **scales)
    (folder / "script.csv").write_text("time_s,forward,left,heading_rad\n0,1,0,\n0.1,0,0,\n")
    return folder


@pytest.fixture
def there(place, monkeypatch):
    """In that folder, without graphics, on a machine with a fixed amount of memory."""
    monkeypatch.chdir(place)
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    monkeypatch.setattr(room, "free_memory", lambda: FREE)
    graphics.graphics_backend.cache_clear()
    yield place
    graphics.graphics_backend.cache_clear()


@pytest.fixture(scope="module")
def samples(place) -> list[Sample]:
    """Every command with values for every option."""
    folder = place
    inputs, outputs = bad_inputs(folder), bad_outputs(folder)

    copies: list[Path] = []

    def files(name: str):
        return inputs + bad(*map(str, damage(folder, folder / name)))

    def runs(*names: str):
        """Folders whose files are damaged."""
        paths = []
        for name in names:
            for i, path in enumerate(damage(folder, folder / "run" / name)):
                copy = folder / f"{name}-{i}-{len(copies)}"
                copies.append(copy)
                shutil.copytree(folder / "run", copy)
                path.replace(copy / name)
                paths.append(str(copy))
        return inputs + bad(*paths)

    policy = runs("policy.pt") + files("run/policy.pt") + bad("gapp", "../policies/gap")
    exported = files("policy.onnx") + bad("gapp")
    out = outputs + good("一", "\udcff", "a\nb.html", "out.json")
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = str(server.getsockname()[1])
    common = {"seed": SEED, "threads": THREADS}
    build = {
        "preset": NAME,
        "task": NAME,
        "robot": NAME,
        "num_envs": HELD + bad("1000000000"),
        "set": ASSIGNMENTS + OUT_OF_RANGE + HELD_ASSIGNMENTS,
    }
    amounts = {"minutes": POSITIVE + good("1e-300"), "samples": POSITIVE + bad("M", "1T", "nanM") + good("8", "1k"),
               "iterations": COUNT}  # fmt: skip
    train = ["train", "flat", "--num-envs", "2", "--iterations", "1", "--threads", "1", "--out", "new"]
    resume = ["train", "flat", "--iterations", "1", "--threads", "1", "--resume", "run"]
    bench = ["bench", "flat", "--num-envs", "2", "--rounds", "1", "--threads", "1"]
    evaluate = ["eval", "run", "--episodes", "2", "--threads", "1"]
    level = {"terrain": TERRAIN, "level": LEVEL}
    drive = ["drive", "policy.onnx", "--script", "script.csv"]
    speeds = bad("nan", "inf", "-1", "0", "1e9", "x", "")
    robots = bad("0", "1", "-1", "1000000000", "1.5", "nan", "")
    taps = ["actuator", "fit", "log.npz", "--epochs", "1", "--threads", "1", "--out", "fit.safetensors"]
    return [
        Sample([*train, "--set", *TINY], amounts | common | build | {"out": outputs[1:], "device": CHOICE,
               "start_from": runs("checkpoint.pt", "config.json"), "config": runs("config.json"), "logger": NAME,
               "film_minutes": POSITIVE}, {1: TERRAIN}, 4),
        Sample(resume, amounts | common | {"resume": runs("checkpoint.pt", "config.json", "log.csv")}, {1: TERRAIN}, 2),
        Sample([*evaluate, "--json", "eval.json", "--pictures", "pictures"],
               common | level | {"protocol": NAME, "levels": LEVEL, "value": bad("nan", "inf", "-1e308", "x"),
               "layout": NAME, "target_distance": bad("nan", "-1", "1e9", "x", "1,,2"),
               "direction": bad("nan", "x", "inf"), "time": bad("nan", "-1", "x", "1e9"), "episodes": HELD,
               "device": CHOICE,
               "json": out, "pictures": outputs[1:]}, {1: policy}, 3),
        Sample([*evaluate, "--protocol", "difficulty", "--levels", "1", "--json", "difficulty.json"],
               {"levels": HELD, "episodes": HELD, "terrain": TERRAIN, "level": LEVEL + bad("0")}, {1: policy}),
        Sample(["report", "run", "--out", "report.html"], {"out": out + bad("x.json"), "energy": inputs,
               "gait": inputs, "stability": inputs, "window": inputs},
               {1: runs("config.json", "log.csv")}),
        Sample(["energy", "run", "--speeds", "1", "--distance", "2", "--robots", "2", "--threads", "1"],
               common | {"speeds": speeds, "distance": speeds, "robots": robots, "json": out}, {1: policy}),
        Sample(["gait", "run", "--speeds", "1", "--seconds", "2", "--robots", "2", "--threads", "1"],
               common | {"speeds": speeds, "directions": bad("nan", "inf", "1e9", "x"), "seconds": speeds,
               "robots": robots, "json": out}, {1: policy}),
        Sample(drive, level | {"seconds": POSITIVE, "script": files("script.csv"), "log": outputs, "seed": SEED},
               {1: exported + policy}, 2),
        Sample(["play", "policy.onnx", "--port", port, "--seconds", "0.1"],
               level | {"layout": NAME, "port": COUNT + bad("65536", "99999999999"),
               "seconds": POSITIVE, "host": bad("", " ", "nowhere.invalid", "999.1.1.1", "\udcff", "h" * 300)},
               {1: exported}, done=False),
        Sample(["export", "run", "--out", "again.onnx"], {"out": outputs + good("/dev/null")}, {1: policy}),
        Sample(["verify", "policy.onnx"], {}, {1: exported}),
        Sample([*bench, "--set", *TINY], build | {"threads": THREADS, "rounds": COUNT, "json": outputs,
               "policy": inputs, "start_from": runs("checkpoint.pt")}, {1: TERRAIN}),
        Sample(["bench", "--deployment", "--policy", "policy.onnx"], {"policy": exported}, {}, done=False),
        Sample(["list", "terrains"], {}, {1: NAME}),
        Sample(["actuator", "record", "--joints", "1", "--seconds", "0.1", "--out", "record.npz"],
               {"joints": HELD, "seconds": POSITIVE + bad("1e300"),
               "period_s": POSITIVE + bad("1e300", "1e-300", "0.0003"), "seed": SEED,
               "out": outputs + bad("x.txt")}, {}),
        Sample(taps, common | {"period_s": POSITIVE + bad("1e9", "0.003"), "architecture": CHOICE,
               "units": HELD, "taps_s": bad("nan", "-1", "inf", "1e9", "x"), "epochs": COUNT, "patience": COUNT,
               "learning_rate": POSITIVE + bad("1e300"), "data": WORDS, "out": outputs},
               {2: files("log.npz") + files("log.csv")}),
        Sample(["actuator", "show", "drive.safetensors", "--out", "motors.png"],
               {"clip": CHOICE, "robot": NAME, "joint": NAME, "inertia": POSITIVE, "out": outputs},
               {2: files("drive.safetensors")}),
        Sample(["actuator", "import", "arrays.npz", "--out", "imported.safetensors"],
               {"period_s": POSITIVE + bad("1e9"), "data": WORDS, "out": outputs}, {2: files("arrays.npz")}),
    ]  # fmt: skip


POSITIONAL = {"terrain", "policy", "others", "run", "file", "what", "logs", "files"}


def test_every_option_of_every_command_is_tried(samples):
    tried: dict[type, set[str]] = {}
    for sample in samples:
        kind = next(kind for words, kind in CLASSES.items() if tuple(sample.words[: len(words)]) == words)
        tried.setdefault(kind, set()).update(sample.options)
    assert set(tried) == set(CLASSES.values())
    missing = {
        kind.__name__: {field.name for field in fields(kind)} - options - POSITIONAL - {"force", "deployment", "follow"}
        for kind, options in tried.items()
    }
    assert not {name: options for name, options in missing.items() if options}


@contextlib.contextmanager
def bounded():
    """Not longer than `LIMIT_S` on the CPU, and not more memory than `ROOM` on top of what is taken."""
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if Path("/proc").is_dir() else 0
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)

    def stop(number, frame):
        raise Hang

    before = {number: signal.signal(number, stop) for number in (signal.SIGPROF, signal.SIGALRM)}
    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)
    if pages:
        resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + ROOM, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        for timer in (signal.ITIMER_PROF, signal.ITIMER_REAL):
            signal.setitimer(timer, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)


def complaint(line: Line, capfd) -> str:
    """What is wrong with how a line was answered; empty where nothing is."""
    capfd.readouterr()
    try:
        with bounded():
            cli.main(list(line.words))
        code = 0
    except SystemExit as stopped:
        code = stopped.code
    except Hang:
        return "hangs"
    except BaseException as error:
        return f"raises {type(error).__name__}: {error}"
    out, err = capfd.readouterr()
    if "Traceback" in out + err:
        return f"shows a traceback: {err[-300:]}"
    if code == 0:
        return "takes " + ", ".join(line.bad) if line.bad else ""
    if code == 1 and ("unexpected" in err or "not enough memory for this" in err or not one_line(err)):
        return f"says {err[-300:]!r}"
    return "" if code in (1, 2) else f"ends with {code}"


def one_line(err: str) -> bool:
    return err.startswith("arrive: ") and err.count("\n") == 1


def test_hostile_command_lines_are_refused_or_run(there, samples, capfd):
    before = sorted(path for path in (there / "run").rglob("*") if path.is_file())
    complaints, sound = [], set(there.iterdir())
    for line in draw(samples, LINES, SEED_OF_LINES):
        shutil.rmtree(there / "new", ignore_errors=True)
        for path in set(there.iterdir()) - sound:  # which would be refused the second time
            if path.is_file():
                path.unlink()
        problem = complaint(line, capfd)
        if problem:
            complaints.append(f"{' '.join(ascii(word)[:80] for word in line.words)}\n    {problem}")
    assert not complaints, f"{len(complaints)} of {LINES}:\n" + "\n".join(complaints)
    assert set(before) <= {path for path in (there / "run").rglob("*") if path.is_file()}
