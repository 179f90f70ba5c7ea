"""Map of the drive: paths and parked road users from rows and poses."""

from dataclasses import replace

import numpy as np
import pytest

from tests.track_range.views.report.report_rows import columns, summary
from track_range.results.formats.poses_file import Poses, read_poses
from track_range.results.rows.rows import Rows
from track_range.views.report.content.drive_map import drive_map
from track_range.views.report.page import report_page


def poses(n=30):
    step = np.arange(n, dtype=np.float64)
    return Poses(step, 0.1 * step, 1.5 * step, 0.1 * step, 0 * step, np.zeros((n, 3)))


def rows(*lengths, state="moving", sigma_m=1.0):
    """Rows of tracks whose positions move by (1, -1) m per row, from (20, 2)."""
    given = columns(*lengths)
    n = len(given["frame"])
    number = np.concatenate([np.arange(length, dtype=np.float64) for length in lengths])
    placed = {"world_x_m": 20.0 + number, "world_y_m": 2.0 - number, "state": np.full(n, state)}
    filtered = {"fused_kf_m": np.full(n, 30.0), "fused_kf_sigma_m": np.full(n, sigma_m)}
    return Rows({**given, **placed, **filtered})


def unpacked(text):
    return np.cumsum([float(cell) for cell in text.split(",")]) / 100


def test_paths_of_camera_and_tracks():
    found = drive_map(rows(9, 7), poses())
    np.testing.assert_allclose(unpacked(found["ego"]["x"]), 1.5 * np.arange(30))
    np.testing.assert_allclose(unpacked(found["ego"]["y"]), 0.1 * np.arange(30))
    assert [len(track["x"].split(",")) for track in found["tracks"]] == [9, 7]
    np.testing.assert_allclose(unpacked(found["tracks"][0]["y"]), 2.0 - np.arange(9))
    assert "at" not in found["tracks"][0]


def test_parked_road_users_are_at_the_median_of_their_positions():
    (track,) = drive_map(rows(9, state="parked"), poses())["tracks"]
    assert track["at"] == [24.0, -2.0]


def test_footprints_of_parked_road_users():
    """At the middle of the cuboid, with its axis and size; the camera turned by 10 degrees."""
    given = rows(9, state="parked").columns
    number = np.arange(9.0)
    sizes = {"length": 4.0 + (number == 8), "width": np.full(9, 1.8), "height": np.full(9, 1.5)}
    sigmas = {f"{side}_sigma_m": np.where(number == 8, 0.1, 1.0) for side in sizes}
    places = {"centre_world_x_m": given["world_x_m"] + 2.0, "centre_world_y_m": np.full(9, -2.0)}
    yaw = {"yaw_deg": np.where(number % 3 == 0, -155.0, 25.0)}
    lengths = {f"{side}_m": values for side, values in sizes.items()}
    turned = replace(poses(), heading_deg=np.full(30, 10.0))
    (track,) = drive_map(Rows({**given, **lengths, **sigmas, **places, **yaw}), turned)["tracks"]
    assert (track["at"], track["heading"], track["size"]) == ([26.0, -2.0], 35, [4.9, 1.8, 1.5])
    (track,) = drive_map(rows(9, state="parked"), poses())["tracks"]
    assert "size" not in track


def test_short_tracks_and_uncertain_positions_are_left_out():
    assert [len(track["t"].split(",")) for track in drive_map(rows(9, 4), poses())["tracks"]] == [9]
    assert drive_map(rows(9, sigma_m=6.0), poses())["tracks"] == []


def test_page_has_a_map_only_with_poses():
    assert 'id="map-chart"' in report_page(summary(), rows(9), poses=poses())
    assert 'id="map-chart"' not in report_page(summary(), rows(9))
    assert 'id="map-chart"' not in report_page(summary(), rows(9), poses=poses(1))


@pytest.mark.parametrize("text", ["", "frame,time_s\n1,0.1\n", "\x00\xff"])
def test_damaged_poses_are_no_map(tmp_path, text):
    (tmp_path / "poses.csv").write_text(text, encoding="utf-8")
    assert read_poses(tmp_path) is None
