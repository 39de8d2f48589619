"""From a drive to a network: the simulated drive, its logs, fitting, and the responses that are drawn."""

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from arrive.actuation import series_elastic
from arrive.actuation.excitation import excite, random_load
from arrive.actuation.fit import FitConfig, fit_network, predict, split_trajectories
from arrive.actuation.logs import COLUMNS, Trajectory, read_logs
from arrive.actuation.network_file import read_network, write_network
from arrive.actuation.responses import (
    DriveModel,
    frequency_response,
    loaded_step,
    locked_step,
    pd_drive,
    torque_at_speed,
)
from arrive.actuation.series_elastic import Load, SeriesElasticDrive, simulate
from arrive.errors import ArriveError
from arrive.robots import get_robot

PERIOD = 0.005
MOTOR = get_robot("anymal_c").motors[0]
DRIVE = SeriesElasticDrive()


def load(inertia: float, steps: int, push: float = 0.0) -> Load:
    return Load(np.array([inertia]), np.zeros(1), np.zeros(1), np.full((steps, 1), push))


def jump(size: float, steps: int, inertia: float, drive: SeriesElasticDrive = DRIVE) -> dict[str, np.ndarray]:
    """A drive at rest whose target jumps in the second period."""
    targets = np.full((steps, 1), size)
    targets[0] = 0.0
    return {
        name: array[1:, 0]
        for name, array in simulate(drive, targets, load(inertia, steps), PERIOD).items()
        if name != "time"
    }


def recorded(joints: int, seconds: float, seed: int = 1) -> dict[str, np.ndarray]:
    rng, steps = np.random.default_rng(seed), round(seconds / PERIOD)
    targets = excite(rng, steps, joints, PERIOD)
    return simulate(DRIVE, targets, random_load(rng, steps, joints, PERIOD), PERIOD)


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("log") / "log.npz"
    np.savez(path, **recorded(15, 8.0))
    return path


class TestSimulatedDrive:
    def test_torque_of_a_locked_joint_follows_the_position_loop_with_a_delay(self):
        """80 N m/rad x 0.3 rad = 24 N m, the friction's share of it less at most; nothing for the first 4 ms."""
        torque = jump(0.3, 40, inertia=1e9)["torque"]
        assert torque[0] < 0.5
        assert torque[1] < 12.0
        np.testing.assert_allclose(torque[10:], 24.0, atol=DRIVE.coulomb_friction / (1.0 + DRIVE.torque_gain))

    def test_torque_is_limited_by_current_and_voltage(self):
        """A heavy load after a far target: no more than 15 A give, and no faster than the supply allows."""
        path = jump(20.0, 200, inertia=5.0)
        most = DRIVE.gear_ratio * DRIVE.torque_constant * DRIVE.current_limit
        assert 70.0 < path["torque"].max() < most
        assert 0.8 * DRIVE.no_load_speed < path["velocity"].max() < DRIVE.no_load_speed
        weak = jump(20.0, 200, inertia=5.0, drive=replace(DRIVE, current_limit=5.0))
        assert weak["torque"][20:60].mean() < most / 3 < path["torque"][20:60].mean()

    @pytest.mark.parametrize(("push", "slowest", "fastest"), [(3.0, 0.0, 0.1), (8.0, 1.0, 10.0)])
    def test_friction_holds_a_drive_without_current(self, push, slowest, fastest):
        """4 N m of it: a push of 3 N m makes it creep, one of 8 N m turns it; for half a second."""
        drive, steps = replace(DRIVE, current_limit=0.0), 100
        velocity = simulate(drive, np.zeros((steps, 1)), load(0.2, steps, push), PERIOD)["velocity"]
        assert slowest < np.abs(velocity[-20:]).mean() < fastest

    def test_a_shorter_step_gives_the_same_result(self, monkeypatch):
        coarse = jump(0.5, 80, inertia=0.1)
        monkeypatch.setattr(series_elastic, "FINE_STEP_S", series_elastic.FINE_STEP_S / 4)
        fine = jump(0.5, 80, inertia=0.1)
        np.testing.assert_allclose(coarse["torque"], fine["torque"], atol=0.03 * np.ptp(fine["torque"]))
        np.testing.assert_allclose(coarse["position"], fine["position"], atol=0.01)

    def test_the_excitation_reaches_torques_speeds_and_frequencies_of_a_leg(self):
        seen = recorded(15, 4.0)
        assert np.abs(seen["torque"]).max() > 70.0
        assert np.abs(seen["velocity"]).max() > 7.0
        power = np.abs(np.fft.rfft(seen["target"] - seen["target"].mean(0), axis=0)) ** 2
        frequencies = np.fft.rfftfreq(len(seen["time"]), PERIOD)
        assert power[frequencies > 5.0].sum() > 0.02 * power.sum()
        again = recorded(15, 4.0)
        assert all(np.array_equal(seen[name], again[name]) for name in seen)


