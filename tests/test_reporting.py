"""The display, the log, the curves, confidence intervals and pictures of a run."""

import io
import math
import os
import subprocess
import sys
import warnings
from dataclasses import replace
from types import SimpleNamespace

import imageio.v2 as imageio
import mujoco
import numpy as np
import pytest
from matplotlib.axes import Axes
from PIL import Image
from rich.console import Console

from arrive.errors import ArriveError
from arrive.evaluation.wilson import wilson_interval
from arrive.learning.curves import plot_curves
from arrive.learning.display import TrainingDisplay, level_bars, panel, plain_line
from arrive.learning.logs import RunLog, read_log
from arrive.learning.report import FamilyReport, IterationReport
from arrive.render import graphics, pictures


def make_report(iteration: int, **changes) -> IterationReport:
    """A report of an imaginary run of 100 iterations."""
    report = IterationReport(
        iteration=iteration,
        samples=24576 * iteration,
        elapsed_s=3.7 * iteration,
        budget=iteration / 100,
        time_left_s=3.7 * (100 - iteration),
        samples_per_s=6512.0,
        arrival=math.nan if iteration < 3 else 0.42,
        diverged_share=0.0,
        exploration_paid=float(iteration < 50),
        task_fraction=0.31,
        families={
            "flat": FamilyReport(0.9, 0.0, (64,)),
            "stairs": FamilyReport(0.27, 1.5, (8, 40, 16, 0)),
        },
        rewards={"final_position": 0.0712, "torque_cost": -0.0047},
        failures={"base_contact": 0.21, "too_far": 0.04},
        learning={"value_loss": 0.03, "action_std": 0.8, "learning_rate": 1e-3},
    )
    return replace(report, **changes)


def shown_in_terminal(report: IterationReport, width: int) -> str:
    console = Console(record=True, force_terminal=True, width=width, height=60, file=io.StringIO())
    with TrainingDisplay("anymal_c, stairs, quick", "runs/first", console) as display:
        display.update(report)
    return console.export_text()


@pytest.mark.parametrize("width", [80, 120, 200])
def test_the_panel_shows_the_figures_at_any_width(width):
    text = shown_in_terminal(make_report(40), width)
    for figure in ("anymal_c, stairs, quick", "runs/first", "40 %", "2:28 elapsed", "3:42 left", "983.04 k samples"):
        assert figure in text
    for figure in (
        "6,512/s",
        "42 %",
        "paid, task reward at 31 % of its maximum",
        "50 %",
        "1.5 of 3",
        "too_far",
        "+0.0712",
    ):
        assert figure in text
    console = Console(record=True, width=width, file=io.StringIO())
    console.print(panel(make_report(40), "anymal_c, stairs, quick", "runs/first"))
    lines = console.export_text().splitlines()
    assert {len(line) for line in lines} == {width}
    assert all(line[0] + line[-1] in ("╭╮", "││", "╰╯") for line in lines)


def test_the_panel_says_that_the_exploration_reward_is_gone():
    assert "removed" in shown_in_terminal(make_report(60), 80)


def test_the_panel_shows_a_run_of_which_nothing_is_known_yet():
    empty = make_report(0, families={}, rewards={}, failures={}, learning={}, time_left_s=math.inf)
    assert "- left" in shown_in_terminal(empty, 80)


def test_level_bars_are_tallest_at_the_commonest_level_and_pool_many_levels():
    assert level_bars((8, 40, 16, 0)).plain == "▃█▄▁"
    assert level_bars((0, 0)).plain == "▁▁"
    assert len(level_bars((1,) * 100).plain) <= 24


def test_a_pipe_gets_a_line_at_a_time_and_the_last_one():
    output = io.StringIO()
    with TrainingDisplay("title", "runs/first", Console(file=output, width=80)) as display:
        for iteration in range(1, 6):
            display.update(make_report(iteration))
    lines = output.getvalue().splitlines()
    assert [line.split(" |")[0] for line in lines] == ["title: runs/first", "iteration 1", "iteration 5"]
    assert "stairs 27 % level 1.5" in lines[-1]
    assert plain_line(make_report(5)).isascii()


def test_a_closed_output_ends_the_display_and_not_the_training():
    output = io.StringIO()
    with TrainingDisplay("title", "folder", Console(file=output), line_every_s=0.0) as display:
        output.close()
        with pytest.warns(RuntimeWarning, match="display stopped"):
            display.update(make_report(1))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            display.update(make_report(2))


