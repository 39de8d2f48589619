"""The options of each command. They are separate from the code that runs it, so that help is fast."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from arrive.commands.limits import COUNT, FIGURE, INDEX, JSON, PAGE, POSITIVE, SEED, Suffix
from arrive.fields import Range


@dataclass(frozen=True)
class Train:
    """Train a policy on one or more terrains. Training stops when its budget is spent, and can be resumed."""

    terrain: tyro.conf.Positional[str]
    """Terrain family, several joined by commas, or `all`."""
    preset: str | None = None
    """Named configuration, see `arrive list`; `robust` by default."""
    robot: str | None = None
    """Named robot, see `arrive list`; `anymal_c` by default."""
    task: str | None = None
    """Named task, see `arrive list`; the preset's own by default."""
    minutes: Annotated[float | None, POSITIVE] = None
    """Training time since the start of the run; 40 unless samples or iterations are given [min]."""
    samples: str | None = None
    """Policy steps of all robots since the start of the run, e.g. 40M. Unlike minutes, this is reproducible."""
    iterations: Annotated[int | None, COUNT] = None
    """Training iterations since the start of the run."""
    num_envs: Annotated[int | None, COUNT] = None
    """Robots simulated side by side; the preset's own number by default."""
    seed: Annotated[int | None, SEED] = None
    """Random seed of networks, terrain and everything else; 1 by default."""
    threads: Annotated[int, INDEX] = 0
    """CPU threads for physics and learning; 0 takes every CPU."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to train; `auto` takes an NVIDIA GPU if one can be used."""
    resume: Path | None = None
    """Run folder to resume exactly."""
    start_from: Path | None = None
    """Run whose networks the new run starts from. A policy file, an exported file or a shipped policy has no critic, so
    only the actor is taken."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder of the run; a new one under runs/ by default."""
    config: Path | None = None
    """A run's config.json, or its folder, to use its configuration instead of a preset's."""
    set: tuple[str, ...] = ()
    """Changes to the configuration as PATH=VALUE, e.g. ppo.gamma=0.99 task.rewards.stall_cost=-2; `arrive list config`
    lists all fields."""
    logger: Literal["tensorboard", "wandb"] = "tensorboard"
    """Where to log besides log.csv. `wandb` logs to both TensorBoard and Weights & Biases (pip install wandb)."""
    film_minutes: Annotated[float | None, POSITIVE] = None
    """Film the newest policy at this interval on each terrain, at the level that its robots have reached, into the
    folder films/ of the run [min]."""


