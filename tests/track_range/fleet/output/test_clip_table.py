"""clips.parquet and the journal: merging, crashes between the steps, damaged files."""

from __future__ import annotations

import json

import pyarrow.parquet
import pytest

from track_range.fleet.errors import FleetError
from track_range.fleet.output import data_set
from track_range.fleet.output.data_set import (
    CLIPS_FILE,
    ClipTable,
    encoded,
    journal_rows,
    publish_record,
    read_clips,
    tracks_location,
)
from track_range.fleet.output.record import ClipRecord, merged_table, records_table
from track_range.fleet.output.state import FleetState, read_state, state_text, status_lines
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import Location

NAMES = ["0001", "a b", "ä/ö", "100%", "x=1", "..", "a.json", "."]


@pytest.fixture
def out(tmp_path):
    return Location.of(tmp_path)


def record(clip, status="done", **values):
    return ClipRecord(clip=clip, status=status, settings_hash="s", **values).row()


def names_in(out):
    return [row["clip"] for row in read_clips(out).to_pylist()]


@pytest.mark.parametrize("name", NAMES)
def test_record_is_read_again(out, name):
    row = record(
        name, frames=3, warnings=["a", "b"], stages_ms={"read": 1.5}, labels={"vehicle": "v"}
    )
    publish_record(out, row)
    assert journal_rows(out, [name]) == {name: row}
    assert names_in(out) == [name]
    table = ClipTable(out)
    table.compile()
    assert list((out.path / "journal").iterdir()) == []
    stored = read_clips(out).to_pylist()
    assert stored == [row]


@pytest.mark.parametrize("name", NAMES)
def test_partitions_are_decoded_by_readers(tmp_path, name):
    import duckdb
    import pyarrow as pa
    import pyarrow.dataset

    file = tracks_location(Location.of(tmp_path), name).path
    file.parent.mkdir(parents=True)
    pyarrow.parquet.write_table(pa.table({"frame": [1]}), file)
    schema = pa.schema([("clip", pa.string())])
    partitioning = pyarrow.dataset.partitioning(schema, flavor="hive")
    table = pyarrow.dataset.dataset(tmp_path / "tracks", partitioning=partitioning).to_table()
    assert table["clip"].to_pylist() == [name]
    query = f"""select clip from read_parquet('{tmp_path}/tracks/*/*.parquet', hive_partitioning = true,
        hive_types = {{'clip': varchar}})"""  # noqa: S608
    assert duckdb.sql(query).fetchall() == [(name,)]


def test_newer_rows_replace_older_ones(out):
    table = ClipTable(out)
    table.add(record("b", "failed", error="reason"), is_in_journal=False)
    table.add(record("a"), is_in_journal=False)
    table.compile()
    publish_record(out, record("b", frames=7))
    assert [(row["clip"], row["status"]) for row in read_clips(out).to_pylist()] == [
        ("a", "done"),
        ("b", "done"),
    ]
    again = ClipTable(out)
    again.compile(is_sorted=True)
    assert [row["frames"] for row in read_clips(out).to_pylist()] == [None, 7]
    assert again.failed({"a", "b"}) == []


def test_crash_before_the_journal_is_cleared(out, monkeypatch):
    """The rows are then in both, and count once."""
    publish_record(out, record("a"))
    table = ClipTable(out)
    with monkeypatch.context() as patched:
        patched.setattr(ClipTable, "_clear_journal", lambda self: None)
        table.compile()
    assert names_in(out) == ["a"]
    assert len(list((out.path / "journal").iterdir())) == 1
    ClipTable(out).compile()
    assert names_in(out) == ["a"]
    assert list((out.path / "journal").iterdir()) == []


def test_crash_before_the_table_is_written(out, monkeypatch):
    publish_record(out, record("a"))
    table = ClipTable(out)

    def fail(*arguments, **options):
        raise StorageError("no space left", "full")

    with monkeypatch.context() as patched:
        patched.setattr(data_set, "write_clips", fail)
        with pytest.raises(StorageError):
            table.compile()
    assert names_in(out) == ["a"]
    assert journal_rows(out, ["a"])


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b'{"clip": 3}', b"\xff", b'{"clip": "a", "status": "odd"}']
)
def test_damaged_record_is_left_out(out, content):
    publish_record(out, record("b"))
    (out.path / "journal" / "a.json").write_bytes(content)
    assert names_in(out) == ["b"]


@pytest.mark.parametrize("content", [b"", b"PAR1", b"no table"])
def test_damaged_table_is_refused(out, content):
    (out.path / CLIPS_FILE).write_bytes(content)
    with pytest.raises(FleetError, match=CLIPS_FILE):
        ClipTable(out)