def write_csv(path: Path, rows: list[list], header: tuple[str, ...] = COLUMNS) -> Path:
    path.write_text("\n".join(",".join(map(str, row)) for row in [header, *rows]) + "\n")
    return path


def good_rows(count: int = 20) -> list[list]:
    return [[round(i * PERIOD, 6), 0.1 * i, 0.09 * i, 1.0, 0.8 * i] for i in range(count)]


class TestLogs:
    def test_joints_of_csv_and_npz_are_the_same(self, tmp_path):
        arrays = recorded(2, 0.5)
        np.savez(tmp_path / "log.npz", **arrays)
        rows = [
            [f"LF_{joint}", time, *(arrays[name][step, joint] for name in COLUMNS[1:])]
            for joint in range(2)
            for step, time in enumerate(arrays["time"])
        ]
        write_csv(tmp_path / "log.csv", rows, ("joint", *COLUMNS))
        for first, second in zip(
            read_logs([tmp_path / "log.npz"], PERIOD), read_logs([tmp_path / "log.csv"], PERIOD), strict=True
        ):
            for name in COLUMNS[1:]:
                np.testing.assert_array_equal(getattr(first, name), getattr(second, name))

    def test_a_faster_log_is_subsampled(self, tmp_path):
        path = write_csv(tmp_path / "log.csv", good_rows(21))
        (trajectory,) = read_logs([path], 4 * PERIOD)
        np.testing.assert_allclose(trajectory.torque, 0.8 * np.arange(0, 21, 4))
        np.testing.assert_allclose(trajectory.error, 0.01 * np.arange(0, 21, 4))
        assert trajectory.period_s == 4 * PERIOD

    @pytest.mark.parametrize(
        ("row", "column", "value", "message"),
        [
            (3, 4, "nan", "row 5, column torque: 'nan' is no finite number"),
            (0, 1, "", "row 2, column target: '' is no finite number"),
            (7, 3, "fast", "row 9, column velocity: 'fast' is no finite number"),
            (7, 3, "9" * 5000, f"row 9, column velocity: '{'9' * 59} is no finite number"),
            (5, 0, 0.035, "row 7, column time: 0.015 s after the row before, where the period is 0.005 s"),
            (5, 0, 0.02, "row 7, column time: 0 s after the row before"),
            (3, 4, "1_0", "row 5, column torque: '1_0' is no finite number"),
            (3, 4, 1e30, "row 5, column torque: 1e.30 is beyond 100000: is it in another unit?"),
            (3, 2, -5730.0, "row 5, column position: -5730 is beyond 1000: is it in another unit?"),
        ],
    )
    def test_a_bad_value_is_named_with_its_row(self, row, column, value, message, tmp_path):
        rows = good_rows()
        rows[row][column] = value
        path = write_csv(tmp_path / "log.csv", rows)
        with pytest.raises(ArriveError, match=message) as raised:
            read_logs([path], PERIOD)
        assert str(raised.value).startswith(f"{path}, row")
        assert "\n" not in str(raised.value)

    def test_other_faults_are_named(self, tmp_path):
        path = tmp_path / "log.csv"
        for rows, header, message in (
            (
                good_rows(),
                ("time", "target", "position", "velocity", "current"),
                "no column torque; it has time, target",
            ),
            ([*good_rows(), [0.1, 0.2]], COLUMNS, "row 22: 2 values where the header has 5 columns"),
            ([], COLUMNS, "no rows below the header"),
            ([[0.0, *row] for row in good_rows()], ("time", *COLUMNS), "more than one column time"),
            (good_rows(1), COLUMNS, "a single row is no log"),
        ):
            write_csv(path, rows, header)
            with pytest.raises(ArriveError, match=message):
                read_logs([path], PERIOD)
        write_csv(path, good_rows())
        with pytest.raises(ArriveError, match=r"period of 0.005 s does not divide the 0.0075 s"):
            read_logs([path], 0.0075)
        with pytest.raises(ArriveError, match="cannot read"):
            read_logs([tmp_path / "none.csv"], PERIOD)

    def test_faults_of_npz_files_are_named(self, tmp_path):
        path, arrays = tmp_path / "log.npz", recorded(3, 0.2)
        np.savez(path, **{name: array for name, array in arrays.items() if name != "velocity"})
        with pytest.raises(ArriveError, match="no column velocity; it has time, target, position, torque"):
            read_logs([path], PERIOD)
        bad = arrays["position"].copy()
        bad[11, 2] = np.inf
        np.savez(path, **arrays | {"position": bad})
        with pytest.raises(ArriveError, match="row 11, column position: inf is no finite number"):
            read_logs([path], PERIOD)
        np.savez(path, **arrays | {"torque": arrays["torque"][:, :2]})
        with pytest.raises(ArriveError, match=r"column torque is \(40, 2\), where target is \(40, 3\)"):
            read_logs([path], PERIOD)
        np.savez(path, **{name: array[:0] for name, array in arrays.items()})
        with pytest.raises(ArriveError, match="its columns are empty"):
            read_logs([path], PERIOD)
        np.savez(path, **arrays)
        whole = path.read_bytes()
        read_logs([path], PERIOD)
        path.write_bytes(whole + b"\0" * 10)
        with pytest.raises(ArriveError, match="bytes follow the end"):
            read_logs([path], PERIOD)
        path.write_bytes(whole)
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr("target", b"no array")
        with pytest.raises(ArriveError, match="'target' is no array"):
            read_logs([path], PERIOD)
        path.write_bytes(b"PK nothing")
        with pytest.raises(ArriveError, match="cannot read"):
            read_logs([path], PERIOD)


