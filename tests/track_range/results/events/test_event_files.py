"""events.csv and events.parquet: content, growth during a run, and damaged files."""

import csv
import dataclasses
import math
from contextlib import suppress

import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings, strategies as st

from tests.support.results.events import event
from track_range.results.events import files
from track_range.results.events.event import EVENT_COLUMNS, EVENT_KINDS, EVENT_NUMBERS, Event
from track_range.results.events.files import (
    EVENTS_FILE,
    EVENTS_PARQUET,
    EventFileError,
    EventFiles,
    events_text,
    read_events,
    write_event_files,
    write_events_parquet,
)

CONTRACT = (
    "kind,start_s,peak_s,end_s,warning_s,frame,track_id,class,min_distance_m,min_distance_sigma_m,"
    "min_ttc_s,closing_mps,ego_mps,probability,reason"
)


def values(one):
    """Attributes of an event, with None for NaN."""
    return {
        key: None if value != value else value for key, value in dataclasses.asdict(one).items()
    }


def test_columns_begin_as_promised():
    assert ",".join(EVENT_COLUMNS).startswith(CONTRACT)
    names = {"class" if f.name == "class_name" else f.name for f in dataclasses.fields(Event)}
    assert set(EVENT_COLUMNS) == names


def test_every_number_has_a_unit_and_limits():
    numbers = {f.name for f in dataclasses.fields(Event) if f.type in ("float", "int")}
    assert set(EVENT_NUMBERS) == numbers


def test_files_without_events_have_a_header(tmp_path):
    write_event_files(tmp_path, (), {"track_range.version": "1"})
    assert (tmp_path / EVENTS_FILE).read_text() == ",".join(EVENT_COLUMNS) + "\n"
    assert pq.read_table(tmp_path / EVENTS_PARQUET).column_names == list(EVENT_COLUMNS)
    assert read_events(tmp_path / EVENTS_FILE) == read_events(tmp_path / EVENTS_PARQUET) == ()


def test_both_files_give_the_events_back(tmp_path):
    events = (event(), event(kind="near_miss", warning_s=math.nan, track_id=0, reason='"a", b'))
    write_event_files(tmp_path, events, {})
    for name in (EVENTS_FILE, EVENTS_PARQUET):
        assert list(map(values, read_events(tmp_path / name))) == list(map(values, events))


def test_parquet_is_in_full_precision_with_units(tmp_path):
    path = tmp_path / EVENTS_PARQUET
    write_events_parquet(path, [event(start_s=1 / 3)], {"track_range.settings_hash": "abc"})
    schema = pq.read_schema(path)
    assert read_events(path)[0].start_s == 1 / 3
    assert schema.metadata[b"track_range.settings_hash"] == b"abc"
    assert schema.field("min_distance_m").metadata == {b"unit": b"m"}
    first = path.read_bytes()
    write_events_parquet(path, [event(start_s=1 / 3)], {"track_range.settings_hash": "abc"})
    assert path.read_bytes() == first


def test_file_grows_and_ends_sorted(tmp_path):
    later, earlier = event(start_s=2.0), event(kind="cut_in", start_s=1.0)
    with EventFiles(tmp_path, {}) as growing:
        assert read_events(tmp_path / EVENTS_FILE) == ()
        growing.add([later])
        assert [one.kind for one in read_events(tmp_path / EVENTS_FILE)] == ["forward_collision"]
        growing.finish([earlier, later])
    assert [one.kind for one in read_events(tmp_path / EVENTS_FILE)] == [
        "cut_in",
        "forward_collision",
    ]
    assert len(read_events(tmp_path / EVENTS_PARQUET)) == 2


def test_text_of_one_event():
    header, row = csv.reader(events_text([event(reason="two\nlines")]).splitlines())
    cells = dict(zip(header, row, strict=True))
    assert (cells["start_s"], cells["frame"], cells["probability"]) == ("1.500", "22", "0.7500")
    assert cells["reason"] == "two lines"


def test_files_of_other_programs_may_lack_columns(tmp_path):
    path = tmp_path / "labels.csv"
    path.write_text("kind,start_s,end_s,comment\nCut_In,1,2,seen\n")
    (one,) = read_events(path)
    assert (one.kind, one.peak_s, one.track_id, one.class_name) == ("cut_in", 1.0, 0, "")
    assert math.isnan(one.warning_s)