def test_table_of_another_program_is_refused(out):
    import pyarrow as pa

    pyarrow.parquet.write_table(pa.table({"clip": ["a"]}), out.path / CLIPS_FILE)
    with pytest.raises(FleetError, match=CLIPS_FILE):
        ClipTable(out)


def test_newer_table_is_refused(out):
    table = records_table([record("a")])
    newer = table.replace_schema_metadata({"track_range.fleet_schema_version": "99"})
    pyarrow.parquet.write_table(newer, out.path / CLIPS_FILE)
    with pytest.raises(FleetError, match="99"):
        ClipTable(out)


def test_columns_are_the_union(out):
    first = records_table([record("b", stages_ms={"read": 1.0}, labels={"vehicle": "v1"})])
    merged = merged_table(
        first,
        {"a": record("a", coverage={"mono": 0.5}), "c": record("c", labels={"clip": "other"})},
    )
    rows = {row["clip"]: row for row in merged.to_pylist()}
    assert rows["b"]["read_ms"] == 1.0
    assert rows["b"]["mono_coverage"] is None
    assert rows["a"]["vehicle"] is None
    assert rows["c"]["label_clip"] == "other"
    assert merged.column_names[:2] == ["clip", "status"]


def test_label_that_becomes_a_number(out):
    first = records_table([record("a", labels={"x_ms": "text"})])
    merged = merged_table(first, {"b": record("b", stages_ms={"x": 2.0})})
    assert merged["x_ms"].to_pylist() == ["text", "2"]


def test_types_do_not_depend_on_the_values(out):
    """Neither without a road user, nor where an earlier version has stored text."""
    unknown = record(
        "a", coverage={"fused": None}, stages_ms={"read": None}, alignment={"row_offset_px": None}
    )
    table = records_table([{**unknown, "fused_median_relative_error_pct": None}])
    figures = (
        "fused_coverage",
        "read_ms",
        "alignment_row_offset_px",
        "fused_median_relative_error_pct",
    )
    assert {str(table[name].type) for name in figures} == {"double"}
    index = table.column_names.index("fused_coverage")
    text = table.set_column(index, "fused_coverage", pyarrow.array(["0.8947"]))
    merged = merged_table(
        text, {"b": record("b", coverage={"fused": 1}), "c": unknown | {"clip": "c"}}
    )
    assert merged["fused_coverage"].to_pylist() == [0.8947, 1.0, None]
    vehicles = merged_table(
        records_table([record("a", labels={"vehicle": "01"})]),
        {"b": record("b") | {"vehicle": None}},
    )
    assert vehicles["vehicle"].to_pylist() == ["01", None]


def test_touched_row_has_the_new_fingerprint(out):
    table = ClipTable(out)
    table.add(record("a", inputs="old", content_hash="c"), is_in_journal=False)
    table.compile()
    table.touch("a", {"inputs": "new"})
    table.compile()
    assert [(row["inputs"], row["content_hash"]) for row in read_clips(out).to_pylist()] == [
        ("new", "c")
    ]


def test_failed_write_leaves_nothing(out, tmp_path):
    (tmp_path / "tracks" / "clip=a").mkdir(parents=True)
    with pytest.raises(StorageError, match="clip=a"):
        data_set.publish(out, tracks_location(out, "a"), tmp_path / "missing.parquet")
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_encoded_names_are_file_names():
    assert all("/" not in encoded(name) for name in NAMES)


def test_state_is_read_again(out):
    state = FleetState(state="running", total=3, workers=[{"number": 0}])
    state.write(out)
    assert read_state(out) == state
    assert state.is_alive


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", '{"track_range_fleet": 1}', '{"track_range_fleet": 1, "x": 2}']
)
def test_damaged_state_is_none(out, content):
    (out.path / "fleet.json").write_text(content)
    assert read_state(out) is None


def test_status_of_a_killed_driver(out):
    publish_record(out, record("a", seconds=7200.0))
    publish_record(out, record("b", "failed", error="a reason"))
    FleetState(state="running", pid=2**22 + 1, total=5).write(out)
    lines = list(status_lines(out))
    assert "unexpectedly" in lines[0]
    assert lines[1] == "1 of 5 clips done, 2 h 0 min of video"
    assert any("a reason" in line for line in lines)


def test_status_of_a_failed_run():
    assert "no space" in state_text(FleetState(state="failed", reason="no space left"))


def test_status_shows_no_control_sequences(cli, tmp_path):
    out = Location.of(tmp_path)
    publish_record(out, record("a\x1b[31m", "failed", error="b\x1b[2J"))
    content = {"track_range_fleet": 1, "state": "failed", "reason": "\x1b[2J", "total": 1}
    (tmp_path / "fleet.json").write_text(json.dumps(content))
    status, stdout, _ = cli("fleet", "status", tmp_path)
    assert status == 0
    assert "\x1b" not in stdout