class TestFit:
    CONFIG = FitConfig("taps", units=(24, 24), epochs=60, patience=60, learning_rate=1e-2)

    def test_predicts_held_out_torque_within_5_percent_of_its_range(self, log, tmp_path):
        """And better than the best PD law can; measured by the arithmetic and the file that simulation uses."""
        result = fit_network(read_logs([log], PERIOD), self.CONFIG, "test")
        assert result.errors.share < 0.05
        assert result.errors.rms_nm < 0.6 * result.pd_errors.rms_nm
        write_network(tmp_path / "drive.safetensors", result.network)
        network = read_network(tmp_path / "drive.safetensors", PERIOD)
        off = np.concatenate([predict(network, each) - each.torque for each in result.test])
        assert network.error_nm == pytest.approx(np.sqrt(np.mean(off**2)))
        assert network.data == "test"

    def test_the_same_seed_gives_the_same_network_whatever_the_held_out_torque(self, log):
        config = replace(self.CONFIG, architecture="lstm", units=(3,), epochs=2)
        trajectories = read_logs([log], PERIOD)
        held_out = {each.name for each in split_trajectories(trajectories).test}
        assert len(held_out) == 3
        other = [replace(t, torque=-t.torque) if t.name in held_out else t for t in trajectories]
        first, second = (fit_network(logs, config).network.weights for logs in (trajectories, other))
        assert all(np.array_equal(first[name], second[name]) for name in first)

    def test_stops_early_where_there_is_nothing_to_learn(self):
        rng = np.random.default_rng(0)
        noise = [Trajectory(str(i), PERIOD, *rng.normal(0, 1, (4, 400))) for i in range(5)]
        result = fit_network(noise, replace(self.CONFIG, epochs=200, patience=3))
        assert result.epochs < 100
        assert result.errors.rms_nm == pytest.approx(1.0, abs=0.3)

    def test_a_single_log_is_cut_in_time_and_a_short_one_refused(self):
        ramp = np.arange(1000.0)
        split = split_trajectories([Trajectory("one", PERIOD, ramp, ramp, ramp, ramp)])
        parts = [part[0].torque for part in (split.train, split.validation, split.test)]
        assert [len(part) for part in parts] == [600, 200, 200]
        np.testing.assert_array_equal(np.concatenate(parts), ramp)
        with pytest.raises(ArriveError, match=r"too short: each part needs 1 s in one piece, and one has 0\.5 s"):
            split_trajectories([Trajectory("one", PERIOD, *[ramp[:500]] * 4)])

    def test_a_torque_that_is_always_zero_is_refused(self):
        still = [Trajectory(str(i), PERIOD, *np.ones((3, 400)), np.zeros(400)) for i in range(5)]
        with pytest.raises(ArriveError, match="is zero throughout the logs"):
            fit_network(still, self.CONFIG)


