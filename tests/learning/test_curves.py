"""The picture of a run's log."""

import numpy as np
import pytest
from matplotlib.axes import Axes
from PIL import Image

from arrive.learning.curves import plot_curves
from arrive.learning.logs import RunLog
from reports import make_report


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
