"""Rows by declared column, and a further column: one declaration, seen in every output."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from pyarrow import parquet

from tests.support.results.frame_results import changed, result, writing
from track_range.foundation.registry import imported
from track_range.ranging.methods.method import MethodError
from track_range.ranging.registry import METHODS, register
from track_range.results.folder import read_run_rows
from track_range.results.replay import PARTS, frames_of_rows
from track_range.results.rows import columns
from track_range.results.rows.column import ResultColumn, RowReader
from track_range.results.rows.rows import Rows
from track_range.results.table import RunTable
from track_range.stereo.geometry.mounting import Mounting

NAN = np.nan
SIGMA = ResultColumn(
    "path_offset_sigma_m",
    "m",
    "alarms.warnings.path_offset_sigma_m",
    "standard deviation of `path_offset_m`",
    viewer_name="path_offset_sigma_m",
)


def test_names_and_places_are_declared_once():
    declared_columns = columns.result_columns()
    places = [column.place for column in declared_columns if column.place]
    assert len({column.name for column in declared_columns}) == len(declared_columns)
    assert len(set(places)) == len(places)


def test_replays_make_the_part_of_every_place():
    made_besides = ("ranges.", "world.xyz_m.", "world.xy_sigma_m.")
    parts = {
        column.place.rstrip("012").removesuffix(".").rpartition(".")[0]
        for column in columns.result_columns()
        if not column.place.startswith(made_besides)
    }
    assert parts <= {*PARTS, "tracks.xyxy_px"}


@pytest.mark.parametrize("name", ["gap", "world_x"])
def test_method_whose_columns_have_the_names_of_others_is_refused(name):
    with METHODS.restored():
        register(replace(imported(METHODS.built_in["mono"]), name=name, letter="~"))
        with pytest.raises(MethodError, match=f"method {name}: .*{name}_m"):
            columns.result_columns()


def test_a_frame_is_read_at_once_as_column_by_column():
    frame, declared = result(3), columns.result_columns()
    values = {kind: iter(rows) for kind, rows in RowReader(declared).read(frame).items()}
    for column in declared:
        expected = column.read(frame)
        np.testing.assert_array_equal(next(values[column.kind]), expected, err_msg=column.name)
    assert not [row for rows in values.values() for row in rows]


def test_values_of_a_frame_are_copies():
    frame = result(3)
    values = RowReader(columns.result_columns()).read(frame)
    arrays = [frame.tracks.xyxy_px, frame.tracks.score, frame.tracks.track_id]
    assert not any(np.shares_memory(array, one) for array in arrays for one in values.values())


def test_names_do_not_look_like_numbers_that_are_unknown():
    assert not [
        name for column in columns.result_columns() for name in column.names if "nan" in name
    ]


def test_unknown_names_of_tables_are_empty():
    column = columns.declared_columns()["state"]
    assert column.typed(np.array(["moving", None], object)).tolist() == ["moving", ""]


@pytest.fixture
def declared(monkeypatch):
    """A further column, declared beside the others."""
    monkeypatch.setattr(columns, "_SAFETY", (*columns._SAFETY, SIGMA))


def frame():
    """A frame of two tracks whose warnings have sigmas."""
    given = result()
    warnings = replace(given.alarms.warnings, path_offset_sigma_m=np.array([0.25, NAN]))
    return replace(given, alarms=replace(given.alarms, warnings=warnings))


@pytest.mark.usefixtures("declared")
def test_one_declaration_is_seen_in_every_output(tmp_path):
    with writing(tmp_path, ("csv", "parquet", "mcap")) as files, RunTable() as table:
        files.write(frame())
        table.append(frame())
        np.testing.assert_equal(table.to_rows()[SIGMA.name], [0.25, NAN])
        assert table.to_arrow()[SIGMA.name].to_pylist() == [0.25, None]
    with (tmp_path / "tracks.csv").open() as file:
        assert [row[SIGMA.name] for row in csv.DictReader(file)] == ["0.250", ""]
    stored = parquet.read_table(tmp_path / "tracks.parquet")
    assert stored[SIGMA.name].to_pylist() == [0.25, None]
    assert stored.schema.field(SIGMA.name).metadata == {b"unit": b"m"}
    with (tmp_path / "run.mcap").open("rb") as file:
        ((schema, _, message),) = make_reader(file).iter_messages(topics=["/tracks/ranges"])
    shown = json.loads(message.data)["tracks"]
    assert [track.get(SIGMA.name) for track in shown] == [0.25, None]
    track_schema = json.loads(schema.data)["properties"]["tracks"]["items"]
    assert track_schema["properties"][SIGMA.name] == {"type": "number"}


@pytest.mark.usefixtures("declared")
@pytest.mark.parametrize("file", ["tracks.csv", "tracks.parquet"])
def test_one_declaration_is_read_back(tmp_path, file):
    with writing(tmp_path, ("csv", "parquet")) as files:
        files.write(frame())
    rows = read_run_rows(tmp_path / file, [])
    np.testing.assert_equal(rows[SIGMA.name], [0.25, NAN])
    (again,) = frames_of_rows(rows, [4], ("mono", "fused", "fused_kf"), 10.0)
    np.testing.assert_equal(again.warnings.path_offset_sigma_m, [0.25, NAN])
    earlier = Rows({name: rows[name] for name in rows.columns if name != SIGMA.name})
    assert SIGMA.name not in earlier
    assert np.isnan(earlier[SIGMA.name]).all()


@pytest.mark.parametrize("first_missing", ["gap_m", "contact_probability"])
def test_rows_of_earlier_versions_have_no_measures(tmp_path, first_missing):
    """Events are then found from the distances."""
    with writing(tmp_path, ("csv",)) as files:
        files.write(result())
    path = tmp_path / "tracks.csv"
    with path.open() as file:
        table = list(csv.reader(file))
    n_columns = table[0].index(first_missing)
    path.write_text("".join(",".join(row[:n_columns]) + "\n" for row in table))
    rows = read_run_rows(path, [])
    (again,) = frames_of_rows(rows, [4], rows.methods_measured, 10.0)
    assert not again.alarms.has_safety
    assert again.alarms.has_warnings == (first_missing == "gap_m")
    assert not again.warnings.active.any()


@pytest.mark.parametrize("yaw_deg", [0.0, -58.0, 90.0])
def test_speed_across_the_axis_follows_from_the_mounting(tmp_path, yaw_deg):
    mounting = Mounting(yaw_deg=yaw_deg)
    right_mps, _, forward_mps = mounting.velocity_mps(10.0)
    with writing(tmp_path, ("csv",)) as files:
        files.write(changed(result(), ego_mps=forward_mps))
    rows = read_run_rows(tmp_path / "tracks.csv", [])
    (again,) = frames_of_rows(rows, [4], rows.methods_measured, 10.0, mounting=mounting)
    expected = NAN if yaw_deg == 90.0 else right_mps
    assert again.ego.right_mps == pytest.approx(expected, abs=0.01, nan_ok=True)


def test_values_have_their_declared_types():
    rows = Rows(
        {
            "frame": np.array([3.0, 4.0]),
            "observed": np.array([0.0, NAN]),
            "warning": np.array([1.0, NAN]),
            "gap_m": np.array([8, 9]),
            "radar_m": np.array([7.0, NAN]),
        }
    )
    assert rows["frame"].tolist() == [3, 4]
    assert rows["frame"].dtype == np.int64
    # as an empty cell in a file of an earlier version
    assert rows["observed"].tolist() == [False, True]
    assert rows["warning"].tolist() == [True, False]
    assert rows["gap_m"].dtype == np.float64
    assert rows["state"].tolist() == ["", ""]
    assert rows.methods_measured == ["radar"]
    assert rows.select(rows["frame"] > 3)["frame"].tolist() == [4]
    np.testing.assert_equal(rows.distance("sonar"), ([NAN, NAN], [NAN, NAN]))
    with pytest.raises(KeyError):
        rows["sonar_m"]


def test_columns_have_one_length():
    with pytest.raises(ValueError, match="equal length"):
        Rows({"frame": np.zeros(2), "time_s": np.zeros(3)})


def test_rows_do_not_change():
    rows = Rows({"frame": np.zeros(2)})
    with pytest.raises(TypeError):
        rows.columns["frame"] = np.ones(2)
    assert len(rows.with_columns({"gap_m": np.ones(2)}).columns) == 2
    assert len(rows.columns) == 1


def test_tracks_are_in_the_order_of_time():
    rows = Rows({"track_id": np.array([2, 1, 2]), "time_s": np.array([1.0, 0.0, 0.5])})
    assert [own.tolist() for own in rows.by_track()] == [[1], [2, 0]]
    assert Rows().by_track() == []