@dataclass(frozen=True)
class Eval:
    """Measure success rates of policies per terrain and level, with their causes of failure."""

    policy: tyro.conf.Positional[Path]
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`."""
    others: tyro.conf.Positional[tuple[Path, ...]] = ()
    """More policies, evaluated one after the other."""
    protocol: Literal["arrival", "difficulty", "reach"] | None = None
    """`arrival`: the conditions of training (default); `difficulty`: the paper's measurement of the hardest solved
    terrain; `reach`: by distance, direction and time, and waiting at the target (default if --target-distance,
    --direction or --time is given)."""
    terrain: str | None = None
    """Terrain family, several joined by commas, or `all`. NAME=VALUE sets the parameter, e.g. gap=0.4,pit=0.3 [m] or
    slope=20 [deg]. Default: the terrains that the policy was trained on. Without a value `arrival` and `difficulty`
    measure `--levels`, and `reach` the hardest value that the policy solves."""
    level: int | None = None
    """One of the policy's own levels."""
    value: float | None = None
    """Value of the terrain's parameter in its unit, for a single terrain."""
    levels: Annotated[int | None, Range(1, 1000)] = None
    """Number of evenly spaced levels: for `arrival` of the policy's own, at most 10 by default; for `difficulty` of the
    terrain's range, a fixed list per terrain by default."""
    target_distance: str | None = None
    """Distances of targets, joined by commas, for `reach`; 0.5,1,2,3,4,5,6 by default [m]."""
    direction: str | None = None
    """Directions of targets relative to the initial heading, counterclockwise, joined by commas, for `reach`; eight by
    default [deg]."""
    time: str | None = None
    """Times to reach the target, joined by commas, for `reach`; 3,5,8,10 by default [s]."""
    layout: Literal["training", "evaluation"] | None = None
    """`training`: terrain all around the robot, the default for `arrival`; `evaluation`: 4 m of it ahead, the default
    for `reach` and always so for `difficulty`."""
    episodes: Annotated[int, COUNT] = 500
    """Episodes per row of a table."""
    seed: Annotated[int, SEED] = 1
    """Seed of terrain and episodes, which differ from those of training."""
    threads: Annotated[int, INDEX] = 0
    """CPU threads; 0 takes every CPU."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to simulate; `auto` takes an NVIDIA GPU if one can be used."""
    json: Annotated[Path | None, JSON] = None
    """JSON file for the result. By default `difficulty` over all levels writes difficulty.json, and `reach` writes
    reach.json, beside each policy."""
    pictures: Path | None = None
    """Folder for picture strips and a film of each terrain, of the hardest level whose first robot arrived; beside the
    policy by default."""
    force: bool = False
    """Replace the result of a longer measurement."""


@dataclass(frozen=True)
class Report:
    """Compare results with the paper's table and figures, on one HTML page with a JSON file.

    Results come from `arrive eval` with the protocols `difficulty` and `reach`. For missing results, the page names the
    command that makes them.
    """

    run: tyro.conf.Positional[Path]
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`."""
    others: tyro.conf.Positional[tuple[Path, ...]] = ()
    """More policies."""
    energy: Path | None = None
    """Result of `arrive energy`; ./energy.json by default, if it is there."""
    gait: Path | None = None
    """Result of `arrive gait`; ./gait.json by default, if it is there."""
    stability: Path | None = None
    """Result of benchmarks/stability.py; the one under runs/stability/ by default, if it is there."""
    window: Path | None = None
    """Result of benchmarks/time_window.py; the one under runs/time_window/ by default, if it is there."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"]), PAGE] = Path("report.html")
    """File for the page. The JSON file has the same name with the suffix .json."""
    force: bool = False
    """Replace the files even if they are not from a report."""


@dataclass(frozen=True)
class Energy:
    """Measure the energy consumption of walking at commanded speeds (the paper's figure 4)."""

    policy: tyro.conf.Positional[Path]
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`."""
    others: tyro.conf.Positional[tuple[Path, ...]] = ()
    """More of them, to be compared."""
    speeds: tuple[float, ...] = (0.25, 0.5, 0.75, 1.0, 1.2, 1.4, 1.6, 1.75)
    """Commanded speeds. A policy of `final` is commanded at least 3 m in an episode, and slower speeds become that
    [m/s]."""
    distance: float = 100.0
    """Distance that every robot walks [m]."""
    robots: int = 50
    """Number of robots per speed."""
    seed: Annotated[int, SEED] = 1
    """Seed of friction, payload, starts and noise."""
    threads: Annotated[int, INDEX] = 0
    """CPU threads; 0 takes every CPU."""
    json: Annotated[Path, FIGURE] = Path("energy.json")
    """File for the result; the picture has the same name and ends in .png."""
    force: bool = False
    """Replace the result of a longer measurement."""


@dataclass(frozen=True)
class Gait:
    """Measure gaits: footfalls, duty factors, strides, phases, and the gait's name (the paper's figure 5)."""

    policy: tyro.conf.Positional[Path]
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`."""
    others: tyro.conf.Positional[tuple[Path, ...]] = ()
    """More of them, to be compared."""
    speeds: tuple[float, ...] = (0.5, 1.0)
    """Commanded speeds; slow ones as in `arrive energy` [m/s]."""
    directions: tuple[float, ...] = (0.0,)
    """Commanded directions relative to the initial heading, counterclockwise. Policies of the task `velocity` support
    only 0 and 180 [deg]."""
    seconds: float = 10.0
    """Duration of the measurement, after 5 s of walking [s]."""
    robots: int = 20
    """Number of robots per speed and direction."""
    seed: Annotated[int, SEED] = 1
    """Seed of friction, payload, starts and noise."""
    threads: Annotated[int, INDEX] = 0
    """CPU threads; 0 takes every CPU."""
    json: Annotated[Path, FIGURE] = Path("gait.json")
    """File for the result; the picture has the same name and ends in .png."""
    force: bool = False
    """Replace the result of a longer measurement."""


@dataclass(frozen=True)
class Drive:
    """Drive a simulated robot with a gamepad or a script, through the controller that runs on a real robot."""

    policy: tyro.conf.Positional[str | None] = field(default=None)
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`; `joystick` by
    default."""
    terrain: str = "flat"
    """Terrain family, or NAME=VALUE with the value of its parameter, e.g. gap=0.4 [m] or slope=20 [deg]."""
    level: int | None = None
    """One of the policy's own levels, as in `arrive eval`; 0 by default."""
    seconds: Annotated[float | None, POSITIVE] = None
    """Duration; by default to the end of the script, or with a gamepad until Ctrl-C [s]."""
    script: Path | None = None
    """CSV file of stick positions with the columns time_s, forward, left, heading_rad. It runs as fast as the machine
    can."""
    log: Annotated[Path | None, Suffix((".npz",))] = None
    """File (.npz) for all inputs and commands of the controller, for replay."""
    force: bool = False
    """Replace a file that exists."""
    seed: Annotated[int, SEED] = 1
    """Seed of random terrain."""


