"""The pictures: of a training run, and of size curves."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from track_range.report.figures import training_chart


def colours(path: Path) -> set[tuple[int, ...]]:
    picture = cv2.imread(str(path))
    assert picture is not None
    return {tuple(int(value) for value in colour) for colour in np.unique(picture.reshape(-1, 3), axis=0)}


def test_a_training_chart_shows_losses_and_precision(tmp_path: Path) -> None:
    history = [
        {"epoch": e, "loss_box": 1.0 / e, "loss_class": 2.0 / e, "ap50": 0.1 * e, "ap50_95": 0.05 * e}
        for e in (1, 2, 3)
    ]
    training_chart(history, tmp_path / "chart.png")
    blue, orange = (180, 119, 31), (14, 127, 255)  # BGR of the first two lines of each panel
    assert {blue, orange} <= colours(tmp_path / "chart.png")


def test_a_single_epoch_and_what_was_not_measured_are_fine(tmp_path: Path) -> None:
    training_chart([{"epoch": 1, "loss_box": 1.0, "ap50": float("nan")}], tmp_path / "chart.png")
    assert (180, 119, 31) in colours(tmp_path / "chart.png")


def test_without_an_epoch_there_is_no_chart(tmp_path: Path) -> None:
    training_chart([], tmp_path / "chart.png")
    assert list(tmp_path.iterdir()) == []
