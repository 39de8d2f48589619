"""The options of each command, apart from what runs it: help and misspelt options answer without loading that."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from arrive.commands.limits import COUNT, INDEX, POSITIVE, SEED
from arrive.fields import Range


@dataclass(frozen=True)
class Train:
    """Train a policy on one or more terrains; it stops by itself and can be resumed."""

    terrain: tyro.conf.Positional[str]
    """Terrain family, several joined by commas, or `all`."""
    preset: str | None = None
    """Named configuration, see `arrive list`; `robust` by default."""
    robot: str | None = None
    """Named robot, see `arrive list`; `anymal_c` by default."""
    task: str | None = None
    """Named task, see `arrive list`; the preset's own by default."""
    minutes: Annotated[float | None, POSITIVE] = None
    """Training time since the run began; 40 unless samples or iterations are given [min]."""
    samples: str | None = None
    """Policy steps of all robots since the run began, e.g. 40M; repeatable where minutes are not."""
    iterations: Annotated[int | None, COUNT] = None
    """Training iterations since the run began."""
    num_envs: Annotated[int | None, COUNT] = None
    """Robots simulated side by side; the preset's own number by default."""
    seed: Annotated[int | None, SEED] = None
    """Seed of networks, terrain and everything random; 1 by default."""
    threads: Annotated[int, INDEX] = 0
    """CPU threads for physics and learning; 0 takes every CPU."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to train; `auto` takes an NVIDIA GPU where one can be used."""
    resume: Path | None = None
    """Run folder to continue exactly where it stands."""
    start_from: Path | None = None
    """Run whose networks the new run starts with; of a policy file, an exported file or a shipped policy, which have no
    critic, the actor alone."""
    out: Path | None = None
    """Folder of the run; one under runs/ by default."""
    config: Path | None = None
    """A run's config.json, or its folder, whose configuration is taken in place of a preset's."""
    set: tuple[str, ...] = ()
    """Changes to the configuration as PATH=VALUE, e.g. ppo.gamma=0.99 task.rewards.stall_cost=-2; `arrive list config`
    has all fields."""
    logger: Literal["tensorboard", "wandb"] = "tensorboard"
    """Where curves go beside log.csv; `wandb` (Weights & Biases; pip install wandb) is TensorBoard and wandb."""
    film_minutes: Annotated[float | None, POSITIVE] = None
    """Film a robot of the newest policy this often into the folder films/ of the run [min]."""