@dataclass(frozen=True)
class Play:
    """Drive a simulated robot in the browser, through the controller that runs on a real robot."""

    policy: tyro.conf.Positional[str | None] = field(default=None)
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`; `joystick` by
    default."""
    terrain: str | None = None
    """Terrain family, or NAME=VALUE with the value of its parameter, e.g. gap=0.4 [m] or slope=20 [deg]. Default: the
    terrain that the policy was trained on, at the hardest value that it solves in 95 %, as it does every easier one."""
    level: int | None = None
    """One of the policy's own levels, as in `arrive eval`."""
    layout: Literal["evaluation", "training"] = "evaluation"
    """`evaluation`: the terrain lies between the robot and its target; `training`: all around the robot."""
    follow: bool = False
    """Load the newest network whenever the run in progress writes one."""
    port: Annotated[int, Range(1, 65535)] = 8080
    """Port of the page."""
    host: str = "127.0.0.1"
    """Address on which the page is served. If other machines can reach it (0.0.0.0 for all addresses), the page
    requires the token in the printed address."""
    seconds: Annotated[float | None, POSITIVE] = None
    """Stop after this time; by default run until Ctrl-C [s]."""


@dataclass(frozen=True)
class Showreel:
    """Make an animated picture of robots on the terrains that policies solve."""

    policies: tyro.conf.Positional[tuple[str, ...]] = ()
    """Policies, as for `arrive eval`, each on the terrain on which `arrive play` opens it. Default: for every terrain,
    the shipped policy that solves the hardest value."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"]), Suffix((".webp",))] = Path("showreel.webp")
    """File to write, at most 3 MB."""
    force: bool = False
    """Replace a file that exists."""


@dataclass(frozen=True)
class Export:
    """Write a policy as one ONNX file with everything that a robot's computer needs to run it."""

    policy: tyro.conf.Positional[Path]
    """Run folder, policy file, exported file or name of a shipped policy, see `arrive list policies`."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"]), Suffix((".onnx",))] = Path("policy.onnx")
    """File to write."""
    force: bool = False
    """Replace a file that exists."""


@dataclass(frozen=True)
class Verify:
    """Check an exported policy: golden pairs, shapes, names, and agreement with its robot and task."""

    file: tyro.conf.Positional[Path]
    """File written by `arrive export`."""


@dataclass(frozen=True)
class Bench:
    """Measure the speed of simulation, rollouts and updates on this machine, or of the deployment controller."""

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
    """Number of repetitions of every measurement."""
    start_from: Path | None = None
    """Run folder whose policy moves the robots. Without it, they fall."""
    set: tuple[str, ...] = ()
    """Changes to the configuration as PATH=VALUE, e.g. ppo.hidden=[64,64]; `arrive list config` lists all fields."""
    deployment: bool = False
    """Measure the deployment controller instead: latency of a step on one core, and memory."""
    policy: tuple[Path, ...] = ()
    """Exported files to measure with `--deployment`, besides networks of the paper's size with random weights."""
    json: Annotated[Path | None, JSON] = None
    """JSON file for the result."""
    force: bool = False
    """Replace the JSON file even if it holds something else than a result of this command."""


@dataclass(frozen=True)
class List:
    """List terrains, presets, robots, tasks, rewards and shipped policies, or all fields of a configuration."""

    what: tyro.conf.Positional[str | None] = field(default=None)
    """`terrains`, `presets`, `robots`, `tasks`, `rewards` or `policies` (all of these by default), or `config`: every
    field with its unit, default and range."""
