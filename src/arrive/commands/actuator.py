"""`arrive actuator record | fit | show | import`: actuator networks."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from arrive.commands.limits import COUNT, FITTED, INDEX, NETWORK, PICTURE, POSITIVE, SEED, Suffix
from arrive.errors import ArriveError
from arrive.fields import Range
from arrive.files import check_readable

if TYPE_CHECKING:
    import numpy as np

    from arrive.actuation import fit as fitting

PERIOD = Range(1e-5, 0.1)
"""Range of the physics step [s]."""
BYTES_PER_SAMPLE = 80
"""Memory for a log while it is recorded: target, load, position, velocity and torque, with copies."""


@dataclass(frozen=True)
class Record:
    """Log a simulated series-elastic drive under excitation, so that fitting can be tried without hardware."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"]), Suffix((".npz", ".csv"))] = Path("drive_log.npz")
    """File to write, .npz or .csv."""
    joints: Annotated[int, COUNT] = 40
    """Number of joints, simulated in parallel, each with its own load."""
    seconds: Annotated[float, POSITIVE] = 20.0
    """Length of the log [s]."""
    period_s: Annotated[float, PERIOD] = 0.005
    """Time between samples, a multiple of 0.2 ms [s]."""
    seed: Annotated[int, SEED] = 1
    """Seed of targets and loads."""
    force: bool = False
    """Replace a file that exists."""


@dataclass(frozen=True)
class Fit:
    """Train an actuator network on logged joints and measure its error on held-out trajectories."""

    logs: tyro.conf.Positional[tuple[Path, ...]]
    """CSV or NPZ files with time [s], target, position [rad], velocity [rad/s] and torque [N m]."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"]), FITTED] = Path("drive.safetensors")
    """File to write. A picture of predicted and measured torque is written beside it."""
    period_s: Annotated[float, PERIOD] = 0.005
    """Physics step of the simulation that will use the network; a multiple of the logs' period [s]."""
    architecture: Literal["lstm", "taps"] = "lstm"
    """`lstm`: as in legged_gym; `taps`: delayed inputs and softsign units, as in Hwangbo et al. 2019."""
    units: Annotated[tuple[int, ...], Range(1, 1024)] = ()
    """Units of each hidden layer; 8 8 for `lstm` and 32 32 32 for `taps` by default."""
    taps_s: Annotated[tuple[float, ...], Range(0, 1)] = (0.0, 0.01, 0.02)
    """Delays of the inputs of `taps`, multiples of the period [s]."""
    epochs: Annotated[int, COUNT] = 150
    """Largest number of passes over the data."""
    patience: Annotated[int, COUNT] = 20
    """Stop after this many passes without a smaller error on the validation trajectories."""
    learning_rate: Annotated[float, Range(0.0, 1.0, above=True)] = 5e-3
    """Initial learning rate, with cosine decay."""
    data: str = ""
    """Description of the logs, stored in the file; the logs' names by default."""
    seed: Annotated[int, SEED] = 1
    """Seed of the initial weights and the order of the data."""
    threads: Annotated[int, INDEX] = 0
    """CPU threads; 0 takes every CPU."""
    force: bool = False
    """Replace a file that exists."""


@dataclass(frozen=True)
class Show:
    """Plot step response, frequency response and torque-speed plane of networks and of the robot's PD motor."""

    files: tyro.conf.Positional[tuple[Path, ...]]
    """Files written by `arrive actuator fit`."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"]), PICTURE] = Path("motors.png")
    """Picture to write."""
    clip: Literal["affine", "constant", "none"] = "affine"
    """How the networks' torque is clipped, as in `physics.motor_clip`."""
    robot: str = "anymal_c"
    """Robot whose motor is plotted for comparison, and whose limits clip the torque."""
    joint: str | None = None
    """Joint of the robot whose motor that is; the first by default."""
    inertia: Annotated[float, POSITIVE] = 0.2
    """Inertia of the load in the step response, including the rotor [kg m^2]."""
    force: bool = False
    """Replace a file that exists."""


@dataclass(frozen=True)
class Import:
    """Convert an LSTM from plain arrays with PyTorch's names, such as legged_gym's, into a network file."""

    file: tyro.conf.Positional[Path]
    """NPZ file with `lstm.*`, `linear.*`, `in_scale` and `out_scale`."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"]), NETWORK] = Path("drive.safetensors")
    """File to write."""
    period_s: Annotated[float, PERIOD] = 0.005
    """Time between two calls of the network [s]."""
    data: str = ""
    """Description of the network, its authors and its licence; the file's name by default."""
    force: bool = False
    """Replace a file that exists."""


Action = (
    Annotated[Record, tyro.conf.subcommand("record")]
    | Annotated[Fit, tyro.conf.subcommand("fit")]
    | Annotated[Show, tyro.conf.subcommand("show")]
    | Annotated[Import, tyro.conf.subcommand("import")]
)


@dataclass(frozen=True)
class Actuator:
    """Record, fit, plot and import actuator networks, see docs/motors.md."""

    action: tyro.conf.OmitArgPrefixes[tyro.conf.OmitSubcommandPrefixes[Action]] = field()


def actuator(command: Actuator) -> None:
    """Run the chosen action."""
    match command.action:
        case Record() as action:
            record(action)
        case Fit() as action:
            fit(action)
        case Show() as action:
            show(action)
        case Import() as action:
            import_(action)


