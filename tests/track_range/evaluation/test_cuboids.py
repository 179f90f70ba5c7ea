"""Errors of measured cuboids against those of labels."""

import json
from dataclasses import replace

import numpy as np
import pytest

import track_range as tr
from tests.support.recordings.label_rows import F_PX, label_row
from track_range.evaluation.motion.cuboid_errors import (
    are_sides_seen,
    cuboid_errors,
    cuboid_figures,
    labelled_cuboids,
)

N_FRAMES = 30


def cuboids(centre_m, lwh_m, yaw_deg, *, front_known=True):
    """Cuboids of labels at rest, with sigmas of 0.1 m and 5 degrees."""
    n = len(yaw_deg)
    labels = labelled_cuboids(np.zeros((n, 3)), np.ones((n, 3)), np.zeros(n))
    return replace(
        labels,
        centre_m=np.array(centre_m, float),
        lwh_m=np.array(lwh_m, float),
        yaw_deg=np.array(yaw_deg, float),
        centre_sigma_m=np.full((n, 3), 0.1),
        lwh_sigma_m=np.full((n, 3), 0.1),
        yaw_sigma_deg=np.full(n, 5.0),
        front_known=np.full(n, front_known),
    )


def test_yaw_of_labels_is_counterclockwise_from_the_axis():
    """KITTI's rotation_y is 0 to the right and -90 degrees ahead, clockwise as seen from above."""
    turned = labelled_cuboids(
        np.array([[1.0, 2.0, 10.0]] * 3), np.array([[1.5, 1.8, 4.0]] * 3), np.radians([-90, 0, 180])
    )
    assert turned.yaw_deg == pytest.approx([0.0, -90.0, 90.0])  # ahead, right, left
    assert turned.centre_m[0] == pytest.approx([1.0, 1.25, 10.0])
    assert turned.lwh_m[0] == pytest.approx([4.0, 1.8, 1.5])
    assert are_sides_seen(turned).tolist() == [False, True, True]


def test_errors_by_hand():
    true = cuboids([[2.0, 1.0, 20.0], [-3.0, 1.0, 20.0]], [[4.0, 2.0, 1.5]] * 2, [0.0, 90.0])
    measured = cuboids([[2.1, 1.0, 20.5], [-3.0, 1.0, 20.5]], [[4.4, 1.8, 1.5]] * 2, [178.0, -88.0])
    errors = cuboid_errors(measured, true, is_moving=np.array([True, False]))
    assert errors["heading_deg"][0] == pytest.approx([178.0, 2.0])  # modulo 360, modulo 180
    assert np.abs(errors["heading_deg"][1]) == pytest.approx(
        [178 / 5, 178 / 5]
    )  # fronts are stated
    assert errors["length_pct"][0] == pytest.approx([10.0, 10.0])
    assert errors["length_pct"][1] == pytest.approx([4.0, 4.0])
    # edges towards the path: 2 - 1 = 1 and 2.1 - 0.9 - 2.2 sin 2 deg = 1.12; -3 + 2 = -1 and -3 + 2.23
    sin, cos = np.sin(np.radians(2.0)), np.cos(np.radians(2.0))
    first, second = 2.1 - 0.9 * cos - 2.2 * sin, -3.0 + 2.2 * cos + 0.9 * sin
    assert errors["nearest_side_m"][0] == pytest.approx([first - 1.0, -second - 1.0])
    assert errors["centre_m"][0] == pytest.approx([np.hypot(0.1, 0.5), 0.5])
    either = replace(measured, front_known=np.zeros(2, bool))
    folded = cuboid_errors(either, true, is_moving=np.array([True, False]))
    assert np.abs(folded["heading_deg"][1]) == pytest.approx([2 / 5, 2 / 5])
    cells = {"all": np.ones(2, bool), "none": np.zeros(2, bool)}
    figures = cuboid_figures(errors, cells, measured, true)
    assert figures["counts"]["all"] == {
        "n": 2,
        "coverage": 1.0,
        "front_known": 1.0,
        "front_right": 0.0,
    }
    assert figures["heading_deg"]["none"]["median"] is None
    assert figures["nearest_side_m"]["all"]["n"] == 2


def test_nearest_side_is_that_of_the_path_of_a_camera_that_looks_aside():
    """A camera 90 degrees to the right of its path: what is near across the path is near in z."""
    true = cuboids([[0.0, 1.0, 5.0]], [[4.0, 2.0, 1.5]], [90.0])  # along the path
    nearer = replace(true, centre_m=true.centre_m - [0.0, 0.0, 0.3])
    aside = cuboid_errors(nearer, true, is_moving=np.array([True]), axis_rad=-np.pi / 2)
    assert aside["nearest_side_m"][0] == pytest.approx([-0.3])
    assert cuboid_errors(nearer, true, is_moving=np.array([True]))["nearest_side_m"][0] == 0.0


@pytest.fixture
def drive(tmp_path):
    """Labels, calibration and poses of a car at rest beside the path, and one that drives ahead."""
    for name in ("labels", "calib", "poses"):
        (tmp_path / name).mkdir()
    times_s = 0.1 * np.arange(N_FRAMES)
    rows = []
    for frame, t in enumerate(times_s):
        rows += [label_row(frame, 1, "Car", 40.0 - 10.0 * t, x_m=3.0)]
        rows += [label_row(frame, 2, "Car", 20.0 - 2.0 * t)]
    (tmp_path / "labels/0001.txt").write_text("\n".join(rows) + "\n")
    (tmp_path / "calib/0001.txt").write_text(f"P2: {F_PX} 0 600 0 0 {F_PX} 180 0 0 0 1 0\n")
    poses = "\n".join(f"1 0 0 0 0 1 0 0 0 0 1 {10.0 * t}" for t in times_s)
    (tmp_path / "poses/0001.txt").write_text(poses + "\n")
    return {name: tmp_path / name for name in ("labels", "calib", "poses")}


def test_labelled_drive(drive, cli, tmp_path):
    figures = tr.evaluate.cuboids(**drive)
    cells = figures["cuboids"]["counts"]
    assert cells["vehicles"]["n"] == figures["n_boxes"]
    assert 0 < cells["moving"]["n"] < cells["vehicles"]["n"]
    assert cells["moving"]["coverage"] == 1.0
    assert figures["cuboids"]["heading_deg"]["moving"]["median"] < 5.0
    result = cli(
        "evaluate",
        "cuboids",
        *(value for name, path in drive.items() for value in (f"--{name}", path)),
        *("--json", tmp_path / "cuboids.json"),
    )
    assert result.status == 0
    assert "Nearest side, m" in result.stdout
    assert json.loads((tmp_path / "cuboids.json").read_text())["cuboids"] == figures["cuboids"]


@pytest.mark.real
def test_given_logs_are_measured_in_all_cells(shared_data):
    folder = shared_data / "av2"
    figures = tr.evaluate.cuboids(
        folder / "label_shape",
        calib=folder / "calib",
        poses=folder / "poses",
        region="north-america",
    )
    errors = figures["cuboids"]
    assert errors["counts"]["vehicles"]["n"] > 1000
    assert errors["counts"]["moving"]["coverage"] > 0.95
    assert errors["heading_deg"]["cars, moving"]["median"] < 8.0
    assert errors["length_pct"]["moving, side seen"]["median"] < 15.0
