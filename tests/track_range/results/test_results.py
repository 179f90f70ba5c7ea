"""The rows of a run: columns, tracks.csv, mot.txt and the table in memory."""

import csv
import tempfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.support.results.frame_results import changed, result, writing
from tests.toys.registrations import registered_method
from track_range.detection.formats.video_labels.mot import read_mot
from track_range.foundation.files.output_files import OutputError
from track_range.ranging.methods.method import ErrorSource, RangingMethod
from track_range.ranging.registry import methods
from track_range.results.formats.csv_file import read_tracks_csv
from track_range.results.rows.columns import (
    column_names,
    distance_names,
    methods_with_sigma,
    result_columns,
)
from track_range.results.table import FRAMES_PER_BATCH, RunTable

CONTRACT = (
    "frame,time_s,track_id,class,score,observed,x1_px,y1_px,x2_px,y2_px,mono_m,mono_sigma_m,ground_m,ground_sigma_m,"
    "lane_m,lane_sigma_m,stereo_m,stereo_sigma_m,sgbm_m,sgbm_sigma_m,fused_m,fused_sigma_m,"
    "mono_kf_m,mono_kf_sigma_m,stereo_kf_m,stereo_kf_sigma_m,fused_kf_m,fused_kf_sigma_m,"
    "x_m,x_sigma_m,y_m,y_sigma_m,closing_mps,closing_sigma_mps,ttc_s,ttc_sigma_s,utc,"
    "ego_mps,contact_probability,warning,path_offset_m,stereo_surfaces,stereo_probability,"
    "speed_mps,speed_sigma_mps,heading_deg,world_x_m,world_y_m,state,"
    "gap_m,ttc_front_s,headway_s,drac_mps2,mdrac_mps2,tet_s,tit_s2,lane_index,lane_index_sigma,is_lead,"
    "expansion_ttc_s,expansion_ttc_sigma_s,state_probability,"
    "lateral_mps,lateral_sigma_mps,vehicle_x_m,vehicle_y_m,vehicle_z_m,is_cut,"
    "length_m,length_sigma_m,width_m,width_sigma_m,height_m,height_sigma_m,"
    "yaw_deg,yaw_sigma_deg,front_known,centre_x_m,centre_x_sigma_m,centre_y_m,centre_y_sigma_m,"
    "centre_z_m,centre_z_sigma_m,centre_xy_correlation,centre_xz_correlation,"
    "centre_yz_correlation,centre_vehicle_x_m,centre_vehicle_y_m,centre_vehicle_z_m,"
    "centre_world_x_m,centre_world_y_m,centre_world_z_m"
).split(",")


def toy_method(*, is_filtered):
    source = ErrorSource("own", independent=1.0)
    return RangingMethod(
        name="toy", title="toy", letter="y", colour="#123456", create=lambda context: None, error_sources=(source,),
        is_filtered=is_filtered,
    )  # fmt: skip


def test_fixed_columns():
    assert column_names() == CONTRACT


def test_sigmas_follow_their_values():
    names = column_names()
    sigmas = [name for name in names if "_sigma_" in name]
    # of nine distances, x and y, closing and lateral speed, two times to collision, speed over
    # ground, and the size, yaw and centre of the cuboid
    assert len(sigmas) == 23
    assert [names[names.index(sigma) - 1] for sigma in sigmas] == [
        sigma.replace("_sigma", "") for sigma in sigmas
    ]


def test_columns_of_further_methods_are_appended(tmp_path):
    with registered_method(toy_method(is_filtered=False)):
        assert column_names() == [*CONTRACT, "toy_m", "toy_sigma_m"]
    with registered_method(toy_method(is_filtered=True)):
        assert column_names() == [*CONTRACT, "toy_m", "toy_sigma_m", "toy_kf_m", "toy_kf_sigma_m"]
        assert methods_with_sigma()[-5:] == ["toy", "mono_kf", "stereo_kf", "fused_kf", "toy_kf"]
        frame = result()
        toy = {"toy": replace(frame.ranges["mono"], distance_m=np.array([9.0, np.nan]))}
        with writing(tmp_path) as rows, RunTable() as table:
            rows.write(replace(frame, ranges={**frame.ranges, **toy}))
            table.append(replace(frame, ranges={**frame.ranges, **toy}))
            np.testing.assert_equal(table.to_rows()["toy_m"], [9.0, np.nan])
        columns = read_tracks_csv(tmp_path / "tracks.csv")
    np.testing.assert_equal(columns["toy_m"], [9.0, np.nan])
    np.testing.assert_equal(columns["toy_kf_m"], [np.nan, np.nan])


