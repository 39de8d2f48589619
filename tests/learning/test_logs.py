"""A run's log: written, read and continued by a resumed run."""

import math

import numpy as np
import pytest

from arrive.errors import ArriveError
from arrive.learning.logs import RunLog, read_log
from reports import make_report


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


def test_a_new_metric_becomes_a_column_that_is_nan_before(tmp_path):
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