HEADER = "kind,start_s,peak_s,end_s,warning_s,frame,track_id,class,probability"


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "empty"),
        ("\n\n", "empty"),
        ("frame,id\n1,2\n", "kind"),
        (f"{HEADER}\ncrash,1,2,3,,1,1,car,\n", "kinds"),
        (f"{HEADER}\ncut_in,3,3,2,,1,1,car,\n", "after"),
        (f"{HEADER}\ncut_in,nan,2,3,,1,1,car,\n", "start_s"),
        (f"{HEADER}\ncut_in,,2,3,,1,1,car,\n", "start_s"),
        (f"{HEADER}\ncut_in,1,2,inf,,1,1,car,\n", "end_s"),
        (f"{HEADER}\ncut_in,-1,2,3,,1,1,car,\n", "start_s"),
        (f"{HEADER}\ncut_in,1,2,3,soon,1,1,car,\n", "warning_s"),
        (f"{HEADER}\ncut_in,1,2,3,,1.5,1,car,\n", "integer"),
        (f"{HEADER}\ncut_in,1,2,3,,1,1,car,1.5\n", "probability"),
        (f"{HEADER}\ncut_in,1,2,3,,1,1,{'x' * 3000},\n", "class"),
        (f"{HEADER}\ncut_in,1,2,3,,1,1,car,0.5,7,8\n", "cells"),
        ("kind,start_s,end_s,kind\ncut_in,1,2,cut_in\n", "one column"),
    ],
)
def test_bad_csv_is_refused(tmp_path, text, word):
    path = tmp_path / "events.csv"
    path.write_text(text)
    with pytest.raises(EventFileError, match=rf"events.csv.*{word}") as error:
        read_events(path)
    assert len(str(error.value)) < 300 + len(str(path))


def test_bad_parquet_is_refused(tmp_path):
    path = tmp_path / EVENTS_PARQUET
    path.write_bytes(b"PAR1 no table PAR1")
    with pytest.raises(EventFileError, match=r"events.parquet.*damaged"):
        read_events(path)
    table = files.events_table([event()])
    changed = table.set_column(0, "kind", [["crash"]])
    pq.write_table(changed, path)
    with pytest.raises(EventFileError, match=r"events.parquet, row 1.*kinds"):
        read_events(path)
    with pytest.raises(EventFileError, match="no such file"):
        read_events(tmp_path / "other.parquet")


def test_missing_needed_column_is_refused(tmp_path):
    path = tmp_path / "events.csv"
    path.write_text("kind,start_s,end_s\n")
    with pytest.raises(EventFileError, match="warning_s"):
        read_events(path, needed=("kind", "start_s", "end_s", "warning_s"))


seconds = st.floats(0, 1e6, allow_nan=False)
numbers = st.one_of(st.just(math.nan), st.floats(0, 1e4))
events = st.builds(
    lambda kind, times, frame, track, distance, probability, name, reason: event(
        kind=kind,
        start_s=min(times),
        end_s=max(times),
        peak_s=times[0],
        frame=frame,
        track_id=track,
        min_distance_m=distance,
        probability=probability,
        class_name=name,
        reason=reason,
    ),
    st.sampled_from(EVENT_KINDS),
    st.tuples(seconds, seconds),
    st.integers(0, 10**9),
    st.integers(0, 2**53),
    numbers,
    st.one_of(st.just(math.nan), st.floats(0, 1)),
    st.sampled_from(["car", "person", "traffic light"]),
    st.text(
        st.characters(min_codepoint=32, max_codepoint=1000, exclude_categories=["Cc", "Cs"]),
        max_size=40,
    ),
)


@settings(max_examples=40, deadline=None)
@given(st.lists(events, max_size=4))
def test_any_events_are_written_and_read(tmp_path_factory, some):
    folder = tmp_path_factory.mktemp("events")
    write_event_files(folder, some, {})
    assert list(map(values, read_events(folder / EVENTS_PARQUET))) == list(map(values, some))
    for one, read in zip(some, read_events(folder / EVENTS_FILE), strict=True):
        assert (read.kind, read.frame, read.track_id) == (one.kind, one.frame, one.track_id)
        assert read.start_s == pytest.approx(one.start_s, abs=0.00051)


@settings(max_examples=50, deadline=None)
@given(st.text(max_size=120), st.sampled_from(["", HEADER + "\n", "kind,start_s,end_s\ncut_in,"]))
def test_any_text_is_read_or_refused(tmp_path_factory, text, start):
    path = tmp_path_factory.mktemp("any") / "events.csv"
    path.write_text(start + text, encoding="utf-8", errors="replace")
    with suppress(EventFileError):
        assert all(one.kind in EVENT_KINDS for one in read_events(path))
