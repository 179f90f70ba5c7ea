"""`fleet report`: figures with known values, damaged and missing parts, the page and its links."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from urllib.parse import unquote

import pyarrow as pa
import pytest
from pyarrow import parquet

from tests.support.command_line import run_command
from tests.support.results.events import event
from tests.track_range.fleet.fleet_results import (
    BROKEN,
    DAWN,
    NOON,
    done_record as record,
    rows_table,
    track_rows,
    write_clip,
    write_fleet,
)
from track_range.fleet.errors import FleetError
from track_range.fleet.output.data_set import ClipTable, tracks_location
from track_range.fleet.report.clip_figures import (
    MAX_GROUPS,
    ClipColumns,
    drift_figures,
    note_figures,
)
from track_range.fleet.report.fleet_figures import fleet_figures
from track_range.fleet.report.fleet_grids import fleet_sections
from track_range.fleet.report.fleet_page import fleet_page
from track_range.fleet.report.track_figures import (
    N_RANKED,
    TrackFigures,
    needed_columns,
    track_figures,
)
from track_range.fleet.storage.location import Location


def row_of(table, clip):
    return next(row for row in table.table.to_pylist() if row["clip"] == clip)


@pytest.fixture
def scratch(tmp_path):
    folder = tmp_path / "scratch"
    folder.mkdir()
    return folder


@pytest.fixture
def out(tmp_path, scratch):
    """Results of a fleet."""
    location = Location.of(tmp_path / "out")
    write_fleet(location, scratch)
    return location


def figures_of(out, **options):
    """Figures that JSON can hold."""
    return json.loads(json.dumps(fleet_figures(out, **options).figures, allow_nan=False))


def test_counts_and_hours(out):
    figures = figures_of(out)
    assert figures["clips"] == {"total": 3, "done": 2, "failed": 1, "left": 0}
    assert figures["video_h"] == pytest.approx(2400 / 3600)
    assert figures["clips_per_hour"] == pytest.approx(2.0)
    assert figures["video_s_per_worker_s"] == pytest.approx(2.0)
    assert figures["problems"] == []


def test_tracks_by_class_and_hour(out):
    figures = figures_of(out)
    classes = {row["class"]: row for row in figures["classes"]}
    assert {name: row["tracks"] for name, row in classes.items()} == {
        "car": 2,
        "person": 1,
        "traffic sign": 1,
    }
    assert classes["car"]["per_hour"] == pytest.approx(3.0)
    assert classes["car"]["mean_visible_s"] == pytest.approx(1.9)
    hours = {row["hour_utc"]: row for row in figures["hours"]}
    # the first clip starts at 07:50 and lasts 20 minutes; the second has no times in its rows
    assert [hours[hour]["video_h"] * 60 for hour in (7, 8, 12, None)] == pytest.approx(
        [10, 10, 20, 0]
    )
    assert hours[7]["tracks"] == {"car": 1, "person": 1, "traffic sign": 1}
    assert hours[None]["tracks"]["car"] == 1


def test_coverage_by_band(out):
    rows = {(row["method"], row["from_m"]): row for row in figures_of(out)["coverage"]}
    assert {method for method, _ in rows} == {"fused", "fused_kf", "stereo"}
    # the car has distances from 4 to 23 m, the sign from 1 to 20 m, the person from 12 to 31 m, the
    # other car from 30 m
    assert [rows["fused", low]["boxes"] for low in (0, 5, 10, 20, 30)] == [5, 10, 28, 15, 22]
    assert rows["fused", 0]["coverage"] == 1.0
    assert rows["stereo", 10]["coverage"] == pytest.approx(0.5)


def test_rankings(out):
    figures = figures_of(out)
    closest = [(row["clip"], row["track_id"], row["distance_m"]) for row in figures["closest"]]
    assert closest == [(DAWN, 1, 4.0), (DAWN, 2, 12.0), (NOON, 1, 30.0)]
    assert figures["closest"][0]["sigma_m"] == pytest.approx(0.08)
    # the first car passes at a lateral offset of 3.5 m, and the traffic sign is no road user
    collisions = [(row["clip"], row["track_id"], row["ttc_s"]) for row in figures["collisions"]]
    assert collisions == [(DAWN, 2, 1.2), (NOON, 1, 3.0)]
    assert figures["collisions"][0]["time_s"] == pytest.approx(1.9)


def test_ranking_is_limited(tmp_path):
    tracks = [track_rows(i, "car", near_m=float(i), x_m=0.0, utc_s=None) for i in range(1, 31)]
    table = rows_table(*tracks)
    total = TrackFigures()
    for clip in ("b", "a"):
        total.add(track_figures(clip, table.select(needed_columns(table.column_names))))
    assert len(total.closest) == len(total.collisions) == N_RANKED
    assert [(item["clip"], item["track_id"]) for item in total.closest[:3]] == [
        ("a", 1),
        ("b", 1),
        ("a", 2),
    ]


def test_uncertain_distances_are_not_ranked():
    rows = track_rows(1, "car", near_m=5.0, x_m=0.0, utc_s=None)
    rows["fused_kf_sigma_m"] = 0.6 * rows["fused_kf_m"]
    assert track_figures("a", rows_table(rows)).closest == []
    rows["fused_kf_sigma_m"][-4:] = 0.4 * rows["fused_kf_m"][-4:]
    (approach,) = track_figures("a", rows_table(rows)).closest
    assert approach["distance_m"] in rows["fused_kf_m"][-4:]


def test_uncertain_times_to_collision_are_not_ranked():
    rows = track_rows(1, "car", near_m=5.0, x_m=0.0, utc_s=None)
    rows["ttc_sigma_s"] = 0.6 * rows["ttc_front_s"]
    assert track_figures("a", rows_table(rows)).collisions == []
    rows["ttc_sigma_s"][1:4] = 0.4 * rows["ttc_front_s"][1:4]  # three frames support a minimum
    (collision,) = track_figures("a", rows_table(rows)).collisions
    assert collision["time_s"] == rows["time_s"][3]


def test_errors_and_drift(out):
    figures = figures_of(out)
    (errors,) = figures["errors"]
    assert (errors["method"], errors["clips"], errors["worst_clip"]) == ("fused", 2, NOON)
    assert (errors["median_relative_error_pct"], errors["bias_pct"]) == (3.0, 1.0)
    (drift,) = figures["drift"]
    assert (figures["drift_by"], drift["group"], drift["clips"]) == ("vehicle", "van", 2)
    assert drift["row_offset_px"]["change"] == pytest.approx(0.4)
    assert drift["offset_px"]["change"] == pytest.approx(-0.2)


def test_drift_by_another_column(out):
    assert {row["group"] for row in figures_of(out, group="node")["drift"]} == {"a"}
    figures = figures_of(out, group="colour")
    assert "colour" in figures["problems"][0]
    assert [row["group"] for row in figures["drift"]] == ["all clips"]


def test_drift_of_many_groups(out):
    """Each clip is a group; those with the largest change are in the report."""
    table = ClipTable(out)
    row = row_of(table, NOON)
    for number in range(2 * MAX_GROUPS):
        for day, offset_px in (("01", 0.0), ("02", 0.01 * number)):
            utc = f"2026-05-{day}T12:00:00Z"
            changed = {
                "vehicle": f"v{number:03}",
                "alignment_offset_px": offset_px,
                "start_utc": utc,
            }
            table.add({**row, **changed, "clip": f"{number}-{day}"}, is_in_journal=False)
    table.compile()
    groups = [
        row["group"]
        for row in drift_figures(ClipColumns(table.table).with_status("done"), "vehicle")
    ]
    assert groups == [f"v{number:03}" for number in range(MAX_GROUPS, 2 * MAX_GROUPS)]


def test_failures_and_notes(out, scratch):
    for number in range(6):
        left = f"/recordings/{number}.mp4"
        error = f"{left}: frame {number} is damaged."
        write_clip(
            out,
            record(f"c{number}", left=left, error=error, error_kind="input"),
            _one_row(),
            scratch,
        )
    table = ClipTable(out)
    for number in range(6):
        table.add({**table.newer[f"c{number}"], "status": "failed"}, is_in_journal=True)
    table.compile()
    figures = figures_of(out)
    damaged, other = figures["failures"]
    assert (damaged["kind"], damaged["n"], damaged["reason"]) == (
        "input",
        6,
        "frame 0 to 5 is damaged.",
    )
    assert len(damaged["clips"]) == 5
    assert (other["n"], other["reason"], other["clips"]) == (1, "not a video.", [BROKEN])
    (note,) = (row for row in figures["notes"] if row["n"] == 2)
    # the lengths of the names of the clips
    assert note == {"n": 2, "note": "Focal length 4 to 13 px.", "clip": NOON}


def test_numbers_of_merged_notes():
    """Numbers in names are those of the first note, numbers that agree stay."""
    notes = [
        "a-1.mp4: bias +4.0 % of 'x 9', 75 degrees (2 cars).",
        "a-2.mp4: bias -3.5 % of 'y', 75 degrees (12 cars).",
    ]
    table = pa.table({"clip": ["a", "b"], "warnings": [[note] for note in notes]})
    (row,) = note_figures(ClipColumns(table))
    assert row["note"] == "a-1.mp4: bias -3.5 to +4.0 % of 'x 9', 75 degrees (2 to 12 cars)."


@pytest.mark.parametrize(
    ("first", "second", "merged"),
    [
        ("expected 2, found 1240.5.", "expected 3, found 'abc'.", "expected 2 to 3, found 1240.5."),
        ("expected 2, found 'abc'.", "expected 3, found 1240.5.", "expected 2 to 3, found 'abc'."),
        (
            "from 10:05:30, 4 times: 7.",
            "from 11:05:31, 5 times: 9.",
            "from 10:05:30, 4 to 5 times: 7 to 9.",
        ),
    ],
)
def test_texts_and_clock_times_are_not_merged(first, second, merged):
    table = pa.table({"clip": ["a", "b"], "warnings": [[first], [second]]})
    (row,) = note_figures(ClipColumns(table))
    assert (row["n"], row["note"]) == (2, merged)


def test_notes_of_different_patterns_are_separate():
    table = pa.table({"clip": ["a", "b"], "warnings": [["track # is lost."], ["track 5 is lost."]]})
    assert [row["n"] for row in note_figures(ClipColumns(table))] == [1, 1]


def test_short_fleets_have_no_rates(tmp_path, scratch):
    out = Location.of(tmp_path / "out")
    write_clip(out, record("a", seconds=9.8), _one_row(), scratch, [event()])
    figures = figures_of(out)
    assert [row["per_hour"] for row in (*figures["classes"], *figures["event_kinds"])] == [
        None,
        None,
    ]
    sections = {section.anchor: section for section in fleet_sections(figures)}
    (classes,) = sections["road-users"].grids
    assert classes.columns == ("class", "tracks", "visible for s (mean)")
    work = sections["throughput"].grids[0]
    assert (
        dict(zip(work.columns, (cell.text for cell in work.rows[0]), strict=True))["video s"]
        == "9.8"
    )
    assert "10 s of video" in run_command("fleet", "report", out.path).stdout


def test_notes_are_read_in_one_table(out):
    """Neither split from the number of clips, nor aligned to the right."""
    shown = run_command("fleet", "report", out.path).stdout
    lines = shown[shown.index("\nNotes") :].splitlines()
    assert lines[2].split() == ["example", "clips", "note"]
    assert [line.split(maxsplit=2)[1:] for line in lines[4:5]] == [
        ["2", "Focal length 4 to 13 px."]
    ]


def test_lateral_position_where_only_the_filter_has_a_distance():
    """A pinhole camera of 700 px with the centre at 600 px; the sum of the edges of a box is twice
    its centre."""
    rows = track_rows(1, "car", near_m=4.0, x_m=3.0, utc_s=None)
    centre_px = 600 + 700 * rows["x_m"] / rows["fused_m"]
    rows |= {"x1_px": centre_px - 50, "x2_px": centre_px + 50, "path_offset_m": rows["x_m"] - 2.5}
    rows["fused_m"] = rows["fused_m"].copy()  # fused_kf_m has them all
    rows["fused_m"][-4:] = rows["x_m"][-4:] = float("nan")
    figures = track_figures("a", rows_table(rows))
    (closest,) = figures.closest
    assert (closest["distance_m"], closest["x_m"]) == (4.0, pytest.approx(3.0))
    assert closest["path_offset_m"] == 0.5
    rows["x1_px"][:] = rows["x2_px"][:] = 600.0  # no ray but one is known
    assert track_figures("a", rows_table(rows)).closest[0]["x_m"] is None


def _one_row():
    return rows_table(track_rows(1, "car", near_m=9.0, x_m=0.0, utc_s=None))


def test_run_in_progress(tmp_path, scratch):
    """All records are in the journal."""
    out = Location.of(tmp_path / "out")
    write_fleet(out, scratch, is_compiled=False)
    assert not out.child("clips.parquet").exists()
    assert figures_of(out)["clips"]["done"] == 2
    out.child("fleet.json").remove()
    assert figures_of(out)["clips"]["total"] == 3


@pytest.mark.parametrize("content", [b"", b"PAR1 nothing", b"\0" * 500])
def test_damaged_clips_table(tmp_path, scratch, content):
    out = Location.of(tmp_path / "out")
    write_fleet(out, scratch, is_compiled=False)
    out.child("clips.parquet").write_bytes(content)
    figures = figures_of(out)
    assert "clips.parquet" in figures["problems"][0]
    assert figures["clips"]["done"] == 2


def test_damaged_and_missing_tracks(out):
    tracks_location(out, NOON).remove()
    whole = tracks_location(out, DAWN).read_bytes()
    tracks_location(out, DAWN).write_bytes(whole[: len(whole) // 2])
    figures = figures_of(out)
    assert [NOON in text or "damaged" in text for text in figures["problems"]] == [True, True]
    assert figures["tracks"] == 0
    assert figures["clips"]["done"] == 2
    assert fleet_page(fleet_figures(out), out, out.child("fleet.html"))


@pytest.mark.parametrize(
    "columns",
    [
        {"a": [1]},
        {"time_s": ["x"], "track_id": [1], "class": ["car"]},
        {"time_s": [1.0], "track_id": [None], "class": ["car"]},
        {"time_s": [float("inf")], "track_id": [1], "class": ["car"]},
    ],
)
def test_tracks_of_another_program(out, columns):
    parquet.write_table(pa.table(columns), tracks_location(out, NOON).path)
    (problem,) = figures_of(out)["problems"]
    assert NOON in problem


def test_clip_without_rows(out, scratch):
    write_clip(out, record("empty"), _one_row().slice(0, 0), scratch)
    assert figures_of(out)["problems"] == []


def test_column_of_another_type(out):
    """Another program has changed the types of columns."""
    table = parquet.read_table(out.child("clips.parquet").path)
    for name in ("seconds", "frames", "node", "alignment_offset_px", "fused_coverage"):
        values = (
            pa.array([{"a": 1}] * len(table)) if name == "node" else pa.array(["x"] * len(table))
        )
        table = table.set_column(table.column_names.index(name), name, values)
    parquet.write_table(table, out.child("clips.parquet").path)
    figures = figures_of(out)
    assert figures["clips"]["done"] == 2
    assert figures["video_h"] == 0.0


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[]", b'{"track_range_fleet": 1, "state": "running"', b"\xff" * 9]
    + [
        json.dumps({"track_range_fleet": 1, "state": "finished", **changed}).encode()
        for changed in (
            {"total": "x"},
            {"options": []},
            {"started_s": None},
            {"state": "asleep"},
            {"workers": 3},
        )
    ],
)
def test_damaged_state(out, content):
    out.child("fleet.json").write_bytes(content)
    figures = figures_of(out)
    assert "fleet.json" in figures["state"]
    assert figures["clips"]["done"] == 2


@pytest.mark.parametrize("make", [lambda folder: None, lambda folder: folder.mkdir()])
def test_no_fleet(tmp_path, make):
    make(tmp_path / "out")
    with pytest.raises(FleetError, match="out"):
        fleet_figures(Location.of(tmp_path / "out"))


class Links(HTMLParser):
    """Addresses of the links of a page, and other addresses that it would load."""

    def __init__(self, page):
        super().__init__()
        self.links, self.loaded = [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        """Add the addresses of a tag."""
        values = dict(attrs)
        self.links += [values["href"]] if tag == "a" else []
        self.loaded += [values[name] for name in ("src", "data") if name in values]
        assert tag != "link"


@pytest.mark.parametrize("page", ["out/fleet.html", "fleet.html", "pages/a/fleet.html"])
def test_page_links_to_files(out, tmp_path, page):
    path = tmp_path / page
    path.parent.mkdir(parents=True, exist_ok=True)
    text = fleet_page(fleet_figures(out), out, Location.of(path))
    parsed = Links(text)
    assert parsed.loaded == []
    files = [link for link in parsed.links if not link.startswith("#")]
    # report and overlay of two rows of the first ranking and one of the second
    assert len(files) == 6
    assert all((path.parent / unquote(link.partition("#")[0])).is_file() for link in files)
    assert any(link.endswith("overlay.mp4#t=0.0") for link in files)


def test_overlay_time_after_start_s(out, scratch):
    inputs = json.dumps({"files": {}, "settings": {"start_s": "-5"}})
    table = ClipTable(out)
    table.add({**row_of(table, DAWN), "inputs": inputs}, is_in_journal=False)
    table.compile()
    assert "#t=4.9" in fleet_page(fleet_figures(out), out, out.child("fleet.html"))


def test_texts_are_escaped(out, scratch):
    evil = "<img src=x onerror=alert(1)>"
    labels = {"vehicle": evil}
    write_clip(
        out,
        record(evil, warnings=[evil], labels=labels, alignment={"offset_px": 1.0}),
        _one_row(),
        scratch,
    )
    page = fleet_page(fleet_figures(out), out, out.child("fleet.html"))
    assert "<img" not in page
    assert page.count("&lt;img") >= 3


def test_command_writes_all_files(out, tmp_path):
    done = run_command(
        *(
            "fleet",
            "report",
            out.path,
            "--html",
            "fleet.html",
            "--table",
            "fleet.md",
            "--json",
            "fleet.json",
        ),
        folder=tmp_path,
    )
    assert (done.status, done.stderr) == (0, "")
    assert "2 of 3 clips done" in done.stdout
    assert "Closest tracks" in done.stdout
    assert "fleet.html" in done.stdout
    assert json.loads((tmp_path / "fleet.json").read_text())["clips"]["done"] == 2
    titles = re.findall(r"^\*\*(.*)\*\*$", (tmp_path / "fleet.md").read_text(), re.MULTILINE)
    assert {"Tracks by class", "Coverage by distance band", "Failures by reason"} <= set(titles)
    assert DAWN in (tmp_path / "fleet.html").read_text()


@pytest.mark.parametrize(
    "options", [["--json", "out/clips.parquet"], ["--html", "out/fleet.json"], ["--html", "out"]]
)
def test_files_of_the_fleet_are_not_replaced(out, tmp_path, options):
    done = run_command("fleet", "report", "out", *options, folder=tmp_path)
    assert done.status != 0
    assert options[1].rpartition("/")[2] in done.stderr
    assert fleet_figures(out).figures["problems"] == []


@pytest.mark.slow
def test_report_of_an_object_store(bucket, scratch):
    out = bucket.child("a fleet")
    write_fleet(out, scratch)
    page = out.child("fleet.html")
    done = run_command("fleet", "report", out.address, "--html", page.address)
    assert (done.status, done.stderr) == (0, "")
    links = [link for link in Links(page.read_bytes().decode()).links if link.startswith("runs/")]
    assert len(links) == 6
    assert all(out.child(unquote(link.partition("#")[0])).exists() for link in links)
    elsewhere = fleet_page(fleet_figures(out), out, Location.of(scratch / "fleet.html"))
    assert [link for link in Links(elsewhere).links if not link.startswith("#")] == []