def test_only_distances_of_methods_are_distances():
    """Further columns in metres do not become methods; those of methods of other packages do."""
    names = [column.name for column in result_columns(None)]
    names += ["truth_m", "scored_truth_m", "radar_m", "radar_sigma_m"]
    found = distance_names(names)
    assert found[-1] == "radar"
    assert set(found) == {*methods_with_sigma(), "radar"}
    assert not {"x", "y", "path_offset", "world_x", "world_y", "truth"} & set(found)


def test_every_built_in_method_has_columns():
    names = {
        f"{method.name}{end}"
        for method in methods(())
        if method.measures_distance
        for end in ("_m", "_sigma_m")
    }
    assert names <= set(CONTRACT)
    assert "expansion_m" not in CONTRACT
    assert "expansion" not in methods_with_sigma()


def test_rows_by_hand(tmp_path):
    with writing(tmp_path) as rows:
        rows.write(result())
    with (tmp_path / "tracks.csv").open() as file:
        first, second = csv.DictReader(file)
    assert first["frame"] == "4"
    assert (first["track_id"], first["class"], first["observed"]) == ("3", "car", "1")
    assert (first["mono_m"], first["fused_m"], first["ttc_s"], first["x_m"]) == (
        "12.346",
        "12.000",
        "6.000",
        "1.000",
    )
    assert (first["stereo_m"], first["lane_m"], first["ground_m"]) == ("", "", "")
    assert (second["class"], second["observed"], second["fused_m"], second["fused_kf_m"]) == (
        *("traffic light", "0", ""),
        "8.000",
    )
    assert (
        (tmp_path / "mot.txt").read_text().splitlines()[0].startswith("5,3,2.00,3.00,2.00,2.50,0.5")
    )


def test_mot_file_counts_frames_from_1(tmp_path):
    with writing(tmp_path) as rows:
        for frame in (0, 1, 5):  # a gap
            rows.write(result(frame))
    frames = [line.split(",")[0] for line in (tmp_path / "mot.txt").read_text().splitlines()]
    assert frames == ["1", "1", "2", "2", "6", "6"]
    assert read_mot(tmp_path / "mot.txt").frame.tolist() == [0, 0, 1, 1, 5, 5]
    assert read_tracks_csv(tmp_path / "tracks.csv")["frame"].tolist() == [0, 0, 1, 1, 5, 5]


def test_rows_are_on_disk_before_the_run_ends(tmp_path):
    with writing(tmp_path) as rows:
        rows.write(result())
        assert len(read_tracks_csv(tmp_path / "tracks.csv")["frame"]) == 2


def test_incomplete_last_row_is_dropped(tmp_path):
    with writing(tmp_path) as rows:
        rows.write(result(4))
        rows.write(result(5))
    file = tmp_path / "tracks.csv"
    file.write_bytes(file.read_bytes()[:-60])
    columns = read_tracks_csv(file)
    assert columns["frame"].tolist() == [4, 4, 5]
    assert columns["class"].tolist() == ["car", "traffic light", "car"]
    np.testing.assert_equal(columns["stereo_m"], [np.nan] * 3)


def test_no_rows_at_all(tmp_path):
    with writing(tmp_path), RunTable() as table:
        assert {len(column) for column in table.to_rows().columns.values()} == {0}
        assert table.to_arrow().num_rows == 0
    columns = read_tracks_csv(tmp_path / "tracks.csv")
    assert {len(column) for column in columns.values()} == {0}