def test_a_log_is_read_as_it_was_written(tmp_path):
    log = RunLog(tmp_path)
    for iteration in (1, 2, 3):
        log.write(make_report(iteration))
    log.close()
    columns = read_log(tmp_path)
    assert next(iter(columns)) == "iteration"
    assert columns["iteration"] == [1, 2, 3]
    assert columns["rewards/torque_cost"] == [-0.0047] * 3
    assert math.isnan(columns["arrival/all"][0])
    assert columns["arrival/all"][2] == 0.42


def test_a_new_figure_becomes_a_column_that_is_nan_before(tmp_path):
    log = RunLog(tmp_path)
    log.write(make_report(1))
    log.write(make_report(2, learning={"kl": 0.02}))
    log.close()
    columns = read_log(tmp_path)
    np.testing.assert_equal(columns["learning/kl"], [math.nan, 0.02])
    np.testing.assert_equal(columns["learning/value_loss"], [0.03, math.nan])
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["log.csv"]


def test_a_resumed_log_goes_on_from_its_checkpoint(tmp_path):
    log = RunLog(tmp_path)
    for iteration in range(1, 6):
        log.write(make_report(iteration, samples_per_s=1000.0))
    log.close()
    with (tmp_path / "log.csv").open("a") as file:
        file.write("6,0.1,0.")  # killed while writing
    log = RunLog(tmp_path)
    log.resume_at(3)
    log.write(make_report(4, samples_per_s=2000.0))
    log.close()
    columns = read_log(tmp_path)
    assert columns["iteration"] == [1, 2, 3, 4]
    assert columns["progress/samples_per_s"] == [1000, 1000, 1000, 2000]
    assert tensorboard_steps(tmp_path, "progress/samples_per_s") == [(1, 1000), (2, 1000), (3, 1000), (4, 2000)]


def tensorboard_steps(folder, name: str) -> list[tuple[int, float]]:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(folder / "tensorboard")).Reload()
    return [(event.step, event.value) for event in events.Scalars(name)]


def test_a_folder_without_a_log_is_an_error_that_names_it(tmp_path):
    with pytest.raises(ArriveError, match=r"no log\.csv"):
        read_log(tmp_path)


@pytest.mark.parametrize("iterations", [1, 60])
def test_curves_are_a_picture(tmp_path, iterations):
    log = RunLog(tmp_path)
    for iteration in range(1, iterations + 1):
        log.write(make_report(iteration))
    log.close()
    path = plot_curves(tmp_path)
    assert path == tmp_path / "curves.png"
    pixels = np.asarray(Image.open(path))
    assert min(pixels.shape[:2]) > 500
    assert pixels.std() > 5


def test_curves_shade_the_samples_in_which_the_exploration_reward_was_paid(tmp_path, monkeypatch):
    """The spans are read from the figure, the log is written as training writes it: paid to all, some, then none."""
    spans, shade = [], Axes.axvspan
    monkeypatch.setattr(Axes, "axvspan", lambda axes, *ends, **style: spans.append(ends) or shade(axes, *ends, **style))
    log = RunLog(tmp_path)
    for iteration, paid in enumerate((1.0, 0.5, 0.0, 0.0, 1.0), start=1):
        log.write(make_report(iteration, exploration_paid=paid))
    log.close()
    plot_curves(tmp_path)
    millions = 24576 / 1e6
    assert set(spans) == {(millions, 2 * millions), (5 * millions, 5 * millions)}


@pytest.mark.parametrize(
    ("successes", "trials", "interval"),
    [(0, 10, (0.0, 0.2775)), (10, 10, (0.7225, 1.0)), (50, 100, (0.4038, 0.5962)), (81, 263, (0.2553, 0.3662))],
)
def test_wilson_gives_published_values(successes, trials, interval):
    """The last row is from Newcombe (1998), Statistics in Medicine 17, 857, table I."""
    assert wilson_interval(successes, trials) == pytest.approx(interval, abs=5e-5)


def test_wilson_covers_the_truth_about_as_often_as_it_says():
    trials = 100
    intervals = [wilson_interval(successes, trials) for successes in range(trials + 1)]

    def coverage(share: float) -> float:
        chances = [math.comb(trials, k) * share**k * (1 - share) ** (trials - k) for k in range(trials + 1)]
        return sum(chance for chance, (low, high) in zip(chances, intervals, strict=True) if low <= share <= high)

    covered = [coverage(share) for share in np.linspace(0.05, 0.95, 181)]
    assert np.mean(covered) == pytest.approx(0.95, abs=0.005)
    assert min(covered) > 0.91


@pytest.mark.parametrize("measurement", [(1, 0, 0.95), (-1, 10, 0.95), (11, 10, 0.95), (5, 10, 1.0), (5, 10, 0.0)])
def test_wilson_refuses_nonsense(measurement):
    with pytest.raises(ValueError, match=r"measurement|confidence"):
        wilson_interval(*measurement)


