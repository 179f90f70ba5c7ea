"""Events of two runs, matched by kind, time and place; and events and main results in words."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.track_range.views.report.report_rows import track_rows
from track_range.results.approaches import closest_approaches
from track_range.results.events.event import Event
from track_range.results.rows.rows import Rows
from track_range.views.report.comparison import (
    ComparedRun,
    event_differences,
    event_grids,
    event_sentence,
)
from track_range.views.report.content.events import (
    clips_of,
    event_details,
    kind_counts,
    shown_events,
    sigma_words,
    time_words,
)
from track_range.views.report.sentences import headlines


def event(**changes: Any) -> Event:
    values: dict[str, Any] = dict.fromkeys(
        ("warning_s", "min_ttc_s", "closing_mps", "ego_mps", "probability", "headway_s"), math.nan
    )
    values |= {
        "kind": "near_miss",
        "start_s": 1.0,
        "peak_s": 1.5,
        "end_s": 2.0,
        "frame": 15,
        "track_id": 1,
    }
    values |= {
        "class_name": "car",
        "min_distance_m": 4.0,
        "min_distance_sigma_m": 0.2,
        "reason": "",
    }
    return Event(**{**values, **changes})


def differences(
    a: list[Event], b: list[Event], a_rows: Any = None, b_rows: Any = None
) -> list[tuple[str, str]]:
    usual_rows = track_rows((1, 300.0), (2, 700.0))
    listed = event_differences(a, Rows(a_rows or usual_rows), b, Rows(b_rows or usual_rows))
    return [
        (
            "changed" if item.changes else "first" if item.first else "second",
            "; ".join(item.changes),
        )
        for item in listed
    ]


def test_equal_events_do_not_differ() -> None:
    assert differences([event()], [event()]) == []
    assert differences([], []) == []


@pytest.mark.parametrize(
    "change", [{"kind": "cut_in"}, {"track_id": 2}, {"start_s": 5.0, "peak_s": 5.0, "end_s": 6.0}]
)
def test_other_kind_place_or_time(change: dict[str, Any]) -> None:
    assert sorted(differences([event()], [event(**change)])) == [("first", ""), ("second", "")]


def test_other_identity_at_the_same_place() -> None:
    assert differences([event()], [event(track_id=9)], b_rows=track_rows((9, 310.0))) == []


def test_place_without_boxes_is_the_distance() -> None:
    assert differences([event(track_id=0)], [event(track_id=0, min_distance_m=4.1)]) == []
    far = event(track_id=0, min_distance_m=40.0)
    assert [kind for kind, _ in differences([event(track_id=0)], [far])] == ["first", "second"]


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"warning_s": 1.2}, "warning none"),
        ({"end_s": 2.5}, "end 0.5 s later"),
        ({"start_s": 0.5}, "start 0.5 s earlier"),
        ({"min_distance_m": 5.0}, "smallest distance"),
        ({"class_name": "truck"}, "class car"),
        ({"min_ttc_s": 1.0}, "time to collision none"),
    ],
)
def test_changed_events(change: dict[str, Any], word: str) -> None:
    ((kind, text),) = differences([event()], [event(**change)])
    assert kind == "changed"
    assert word in text


def test_small_changes_are_not_listed() -> None:
    assert differences([event()], [event(start_s=1.1, end_s=2.1, min_distance_m=4.2)]) == []


def test_nearest_peaks_match_first() -> None:
    first = [event(peak_s=1.2, start_s=1.0, end_s=3.0), event(peak_s=2.8, start_s=1.0, end_s=3.0)]
    assert differences(first, [event(peak_s=2.7, start_s=1.0, end_s=3.0)]) == [("first", "")]


def compared(name: str, events: Any, video: str = "a.mp4") -> ComparedRun:
    summary = {"inputs": {"mono": video}}
    return ComparedRun(
        name=name,
        summary=summary,
        settings={},
        link=f"{name}/r.html",
        events=events,
        rows=Rows(track_rows((1, 3.0))),
    )


def test_grids_of_events_come_first() -> None:
    runs = [compared("a", (event(),)), compared("b", ()), compared("c", (event(kind="cut_in"),))]
    grids = event_grids(runs)
    assert [grid.title for grid in grids] == [
        "Events that differ: a and b",
        "Events that differ: a and c",
        "Number of events",
    ]
    assert grids[0].rows[0][0].link == "a/r.html#t=1.000"
    assert [cell.text for cell in grids[1].rows[0]][1:3] == ["only in a", "near miss"]
    assert event_sentence(runs) == ""


@pytest.mark.parametrize(
    ("second", "word"),
    [
        (compared("b", (event(),)), "same"),
        (compared("b", None), "not compared"),
        (compared("b", (), "x.mp4"), "not"),
    ],
)
def test_sentence_without_differences(second: ComparedRun, word: str) -> None:
    assert word in event_sentence([compared("a", (event(),)), second])


def test_run_without_events_file() -> None:
    runs = [compared("a", None), compared("b", ())]
    assert "unknown" in event_sentence(runs)
    assert event_grids(runs) == []


def test_event_in_words() -> None:
    text = event_details(
        event(min_ttc_s=1.25, closing_mps=3.0, ego_mps=10.0, probability=0.5, headway_s=0.75)
    )
    assert (
        text
        == "4.0 ± 0.2 m · time to contact 1.2 s · closing 3.0 m/s · headway 0.8 s · ego 36 km/h · "
        "predicted contact 50 %"
    )
    certain = event_details(event(min_distance_m=math.nan, probability=0.9998))
    assert certain == "predicted contact over 99 %"
    assert event_details(event(min_distance_m=math.nan)) == ""
    assert kind_counts([event(), event(), event(kind="cut_in")]) == [
        "1 \N{MULTIPLICATION SIGN} cut-in",
        "2 \N{MULTIPLICATION SIGN} near miss",
    ]


@pytest.mark.parametrize(
    ("time_s", "text"), [(1.25, "1.2 s"), (119.94, "119.9 s"), (125.6, "2:06"), (3725.0, "1:02:05")]
)
def test_time_in_words(time_s: float, text: str) -> None:
    assert time_words(time_s) == text


def test_most_severe_events_are_shown() -> None:
    events = [event(start_s=float(i), end_s=i + 1.0, probability=i / 600) for i in range(600)]
    shown = shown_events(events)
    assert len(shown) == 500
    assert shown[0].start_s == 100.0


@pytest.mark.parametrize(
    ("sigma_m", "words"), [(0.0, "0.01"), (0.019, "0.02"), (0.0951, "0.1"), (2.34, "2.3")]
)
def test_small_sigmas_are_not_zero(sigma_m: float, words: str) -> None:
    assert sigma_words(sigma_m) == words


def shown(columns: dict[str, Any], events: list[Event] | None) -> list[dict[str, Any]]:
    rows = Rows(columns)
    return headlines(rows, closest_approaches(rows), events)


def test_headlines_of_events() -> None:
    columns = {
        **track_rows((1, 300.0)),
        "observed": np.ones(40),
        "fused_m": 20.0 - np.arange(40) / 10,
    }
    columns |= {
        "ttc_front_s": np.full(40, np.nan),
        "fused_sigma_m": np.full(40, 0.5),
        "ttc_s": np.full(40, 1.0),
    }
    columns["ttc_front_s"][5:8] = [2.7, 2.6, 2.5]
    first, nearest, collision = shown(
        columns, [event(), event(kind="forward_collision", warning_s=1.5)]
    )
    assert (first["figure"], first["time_s"]) == ("1 warning", 1.5)
    assert nearest == {
        "figure": "16.3 m",
        "words": "smallest distance from the camera (±0.5 m): car 1, 3.9 s into the video",
        "time_s": 3.9,
    }
    assert (collision["figure"], collision["time_s"]) == ("2.5 s", 0.7)
    assert shown(columns, [event()])[0]["figure"] == "1 event"
    assert shown(columns, [])[0]["figure"] == "No event"
    assert shown(columns, None)[0]["figure"] == "1 road user"


def test_a_warned_contact_is_not_hidden_by_the_longer_time_of_another() -> None:
    columns = {**track_rows((1, 300.0), (2, 500.0)), "observed": np.ones(80)}
    columns |= {"fused_m": np.full(80, 20.0), "fused_sigma_m": np.full(80, 0.5)}
    columns |= {"ttc_s": np.full(80, 22.0), "ttc_front_s": np.full(80, 22.0)}
    is_short = np.arange(80) >= 78  # seen in two frames before the contact
    columns = {name: values[(np.arange(80) < 40) | is_short] for name, values in columns.items()}
    columns["ttc_front_s"][-2:] = columns["ttc_s"][-2:] = 0.3
    columns["contact_probability"] = np.where(columns["track_id"] == 2, 0.97, 0.0)
    short = event(kind="forward_collision", track_id=2, warning_s=3.8, probability=0.97)
    assert shown(columns, [short])[2]["figure"] == "97 %"
    assert "car 2" in shown(columns, [short])[2]["words"]
    assert shown(columns, [replace(short, probability=0.2)])[2]["figure"].startswith("22.0 s")


def test_headline_of_a_probability() -> None:
    columns = {
        **track_rows((1, 300.0)),
        "observed": np.ones(40),
        "fused_m": np.full(40, 20.0),
        "ttc_s": np.full(40, np.nan),
    }
    columns["contact_probability"] = np.where(np.arange(40) == 7, 0.6, 0.1)
    figure = shown(columns, [])[2]
    assert (figure["figure"], figure["time_s"]) == ("60 %", 0.7)
    columns["contact_probability"] = np.full(40, 0.2)
    assert shown(columns, [])[2]["figure"] == "Below 25 %"
    columns["contact_probability"] = np.full(40, np.nan)
    assert shown(columns, [])[2]["figure"] == "Not known"


def test_a_distance_of_an_unknown_scale_is_not_called_unmeasured() -> None:
    columns = {**track_rows((1, 300.0)), "observed": np.ones(40), "fused_m": np.full(40, 20.0)}
    columns["fused_sigma_m"] = np.full(40, 15.5)
    nearest = shown(columns, [])[1]
    assert nearest["figure"] == "No distance"
    assert nearest["words"] == "is known within 50 % in several frames in a row"


def test_links_to_clips() -> None:
    events = [event(kind="near_miss", start_s=float(i), end_s=i + 1.0, track_id=3) for i in (5, 1)]
    addresses = {"01-near_miss-3.mp4": "clips/01-near_miss-3.mp4"}
    assert clips_of(events, shown_events(events), addresses) == ["", "clips/01-near_miss-3.mp4"]


def test_headlines_without_road_users() -> None:
    columns = {
        **track_rows((1, 300.0)),
        "class": np.full(40, "traffic sign"),
        "fused_m": np.full(40, 3.0),
    }
    figures = [headline["figure"] for headline in shown(columns, None)]
    assert figures == ["No road user", "No distance", "Not known"]