def test_unreadable_tracks_csv(tmp_path):
    for content in (None, b"", b"\xff\xfe\x00", b"frame,frame\n1,2\n"):
        if content is not None:
            (tmp_path / "tracks.csv").write_bytes(content)
        with pytest.raises(OutputError, match=r"tracks\.csv: "):
            read_tracks_csv(tmp_path / "tracks.csv")


@pytest.mark.slow
@given(
    values=st.lists(st.floats(-1e6, 1e6) | st.just(np.nan), min_size=2, max_size=2),
    times_s=st.lists(st.floats(0, 1e5), min_size=1, max_size=5),
)
@settings(deadline=None, max_examples=50)
def test_table_equals_tracks_csv(tmp_path_factory, values, times_s):
    folder = tmp_path_factory.mktemp("run")
    with writing(folder) as rows, RunTable(rows_per_batch=3) as table:
        for index, time_s in enumerate(times_s):
            frame = changed(
                result(index), closing_mps=np.array(values), ttc_s=np.array(values[::-1])
            )
            frame = replace(frame, frame=replace(frame.frame, time_s=time_s))
            rows.write(frame)
            table.append(frame)
        rows = table.to_rows()
    read = read_tracks_csv(folder / "tracks.csv")
    assert list(rows.columns) == list(read)
    for name in read:
        np.testing.assert_array_equal(rows[name], read[name], err_msg=name)


def test_table_of_many_batches():
    with RunTable(rows_per_batch=3) as table, RunTable() as whole:
        for index in range(10):
            table.append(result(index))
            whole.append(result(index))
            assert table.to_arrow().num_rows == 2 * (index + 1)
        arrow = table.to_arrow()
        assert arrow.equals(whole.to_arrow())
    # outlives its file
    assert arrow.column("frame").to_pylist() == [index for index in range(10) for _ in range(2)]
    assert arrow.column("mono_m").to_pylist()[:2] == [12.346, None]
    assert arrow.column("class").to_pylist()[:2] == ["car", "traffic light"]
    assert arrow.schema.field("closing_mps").metadata == {b"unit": b"m/s"}


@pytest.mark.parametrize("n_frames", [1, 2])
def test_table_keeps_its_rows_if_results_change(n_frames):
    """The arrays of a result belong to the caller, who may change them afterwards."""
    with RunTable() as table, RunTable() as expected:
        results = [result(index) for index in range(n_frames)]
        for appended in results:
            table.append(appended)
            expected.append(result(appended.frame.index))
        arrow = table.to_arrow(is_rounded=False)
        for appended in results:
            for array in (
                appended.tracks.track_id,
                appended.tracks.xyxy_px,
                appended.tracks.class_id,
                appended.tracks.observed,
                appended.ranges["fused"].distance_m,
                appended.ttc_s,
            ):
                array[:] = 1
        assert arrow.equals(expected.to_arrow(is_rounded=False))
        assert table.to_arrow(is_rounded=False).equals(arrow)


def test_table_of_sparse_frames(tmp_path, monkeypatch):
    """Memory stays flat if most frames have few rows: after some hundreds of frames they are
    stored."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with RunTable() as table:
        for index in range(FRAMES_PER_BATCH - 1):
            table.append(result(index))
        assert list(tmp_path.iterdir()) == []
        table.append(result(FRAMES_PER_BATCH - 1))
        assert len(list(tmp_path.iterdir())) == 1
        assert table.to_arrow().num_rows == 2 * FRAMES_PER_BATCH


def test_temporary_file_is_deleted(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with RunTable(rows_per_batch=3) as table:
        table.append(result())
        assert list(tmp_path.iterdir()) == []  # a short run writes nothing
        table.append(result())
        assert len(list(tmp_path.iterdir())) == 1
    assert list(tmp_path.iterdir()) == []
    dropped = RunTable(rows_per_batch=1)
    dropped.append(result())
    assert len(list(tmp_path.iterdir())) == 1
    del dropped
    assert list(tmp_path.iterdir()) == []


def test_temporary_folder_that_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with RunTable(rows_per_batch=1) as table, pytest.raises(OutputError, match="missing"):
        table.append(result())
