"""The camera that labels with 2-D and 3-D boxes determine, whatever a run believes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from track_range.foundation.arrays import FloatArray
from track_range.ranging.truth.truth import Truth, TruthChoices, read_truth
from track_range.stereo.geometry.camera import PinholeCamera

SIZE_PX = (1242, 375)
TRUE = PinholeCamera(721.5, 721.5, 609.6, 172.9, *SIZE_PX)
OF_RUN = PinholeCamera(904.0, 904.0, 620.5, 187.0, *SIZE_PX)
SHIFT_M = np.array([0.06, 0.0, 0.0])
HEIGHT_M, WIDTH_M, LENGTH_M = 1.5, 1.7, 4.2
NO_SHIFT = np.zeros(3)


def label(frame: int, centre_m: Sequence[float], yaw_rad: float, *, noise_px: FloatArray) -> str:
    """A label whose 2-D box is the outline of its 3-D box, moved by the noise of its sides."""
    x, y, z = centre_m
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    corners = np.array(
        [
            (x + cos * a + sin * b, y - up, z - sin * a + cos * b)
            for a in (-LENGTH_M / 2, LENGTH_M / 2)
            for b in (-WIDTH_M / 2, WIDTH_M / 2)
            for up in (0.0, HEIGHT_M)
        ]
    )
    pixels = TRUE.project(corners + SHIFT_M)
    sides = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)]) + noise_px
    numbers = [*sides, HEIGHT_M, WIDTH_M, LENGTH_M, x, y, z, yaw_rad]
    return f"{frame} 0 Car 0 0 0 " + " ".join(f"{number:.4f}" for number in numbers)


def written(path: Path, *, n: int, noise_px: float) -> Path:
    """Labels of a car at n places."""
    rng = np.random.default_rng(0)
    rows = []
    for frame in range(n):
        centre_m = rng.uniform(-8, 8), rng.uniform(1.4, 1.9), rng.uniform(12, 25)
        yaw_rad = rng.uniform(-3, 3)
        rows.append(label(frame, centre_m, yaw_rad, noise_px=rng.normal(0, noise_px, 4)))
    path.write_text("\n".join(rows) + "\n")
    return path


def truths(path: Path, calib: Path | None = None) -> tuple[Truth, Truth]:
    """The ground truth of a run with the right camera, and of one with another camera."""
    given = TruthChoices(calib=calib)
    return read_truth(path, TRUE, SHIFT_M, given), read_truth(path, OF_RUN, NO_SHIFT, given)


def test_true_distances_do_not_depend_on_the_camera_of_the_run(tmp_path: Path) -> None:
    right, other = truths(written(tmp_path / "0005.txt", n=40, noise_px=0.3))
    np.testing.assert_array_equal(right.distance_m, other.distance_m)
    assert not other.notes
    # as with the true camera: too few labels show none, which the reading of each alone shows
    for row, line in enumerate((tmp_path / "0005.txt").read_text().splitlines()):
        (tmp_path / "one.txt").write_text(line)
        alone = read_truth(tmp_path / "one.txt", TRUE, SHIFT_M)
        assert right.distance_m[row] == pytest.approx(alone.distance_m[0], abs=0.05)


def test_few_labels_take_the_camera_of_the_run_with_a_note(tmp_path: Path) -> None:
    right, other = truths(written(tmp_path / "0005.txt", n=5, noise_px=0.0))
    assert not np.array_equal(right.distance_m, other.distance_m, equal_nan=True)
    assert "--truth-calib" in other.notes[0]


def test_boxes_that_are_no_outlines_of_3d_boxes_take_the_camera_of_the_run(tmp_path: Path) -> None:
    _, other = truths(written(tmp_path / "0005.txt", n=40, noise_px=9.0))
    assert "--truth-calib" in other.notes[0]


def test_calibration_of_the_labels(tmp_path: Path) -> None:
    calib = tmp_path / "calib.txt"
    # the reference camera is 6 cm to the right of the left colour camera, P2
    rows = {f"P{number}": (721.5, 0.06 * 721.5 * (number == 2)) for number in range(4)}
    rows["P1"], rows["P3"] = (721.5, -385.0), (721.5, -340.0)
    calib.write_text(
        "\n".join(
            f"{name}: {f} 0 609.6 {shift} 0 {f} 172.9 0 0 0 1 0"
            for name, (f, shift) in rows.items()
        )
    )
    right, other = truths(written(tmp_path / "0005.txt", n=5, noise_px=0.0), calib=calib)
    np.testing.assert_array_equal(right.distance_m, other.distance_m)
    assert not other.notes
    exact = read_truth(tmp_path / "0005.txt", TRUE, SHIFT_M)
    np.testing.assert_allclose(right.distance_m, exact.distance_m, atol=1e-6)
