"""The chart of a training run."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from track_range.report.figures import training_chart, training_figure

HISTORY = [
    {"epoch": e, "loss_box": 1.0 / e, "loss_class": 2.0 / e, "ap50": 0.1 * e, "ap50_95": 0.05 * e} for e in (1, 2, 3)
]


def curves(figure: Figure) -> list[dict[str, tuple[list[float], list[float]]]]:
    """By panel and label: the x and the y values of a line."""
    return [
        {str(line.get_label()): (list(line.get_xdata()), list(line.get_ydata())) for line in axes.lines}
        for axes in figure.axes
    ]


def test_losses_above_precision_in_percent_below() -> None:
    losses, precision = curves(training_figure(HISTORY))
    assert losses == {
        "box": ([1, 2, 3], pytest.approx([1.0, 0.5, 1 / 3])),
        "class": ([1, 2, 3], pytest.approx([2.0, 1.0, 2 / 3])),
    }
    assert precision == {
        "mean": ([1, 2, 3], pytest.approx([10.0, 20.0, 30.0])),
        "mean, AP50-95": ([1, 2, 3], pytest.approx([5.0, 10.0, 15.0])),
    }


def test_epochs_without_validation_are_left_out() -> None:
    rows = [{"epoch": 1, "loss_box": 1.0, "ap50": float("nan")}, {"epoch": 2, "loss_box": 0.5, "ap50": 0.4}]
    _, precision = curves(training_figure(rows))
    assert precision == {"mean": ([2], [40.0])}


@pytest.mark.slow
def test_chart_is_a_picture_of_the_figure(tmp_path: Path) -> None:
    training_chart(HISTORY[:1], tmp_path / "chart.png")
    picture = cv2.imread(str(tmp_path / "chart.png"))
    assert picture.shape == (770, 1045, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 2


def test_no_chart_without_an_epoch(tmp_path: Path) -> None:
    training_chart([], tmp_path / "chart.png")
    assert list(tmp_path.iterdir()) == []
