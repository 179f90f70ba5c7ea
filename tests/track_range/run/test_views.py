"""Table of several views: objects in the overlap of two views have one row."""

from __future__ import annotations

import csv

from track_range.results.formats.box_files import RECORDED_BOXES_COLUMNS, RECORDED_BOXES_FILE
from track_range.run.views import joined_text


def row(frame, track_id, name, box, azimuth_deg):
    return [frame, f"{frame / 10:.6f}", track_id, name, *box, azimuth_deg, 1.0, 2.0, 3.0]


def written(folder, rows):
    folder.mkdir()
    with (folder / RECORDED_BOXES_FILE).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([RECORDED_BOXES_COLUMNS, *rows])
    return folder


def test_rows_of_the_nearer_axis_remain(tmp_path):
    left = written(
        tmp_path / "left",
        [
            row(0, 1, "car", (100, 100, 160, 140), -38),
            row(0, 2, "car", (300, 100, 340, 140), -25),
            row(1, 2, "car", (300, 100, 340, 140), -35),
            row(1, 3, "person", (500, 100, 520, 140), -20),
        ],
    )
    ahead = written(
        tmp_path / "ahead",
        [
            # track 2 of the left view, cut by the edge of this one
            row(0, 1, "car", (310, 100, 340, 140), -24),
            row(1, 1, "car", (302, 101, 341, 139), -35),
            row(1, 5, "car", (498, 100, 522, 142), -20),  # another class
        ],
    )
    rows = list(csv.DictReader(joined_text((-60, 0), (left, ahead)).splitlines()))
    kept = [(row["frame"], row["view_deg"], row["track_id"]) for row in rows]
    assert kept == [
        ("0", "-60", "1"),
        ("0", "0", "1"),
        ("1", "-60", "2"),
        ("1", "-60", "3"),
        ("1", "0", "5"),
    ]


def test_views_without_tracks(tmp_path):
    empty = written(tmp_path / "a", [])
    text = joined_text((0, 60), (empty, written(tmp_path / "b", [])))
    assert text == ",".join(("view_deg", *RECORDED_BOXES_COLUMNS)) + "\n"
