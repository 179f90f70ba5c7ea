"""poses.csv: rows of known poses, the last frame discarded."""

import csv

import pytest

from tests.support.results.frame_results import changed, result, writing
from track_range.ranging.world.ego_path import EgoPose


def test_rows_of_known_poses(tmp_path):
    with writing(tmp_path, ("poses",)) as rows:
        rows.write(changed(result(0), ego_pose=EgoPose()))
        rows.write(result(4))
        rows.write(result(5))
        rows.discard_last()
        rows.write(changed(result(6), ego_pose=EgoPose()))
    with (tmp_path / "poses.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert row == {
        "frame": "4",
        "time_s": "0.400000",
        "x_m": "8.000",
        "y_m": "-1.000",
        "heading_deg": "-28.648",
        "x_sigma_m": "0.200",
        "y_sigma_m": "0.100",
        "heading_sigma_deg": "0.573",
        "speed_mps": "10.000",
        "speed_sigma_mps": "",
    }
    assert float(row["heading_deg"]) == pytest.approx(-0.5 * 57.29578, abs=1e-3)