@dataclass(frozen=True)
class Eval:
    """Measure how often policies succeed, per terrain and level, and say why they fail."""

    policy: tyro.conf.Positional[Path]
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`."""
    others: tyro.conf.Positional[tuple[Path, ...]] = ()
    """More of them, measured one after the other."""
    protocol: Literal["arrival", "difficulty", "reach"] | None = None
    """`arrival`: as in training, the default; `difficulty`: the paper's measurement of the hardest terrain solved;
    `reach`: by distance and direction of the target and by the time given, and whether robots then wait there, the
    default where one of these is given."""
    terrain: str | None = None
    """Terrain family, several joined by commas, or `all`, each also as NAME=VALUE with the value of its parameter, e.g.
    gap=0.4,pit=0.3 [m] or slope=20 [deg]; those it was trained on by default, all levels of them, or for `reach` the
    hardest value that they were measured to solve."""
    level: int | None = None
    """One of the policy's own levels."""
    value: float | None = None
    """Value of the only terrain's parameter, in its unit."""
    levels: Annotated[int | None, Range(1, 1000)] = None
    """Number of evenly spaced levels, for `difficulty`; a table per terrain by default."""
    target_distance: str | None = None
    """Distances of targets, joined by commas, for `reach`; 0.5,1,2,3,4,5,6 by default [m]."""
    direction: str | None = None
    """Directions of targets relative to the heading at the start, counterclockwise, joined by commas, for `reach`;
    eight by default [deg]."""
    time: str | None = None
    """Times given, joined by commas, for `reach`; 3,5,8,10 by default [s]."""
    layout: Literal["training", "evaluation"] | None = None
    """`training`: terrain all around the robot, the default for `arrival`; `evaluation`: 4 m of it ahead, the default
    for `reach` and always so for `difficulty`."""
    episodes: Annotated[int, COUNT] = 500
    """Episodes per row of a table."""
    seed: Annotated[int, SEED] = 1
    """Seed of terrain and episodes, apart from those of training."""
    threads: Annotated[int, INDEX] = 0
    """CPU threads; 0 takes every CPU."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to simulate; `auto` takes an NVIDIA GPU where one can be used."""
    json: Path | None = None
    """File for the result as JSON; `difficulty` over all levels writes difficulty.json, `reach` reach.json beside each
    policy by default."""
    pictures: Path | None = None
    """Folder for picture strips and, for `arrival`, a film; beside the policy by default."""
    force: bool = False
    """Replace the result of a longer measurement."""


@dataclass(frozen=True)
class Report:
    """Put what was measured beside the paper's table and figures, as one HTML page and a JSON file.

    Runs are measured by `arrive eval` with the protocols `difficulty` and `reach`; what is missing on the page says
    which command makes it.
    """

    run: tyro.conf.Positional[Path]
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`."""
    others: tyro.conf.Positional[tuple[Path, ...]] = ()
    """More of them."""
    energy: Path | None = None
    """Result of `arrive energy`; ./energy.json by default, if it is there."""
    gait: Path | None = None
    """Result of `arrive gait`; ./gait.json by default, if it is there."""
    stability: Path | None = None
    """Result of benchmarks/stability.py; the one under runs/stability/ by default, if it is there."""
    window: Path | None = None
    """Result of benchmarks/time_window.py; the one under runs/time_window/ by default, if it is there."""
    out: Path = Path("report.html")
    """File for the page; the JSON file has the same name and ends in .json."""


@dataclass(frozen=True)
class Energy:
    """Measure what walking costs at speeds that policies are told (the paper's figure 5)."""

    policy: tyro.conf.Positional[Path]
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`."""
    others: tyro.conf.Positional[tuple[Path, ...]] = ()
    """More of them, to be compared."""
    speeds: tuple[float, ...] = (0.25, 0.5, 0.75, 1.0, 1.2, 1.4, 1.6, 1.75)
    """Speeds that robots are told, each walked at [m/s]."""
    distance: float = 100.0
    """How far every robot walks [m]."""
    robots: int = 50
    """Robots per speed."""
    seed: Annotated[int, SEED] = 1
    """Seed of friction, payload, starts and noise."""
    threads: Annotated[int, INDEX] = 0
    """CPU threads; 0 takes every CPU."""
    json: Path = Path("energy.json")
    """File for the result; the picture has the same name and ends in .png."""
    force: bool = False
    """Replace the result of a longer measurement."""


@dataclass(frozen=True)
class Gait:
    """Measure how policies step: footfalls, duty factors, strides, phases, and the gait's name (paper, figure 6)."""

    policy: tyro.conf.Positional[Path]
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`."""
    others: tyro.conf.Positional[tuple[Path, ...]] = ()
    """More of them, to be compared."""
    speeds: tuple[float, ...] = (0.5, 1.0)
    """Speeds that robots are told [m/s]."""
    directions: tuple[float, ...] = (0.0,)
    """Directions in which they are sent, relative to the heading at the start, counterclockwise; policies that follow a
    velocity know 0 and 180 [deg]."""
    seconds: float = 10.0
    """How long they are looked at, after 5 s of walking [s]."""
    robots: int = 20
    """Robots per speed and direction."""
    seed: Annotated[int, SEED] = 1
    """Seed of friction, payload, starts and noise."""
    threads: Annotated[int, INDEX] = 0
    """CPU threads; 0 takes every CPU."""
    json: Path = Path("gait.json")
    """File for the result; the picture has the same name and ends in .png."""
    force: bool = False
    """Replace the result of a longer measurement."""


@dataclass(frozen=True)
class Drive:
    """Walk the robot with a gamepad or a file of sticks, through the controller that runs on a robot."""

    policy: tyro.conf.Positional[str | None] = field(default=None)
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`; `joystick` by
    default."""
    terrain: str = "flat"
    """Terrain family, or NAME=VALUE with the value of its parameter, e.g. gap=0.4 [m] or slope=20 [deg]."""
    level: int | None = None
    """One of the policy's own levels, as in `arrive eval`; 0 by default."""
    seconds: Annotated[float | None, POSITIVE] = None
    """How long; to the end of the script, or until Ctrl-C with a gamepad, by default [s]."""
    script: Path | None = None
    """CSV file with the columns time_s, forward, left, heading_rad to drive by, as fast as the machine can."""
    log: Path | None = None
    """File (.npz) for all inputs and commands of the controller, which can be replayed."""
    seed: Annotated[int, SEED] = 1
    """Seed of random terrain."""


@dataclass(frozen=True)
class Play:
    """Drive a robot in the browser, run by the same controller as a real one."""

    policy: tyro.conf.Positional[str | None] = field(default=None)
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`; `joystick` by
    default."""
    terrain: str | None = None
    """Terrain family, or NAME=VALUE with the value of its parameter, e.g. gap=0.4 [m] or slope=20 [deg]; what the
    policy was trained on by default, at the hardest value that it was measured to solve."""
    level: int | None = None
    """One of the policy's own levels, as in `arrive eval`."""
    layout: Literal["evaluation", "training"] = "evaluation"
    """`evaluation`: the terrain lies between the robot and its target; `training`: all around the robot."""
    follow: bool = False
    """Go on with the newest network whenever the run in progress writes one."""
    port: Annotated[int, Range(1, 65535)] = 8080
    """Port of the page."""
    host: str = "127.0.0.1"
    """Address that the page is served on. Beyond this machine (0.0.0.0 for all its addresses) the page asks for the
    token in the address that is printed."""
    seconds: Annotated[float | None, POSITIVE] = None
    """Stop after this time; with Ctrl-C by default [s]."""


@dataclass(frozen=True)
class Showreel:
    """Make an animated picture of robots on the terrains that policies solve."""

    policies: tyro.conf.Positional[tuple[str, ...]] = ()
    """Policies, as for `arrive eval`, on the terrain that each opens on in `arrive play`; for every terrain the shipped
    policy that solves the hardest by default."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("showreel.webp")
    """File to write, at most 3 MB."""


@dataclass(frozen=True)
class Export:
    """Write a policy as one ONNX file with all that a robot's computer must know to run it."""

    policy: tyro.conf.Positional[Path]
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("policy.onnx")
    """File to write."""


@dataclass(frozen=True)
class Verify:
    """Check an exported policy: golden pairs, shapes, names and everything that its robot and task decide."""

    file: tyro.conf.Positional[Path]
    """File written by `arrive export`."""


@dataclass(frozen=True)
class Bench:
    """Measure how fast this machine simulates, collects and learns, or runs the controller of a robot."""

    terrain: tyro.conf.Positional[str] = "flat"
    """Terrain family, several joined by commas, or `all`."""
    preset: str | None = None
    """Named configuration, see `arrive list`; `robust` by default."""
    robot: str | None = None
    """Named robot, see `arrive list`; `anymal_c` by default."""
    task: str | None = None
    """Named task, see `arrive list`; the preset's own by default."""
    num_envs: Annotated[int | None, COUNT] = None
    """Robots simulated side by side; the preset's own number by default."""
    threads: Annotated[int, INDEX] = 0
    """CPU threads for physics and learning; 0 takes every CPU."""
    rounds: Annotated[int, COUNT] = 7
    """Repetitions of every measurement."""
    start_from: Path | None = None
    """Run folder whose policy moves the robots; without it they fall."""
    set: tuple[str, ...] = ()
    """Changes to the configuration as PATH=VALUE, e.g. ppo.hidden=[64,64]; `arrive list config` has all fields."""
    deployment: bool = False
    """Measure the control step on a robot instead: its latency on one core and its memory."""
    policy: tuple[Path, ...] = ()
    """Exported files to measure with `--deployment`, beside networks of the paper's size with random weights."""
    json: Path | None = None
    """File for the result as JSON."""


@dataclass(frozen=True)
class List:
    """Name the terrains, presets, robots, tasks, rewards and shipped policies, or every field of a configuration."""

    what: tyro.conf.Positional[str | None] = field(default=None)
    """`terrains`, `presets`, `robots`, `tasks`, `rewards` or `policies`, all of these by default; or `config`: every
    field with its unit, default and range."""
