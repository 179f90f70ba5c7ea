"""What a run prints at its end."""

import math

from tests.support.results.approach_rows import ROWS
from tests.support.results.events import event
from track_range.results.approaches import closest_approaches
from track_range.views.report.outcome import (
    accuracy_lines,
    class_grid,
    event_lines,
    html_table,
    user_grid,
)
from track_range.views.report.sentences import headlines

TIMES = "\N{MULTIPLICATION SIGN}"
USERS = closest_approaches(ROWS)


def texts(grid):
    return [[cell.text for cell in row] for row in grid.rows]


def test_extremes_of_a_class_name_track_and_time():
    assert texts(class_grid(USERS)) == [
        ["person", "1", "8.5", "2 at 0.2 s", "-", "-", "-", "-"],
        ["car", "1", "15.0 ±0.3", "1 at 0.5 s", "10.0 ±1.0", "1 at 0.5 s", "1.5", "1 at 0.5 s"],
        ["bus", "1", "-", "-", "-", "-", "-", "-"],
    ]


def test_nearest_road_users():
    grid = user_grid(USERS, 2)
    assert "of 3" in grid.title
    assert texts(grid)[1] == ["car 1", "15.0 ±0.3", "10.0 ±1.0", "1.5"]
    assert "<td>car 1</td><td>15.0 ±0.3</td>" in html_table(grid)
    assert html_table(user_grid([], 2)) == ""


def test_events_in_lines():
    assert [*event_lines([], 1)] == [
        "No event found among the road users that were measured: no collision warning, close "
        "following, hard approach, cut-in or near miss."
    ]
    expected = "No road user was found, so that there was nothing to warn of."
    assert [*event_lines([], 0)] == [expected]
    warning = event(kind="cut_in", start_s=2.0, warning_s=2.1, reason="A car moved in.")
    first, line = event_lines([warning], 1)
    assert first == "1 warning: car 7, 2.1 s into the video."
    assert line.split() == "2.0 s cut-in, car 7: A car moved in.".split()
    others = [event(kind="near_miss", start_s=float(i), warning_s=math.nan) for i in range(6)]
    first, *lines, more = event_lines([warning, *others], 1)
    assert first == "1 warning: car 7, 2.1 s into the video; 7 events in all."
    assert len(lines) == 5
    assert more.strip().startswith("and 2 events more")
    assert next(event_lines(others[:2], 1)) == f"2 events: 2 {TIMES} near miss, without a warning."
    assert (
        next(event_lines(others[2:3], 1))
        == "1 event: near miss, car 7, 2.0 s into the video, without a warning."
    )


def test_accuracy_in_lines():
    fused = {"median_relative_error_pct": 0.41, "mean_relative_error_pct": 1.4, "n": 416}
    tracks = {"n": 3, "idf1": 45.2, "mota": 26.1, "idsw": 12}
    summary = {"frames": 60, "methods": {"fused_kf": fused}, "closing": None, "tracks": tracks}
    title, *lines = accuracy_lines(summary)
    assert "60 frames" in title
    assert [line.split(maxsplit=1) for line in lines] == [
        ["distance", "median error 0.4 %, mean 1.4 %, over 416 boxes"],
        ["tracks", "IDF1 45 %, MOTA 26 %, 12 identity switches"],
    ]
    share = {"fused_kf": fused | {"within_25_percent": 0.986}}
    assert "within 25 %" in [*accuracy_lines(summary | {"methods": share})][2]
    assert [*accuracy_lines(summary | {"methods": share})][2].endswith("98.6% of the distances")
    assert len([*accuracy_lines(summary | {"methods": {}, "tracks": {"n": 3, "idf1": None}})]) == 1


LOW = {"is_low": True, "sentence": "The images are dark in 90 % of the video."}


def test_a_run_that_could_not_see_says_that_in_place_of_no_event():
    assert list(event_lines([], 0, LOW)) == [
        "Low visibility: The images are dark in 90 % of the video."
    ]
    (warning, _) = event_lines([event()], 1, LOW)
    assert warning.startswith("1 warning")
    assert "Low" not in next(event_lines([], 0, {**LOW, "is_low": False}))


def test_the_cards_of_a_run_that_could_not_see():
    first, _, collision = headlines(ROWS.select(slice(0)), [], [], LOW)
    assert (first["figure"], first["words"]) == ("Low visibility", LOW["sentence"].rstrip("."))
    assert collision["words"] == "how near a collision was: the images show too little"
    assert "Below" not in str(headlines(ROWS, USERS, [], LOW))