def record(options: Record) -> None:
    """Simulate drives and write their log."""
    import numpy as np

    from arrive.actuation.excitation import excite, random_load
    from arrive.actuation.series_elastic import FINE_STEP_S, SeriesElasticDrive, simulate
    from arrive.files import whole
    from arrive.room import check_room

    samples, fine = options.seconds / options.period_s, options.period_s / FINE_STEP_S
    if not (samples >= 2 and round(fine) >= 1 and math.isclose(fine, round(fine), rel_tol=1e-6)):
        raise ArriveError(f"--period-s must be a multiple of {FINE_STEP_S:g}, and --seconds at least two periods")
    steps = round(samples)
    check_room(options.joints * steps, BYTES_PER_SAMPLE, "samples", "--joints or --seconds")
    rng = np.random.default_rng(options.seed)
    targets = excite(rng, steps, options.joints, options.period_s)
    load = random_load(rng, steps, options.joints, options.period_s)
    log = simulate(SeriesElasticDrive(), targets, load, options.period_s)
    with whole(options.out) as file:
        if options.out.suffix == ".npz":
            np.savez(file, **log)  # type: ignore[arg-type]  # for NumPy, one of them could be `allow_pickle`
        else:
            _write_csv(file, log)
    print(f"log: {options.out} ({options.joints} joints, {steps * options.period_s:g} s, every {options.period_s:g} s)")


def _write_csv(path: Path, log: dict[str, np.ndarray]) -> None:
    """Write one row per sample and joint, one joint after the other."""
    names = [name for name in log if name != "time"]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["joint", "time", *names])
        for joint in range(log["target"].shape[1]):
            table = zip(log["time"], *(log[name][:, joint] for name in names), strict=True)
            writer.writerows([joint, *(f"{value:.7g}" for value in row)] for row in table)


def fit(options: Fit) -> None:
    """Train a network, write it, and print and plot its errors."""
    if not options.logs:
        raise ArriveError("name at least one log; `arrive actuator record` records one from a simulated drive")
    for log in options.logs:  # before torch is loaded, which takes seconds
        check_readable(log)
    from rich.progress import Progress, TextColumn

    from arrive.actuation import fit as fitting
    from arrive.actuation.logs import read_logs
    from arrive.actuation.network_file import write_network
    from arrive.actuation.pictures import draw_fit
    from arrive.commands.threads import use_threads

    use_threads(options.threads)
    trajectories = read_logs(options.logs, options.period_s)
    names = ("architecture", "units", "taps_s", "epochs", "patience", "learning_rate", "seed")
    config = fitting.FitConfig(**{name: getattr(options, name) for name in names})
    data = options.data or ", ".join(path.name for path in options.logs)
    with Progress(*Progress.get_default_columns(), TextColumn("{task.fields[error]}"), transient=True) as bar:
        task = bar.add_task("fitting", total=options.epochs, error="")

        def on_epoch(epoch: int, error_nm: float) -> None:
            bar.update(task, completed=epoch, error=f"{error_nm:.2f} N m")

        result = fitting.fit_network(trajectories, config, data, on_epoch)
    write_network(options.out, result.network)
    picture = options.out.with_suffix(".png")
    draw_fit(picture, result)
    _print_errors(result, len(trajectories))
    print(f"network: {options.out}, picture: {picture}")


def _print_errors(result: fitting.FitResult, trajectories: int) -> None:
    lines = (("network", result.errors), ("best PD law", result.pd_errors))
    print(f"{trajectories} trajectories, {result.epochs} epochs; on held-out trajectories:")
    for name, errors in lines:
        print(
            f"  {name}: RMS {errors.rms_nm:.2f} N m, {errors.share:.1%} of the range of {errors.range_nm:.0f} N m, "
            f"99 % within {errors.most_nm:.1f} N m"
        )
    print(f"  best PD law: {result.pd_gains[0]:.1f} N m/rad, {result.pd_gains[1]:.2f} N m s/rad")


def show(options: Show) -> None:
    """Plot networks and the PD motor."""
    if not options.files:
        raise ArriveError("name at least one network; `arrive actuator fit` trains one")
    from arrive.actuation.network_file import read_network
    from arrive.actuation.pictures import draw_responses
    from arrive.actuation.responses import network_drive, pd_drive
    from arrive.physics import PhysicsConfig
    from arrive.robots import get_robot

    motor = get_robot(options.robot).motor_of(options.joint)
    networks = {path: read_network(path) for path in options.files}
    drives = [network_drive(path.stem, network, options.clip) for path, network in networks.items()]
    drives.insert(1, pd_drive("PD motor", motor, PhysicsConfig().timestep_s, "affine"))
    draw_responses(options.out, drives, motor, options.inertia)
    for path, network in networks.items():
        units = "-".join(map(str, network.units))
        error = "not measured" if network.error_nm is None else f"{network.error_nm:.2f} N m RMS"
        print(f"{path}: {network.architecture} of {units} units every {network.period_s:g} s, error {error}")
        print(f"  {network.data}")
    print(f"picture: {options.out}")


def import_(options: Import) -> None:
    """Convert plain arrays into a network file."""
    from arrive.actuation.conversion import read_lstm_arrays
    from arrive.actuation.network_file import write_network

    network = read_lstm_arrays(options.file, options.period_s, options.data or options.file.name)
    write_network(options.out, network)
    print(f"network: {options.out} ({'-'.join(map(str, network.units))} units)")