def make_episode(target_radius: float = 0.5) -> pictures.Episode:
    """A box that slides 2 m over a plane, onto a step of 0.2 m."""
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><worldbody>
          <geom type="plane" size="0 0 0.1"/>
          <geom type="box" pos="2 0 0" size="0.5 1 0.2" rgba="0.6 0.5 0.4 1"/>
          <body pos="0 0 0.3"><freejoint/>
            <geom type="box" size="0.3 0.2 0.1" group="3" rgba="1 0 0 1"/></body>
        </worldbody></mujoco>""")
    qpos = np.zeros((51, 7))
    qpos[:, 0], qpos[:, 2], qpos[:, 3] = np.linspace(0, 2, 51), 0.5, 1.0
    return pictures.Episode(model, qpos, (2.0, 0.0, 0.5), target_radius, 0.02, "arrived", "box")


@pytest.fixture
def backend():
    try:
        return graphics.graphics_backend()
    except graphics.GraphicsUnavailable as missing:
        pytest.skip(str(missing))


def test_the_path_lies_on_the_ground():
    path = make_episode().ground_path_w
    np.testing.assert_allclose(path[[0, -2, -1], 2], [0.0, 0.2, 0.2], atol=1e-9)


def test_path_and_target_are_in_view_at_every_step():
    episode = make_episode()
    cameras = pictures._Cameras(episode, 16 / 9, 45.0)
    for step in (0, 25, 50):
        camera = cameras.at(step)
        eye = camera.lookat - camera.distance * pictures._axes(camera)[0]
        points = np.vstack([episode.qpos[:, :3], episode.target_w])
        forward, right, up = pictures._axes(camera) @ (points - eye).T
        tangent = math.tan(math.radians(22.5))
        assert (forward > 0).all()
        assert (abs(right) < forward * tangent * 16 / 9).all()
        assert (abs(up) < forward * tangent).all()


def test_a_strip_shows_robot_and_target(backend, tmp_path):
    pictures.picture_strip(make_episode(), tmp_path / "strip.png", frames=2)
    pixels = np.asarray(Image.open(tmp_path / "strip.png")).astype(int)
    red, green, blue = np.moveaxis(pixels, -1, 0)
    half = pixels.shape[1] // 2
    robot, target = (red > 2 * green) & (red > 2 * blue), (green > 1.5 * red) & (green > 1.5 * blue)
    assert robot[:, :half].sum() > 200
    assert robot[:, half:].sum() > 200
    assert target[:, :half].sum() > 100
    assert [path.name for path in tmp_path.iterdir()] == ["strip.png"]


def test_the_disc_is_where_robots_arrive(backend):
    """A disc of twice the radius has four times the area: green beside the step's brown, at the last step."""
    seen = []
    for radius in (0.25, 0.5):
        with pictures.open_stage(make_episode(radius), 400, 320) as stage:
            red, green, blue = np.moveaxis(stage.draw(50).astype(int), -1, 0)
        seen.append(((green > 1.05 * red) & (green > 1.05 * blue)).sum())
    assert seen[1] > 2 * seen[0] > 0


def test_a_film_plays_in_real_time(backend, tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "FILM_SIZE", (160, 120))
    pictures.film(make_episode(), tmp_path / "film.mp4", fps=10)
    with imageio.get_reader(tmp_path / "film.mp4") as reader:
        meta = reader.get_meta_data()
        assert meta["codec"] == "h264"
        assert meta["pix_fmt"].startswith("yuv420p")
        assert sum(1 for _ in reader) == 11  # its len() is infinite
        assert meta["duration"] == pytest.approx(1.1, abs=0.11)


def test_without_graphics_the_error_names_the_packages(tmp_path, monkeypatch):
    graphics.graphics_backend.cache_clear()
    monkeypatch.setattr(graphics.subprocess, "run", lambda *args, **options: SimpleNamespace(returncode=-11))
    with pytest.raises(graphics.GraphicsUnavailable, match=r"libosmesa6.*libegl1"):
        pictures.picture_strip(make_episode(), tmp_path / "strip.png")
    assert not any(tmp_path.iterdir())
    graphics.graphics_backend.cache_clear()


def test_without_the_bindings_of_opengl_the_error_is_the_same():
    """In a process of its own, in which nothing has been drawn yet and PyOpenGL cannot be imported."""
    code = """
import sys
sys.modules["OpenGL"] = None
from arrive.render import graphics
graphics.graphics_backend = lambda: "egl"
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco/>")
try:
    with graphics.open_renderer(model, 32, 32):
        pass
except graphics.GraphicsUnavailable as error:
    print(error)
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=60)
    assert "libosmesa6" in done.stdout, done.stderr
