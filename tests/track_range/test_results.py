import csv

import numpy as np
import pytest

from track_range.ranging.ranges import Ranges
from track_range.results.csv_file import COLUMNS, ResultRows, read_tracks_csv
from track_range.results.output_files import OutputError
from track_range.run.frame_result import FrameResult
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

CONTRACT = (
    "frame,time_s,track_id,class,score,observed,x1_px,y1_px,x2_px,y2_px,mono_m,mono_sigma_m,lane_m,lane_sigma_m,"
    "stereo_m,stereo_sigma_m,sgbm_m,sgbm_sigma_m,fused_m,fused_sigma_m,closing_mps,ttc_s,"
    "mono_kf_m,stereo_kf_m,fused_kf_m,ground_m,x_m,y_m"
).split(",")


def result(frame=4):
    tracks = Tracks(
        np.array([3, 7]),
        np.array([[1.0, 2.0, 3.0, 4.5], [10.0, 20.0, 30.0, 40.0]]),
        np.array([2, 6]),
        np.array([0.5, 0.25]),
        np.array([True, False]),
    )
    nan = np.nan
    ranges = {
        "mono": Ranges(tracks.track_id, np.array([12.3456, nan]), np.array([1.0, nan])),
        "fused": Ranges(tracks.track_id, np.array([12.0, nan]), np.array([0.5, nan])),
        "fused_kf": Ranges(tracks.track_id, np.array([12.5, 8.0]), np.array([0.4, 0.3])),
    }
    image = np.zeros((50, 50, 3), np.uint8)
    xyz_m = np.array([[1.0, 2.0, 12.0], [nan, nan, nan]])
    return FrameResult(
        frame=Frame(frame, 0.4, image, None),
        tracks=tracks,
        ranges=ranges,
        closing_mps=np.array([2.0, nan]),
        closing_sigma_mps=np.array([0.5, nan]),
        ttc_s=np.array([6.0, nan]),
        ttc_sigma_s=np.array([1.5, nan]),
        xyz_m=xyz_m,
    )


def test_columns_are_the_contract_and_then_more():
    assert list(COLUMNS[: len(CONTRACT)]) == CONTRACT
    assert len(set(COLUMNS)) == len(COLUMNS)


def test_rows_by_hand(tmp_path):
    with ResultRows(tmp_path) as rows:
        rows.write(result())
    with (tmp_path / "tracks.csv").open() as file:
        first, second = csv.DictReader(file)
    assert first["frame"] == "4"
    assert (first["track_id"], first["class"], first["observed"]) == ("3", "car", "1")
    assert (first["mono_m"], first["fused_m"], first["ttc_s"], first["x_m"]) == ("12.346", "12.000", "6.000", "1.000")
    assert (first["stereo_m"], first["lane_m"], first["ground_m"]) == ("", "", "")
    assert (second["class"], second["observed"], second["fused_m"], second["fused_kf_m"]) == (
        *("traffic light", "0", ""),
        "8.000",
    )
    assert (tmp_path / "mot.txt").read_text().splitlines()[0].startswith("5,3,2.00,3.00,2.00,2.50,0.5")


def test_rows_are_on_disk_before_the_run_ends(tmp_path):
    with ResultRows(tmp_path) as rows:
        rows.write(result())
        assert len(read_tracks_csv(tmp_path / "tracks.csv")["frame"]) == 2


def test_columns_come_back_and_a_torn_last_row_is_dropped(tmp_path):
    with ResultRows(tmp_path) as rows:
        rows.write(result(4))
        rows.write(result(5))
    file = tmp_path / "tracks.csv"
    file.write_bytes(file.read_bytes()[:-60])
    columns = read_tracks_csv(file)
    assert columns["frame"].tolist() == [4, 4, 5]
    assert columns["class"].tolist() == ["car", "traffic light", "car"]
    np.testing.assert_equal(columns["stereo_m"], [np.nan] * 3)


def test_no_rows_at_all(tmp_path):
    with ResultRows(tmp_path):
        pass
    columns = read_tracks_csv(tmp_path / "tracks.csv")
    assert {len(column) for column in columns.values()} == {0}


def test_what_cannot_be_written_or_read(tmp_path):
    with pytest.raises(OutputError, match="cannot be written to"):
        ResultRows(tmp_path / "nowhere")
    with pytest.raises(OutputError, match=r"not a readable tracks\.csv"):
        read_tracks_csv(tmp_path / "tracks.csv")
