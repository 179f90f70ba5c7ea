"""Charts of training runs, and reliability diagrams."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from track_range.detection.evaluation.score_calibration import Reliability, ScoreCalibration
from track_range.views.report.figures import (
    RELIABLE_BIN,
    reliability_chart,
    reliability_figure,
    training_chart,
    training_figure,
)

HISTORY = [
    {"epoch": e, "loss_box": 1.0 / e, "loss_class": 2.0 / e, "ap50": 0.1 * e, "ap50_95": 0.05 * e}
    for e in (1, 2, 3)
]


def curves(figure: Figure) -> list[dict[str, tuple[list[float], list[float]]]]:
    """By panel and label: the x and the y values of a line."""
    return [
        {
            str(line.get_label()): (list(line.get_xdata()), list(line.get_ydata()))
            for line in axes.lines
        }
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
    rows = [
        {"epoch": 1, "loss_box": 1.0, "ap50": float("nan")},
        {"epoch": 2, "loss_box": 0.5, "ap50": 0.4},
    ]
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


def calibration_of(n_per_bin: int) -> dict[str, Any]:
    """Two bins of scores, 0.25 and 0.75, of which 40 and 80 % are true; 50 detections of cars, few
    of buses."""
    score = np.repeat([0.25, 0.75], 25)
    cars = Reliability.of(
        score, np.tile(np.arange(25) < 10, 2) | ((score > 0.5) & np.tile(np.arange(25) < 20, 2))
    )
    buses = Reliability.of(np.full(n_per_bin, 0.5), np.ones(n_per_bin, np.bool_))
    return ScoreCalibration(0.05, cars, {2: cars, 4: buses}).as_dict()


def test_reliability_diagram() -> None:
    figure = reliability_figure(
        {"a": calibration_of(RELIABLE_BIN), "b": calibration_of(RELIABLE_BIN - 1)}
    )
    first, first_counts, second, _ = curves(figure)
    expected = (
        [pytest.approx(0.25), pytest.approx(0.75)],
        [pytest.approx(0.4), pytest.approx(0.8)],
    )
    assert first["all classes"] == first["car"] == second["car"] == expected
    assert first["calibrated"] == ([0, 1], [0, 1])
    assert first["bus"] == ([0.5], [1.0])
    assert "bus" not in second  # too few
    assert first_counts == {}
    bars = [bar.get_height() for bar in figure.axes[1].patches]
    assert (bars[2], bars[7], bars[12], bars[17]) == (25, 25, 10, 20)
    assert [axes.get_title() for axes in figure.axes] == ["a", "", "b", ""]
    (interval,) = figure.axes[0].collections
    low, high = interval.get_segments()[0][:, 1]
    # Wilson: 10 of 25
    assert (low, high) == (pytest.approx(0.2340, abs=1e-3), pytest.approx(0.5926, abs=1e-3))


@pytest.mark.parametrize("n_models", [1, 5])
def test_reliability_chart_of_any_number_of_models(tmp_path: Path, n_models: int) -> None:
    empty = ScoreCalibration(0.05, Reliability.of(np.zeros(0), np.zeros(0, np.bool_)), {}).as_dict()
    reliability_chart({f"model {i}": empty for i in range(n_models)}, tmp_path / "f.svg")
    text = (tmp_path / "f.svg").read_text()
    assert "<svg" in text