class TestResponses:
    """Of drives whose responses are known."""

    PD = pd_drive("PD", MOTOR, PERIOD, "affine")

    @staticmethod
    def late(joints: int):
        past = [np.zeros(joints)] * 2

        def law(error_rad: np.ndarray, velocity: np.ndarray) -> np.ndarray:
            past.append(80.0 * error_rad)
            return past.pop(0)

        return law

    def test_a_pd_law_has_no_delay(self):
        np.testing.assert_allclose(locked_step(self.PD, MOTOR, 0.3, 0.05)[1], 24.0)
        np.testing.assert_allclose(frequency_response(self.PD, np.array([0.7, 9.0, 40.0]), 0.1), 80.0, atol=1e-6)

    def test_a_delay_of_two_periods_shows_as_a_phase(self):
        frequencies = np.array([1.0, 7.3, 20.0])
        answer = frequency_response(DriveModel("late", self.late, PERIOD, "none"), frequencies, 0.1)
        np.testing.assert_allclose(answer, 80.0 * np.exp(-2j * np.pi * frequencies * 2 * PERIOD), atol=1e-6)

    def test_a_load_swings_at_its_natural_frequency(self):
        """Without damping's 2 N m s/rad it would be sqrt(80 / 0.2) = 20 rad/s; damped by a fraction 0.25, 19.4."""
        time, position = loaded_step(self.PD, MOTOR, 0.1, 0.2, 1.0)
        peak = time[position.argmax()]
        assert peak == pytest.approx(np.pi / 19.4, abs=2 * PERIOD)
        assert position[-1] == pytest.approx(0.1, abs=0.005)

    def test_torque_at_a_speed_by_hand(self):
        """80 * 1.5 - 2 * 5 = 110 N m asked for, 120 * (1 - 5 / 7.5) = 40 available."""
        free, cut = torque_at_speed(self.PD, MOTOR, 1.5, np.array([5.0, -5.0, 0.0]))
        np.testing.assert_allclose(free, [110.0, 130.0, 120.0])
        np.testing.assert_allclose(cut, [40.0, 80.0, 80.0])
