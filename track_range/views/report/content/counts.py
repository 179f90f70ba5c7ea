"""Speeds and counts of a camera that stands still: tables, headlines and a histogram, from summary.json."""

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import numpy as np

from track_range.foundation.files.input_files import counted
from track_range.views.report.content.events import time_words
from track_range.views.tables import NOTHING, Cell, Grid

_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 760, 190, 16, 160  # of the histogram, in its own units
_BIN_KMH = (2, 5, 10, 20)  # widths of its bars, of which the first with at most so many is used
_MOST_BARS = 24


class Bar(TypedDict):
    """One bar of the histogram."""

    x: float
    y: float
    width: float
    height: float
    text: str
    words: str


class Histogram(TypedDict):
    """Speeds of road users."""

    width: int
    height: int
    bottom: int
    bars: list[Bar]


def is_fixed(summary: Mapping[str, Any]) -> bool:
    """Whether the run was one of a camera that stands still."""
    return isinstance(summary.get("fixed_camera"), Mapping)


def line_grid(summary: Mapping[str, Any]) -> Grid:
    """One row per line and direction: numbers by class, and speeds; no rows without lines."""
    lines = (summary.get("counts") or {}).get("lines") or {}
    classes = sorted({name for line in lines.values() for name in line["by_class"]})
    rows = []
    for name, line in lines.items():
        for direction, n in (line["by_direction"] or {"": 0}).items():
            by_class = (line["by_class"].get(one, {}).get(direction, 0) for one in classes)
            texts = [name, direction or NOTHING, n, *by_class]
            rows.append(tuple(Cell(str(text)) for text in texts))
        speeds = (_number(line[key]) for key in ("median_speed_kmh", "p85_speed_kmh"))
        words = f"median {' and 85th percentile '.join(speeds)} km/h of {line['n_speeds']}"
        rows.append((Cell(name), Cell("speeds"), Cell(words), *[Cell("")] * len(classes)))
    return Grid("Lines", ("line", "direction", "number", *classes), tuple(rows))


def zone_grid(summary: Mapping[str, Any]) -> Grid:
    """One row per zone; no rows without zones."""
    zones = (summary.get("counts") or {}).get("zones") or {}
    keys = ("n_enter", "n_exit", "median_dwell_s", "mean_speed_kmh")
    rows = tuple(
        (Cell(name), *(Cell(_number(zone[key])) for key in keys)) for name, zone in zones.items()
    )
    columns = ("zone", "entered", "left", "median stay s", "mean speed km/h")
    return Grid("Zones", columns, rows)


def speed_grid(summary: Mapping[str, Any]) -> Grid:
    """One row per class: number of road users, and their speeds."""
    users = summary["fixed_camera"].get("road_users") or []
    rows = []
    for name in sorted({user["class"] for user in users}):
        own = [user for user in users if user["class"] == name]
        known = [user for user in own if user["speed_kmh"] is not None]
        speeds = [user["speed_kmh"] for user in known]
        median = f"{np.median(speeds):.0f}" if speeds else NOTHING
        fastest = max(known, key=lambda user: user["speed_kmh"], default=None)
        words = NOTHING if fastest is None else _user_words(fastest)
        rows.append(tuple(map(Cell, (name, str(len(own)), str(len(known)), median, words))))
    columns = ("class", "number", "measured", "median km/h", "fastest")
    return Grid("Road users and their speeds over ground", columns, tuple(rows))


def _user_words(user: Mapping[str, Any]) -> str:
    return f"{_speed(user)}: {user['class']} {user['track_id']} at {time_words(user['from_s'])}"


def _speed(user: Mapping[str, Any]) -> str:
    return f"{user['speed_kmh']:.0f} ±{user['speed_sigma_kmh']:.0f} km/h"


def _number(value: float | None) -> str:
    return NOTHING if value is None else f"{value:g}" if value == round(value) else f"{value:.1f}"


def fixed_headlines(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Three main results of a run: how many, how fast in the median, and the fastest."""
    users = summary["fixed_camera"].get("road_users") or []
    known = [user for user in users if user["speed_kmh"] is not None]
    lines = (summary.get("counts") or {}).get("lines") or {}
    n = sum(line["n"] for line in lines.values())
    first = (
        (
            counted(n, "crossing"),
            f"at {', '.join(lines)}; {counted(len(users), 'road user')} in all",
        )
        if lines
        else (counted(len(users), "road user"), "tracked by a camera that stands still")
    )
    if not known:
        rest = [("No speed", "was measured: give the plane of the road (--ground)", None)]
    else:
        speeds = [user["speed_kmh"] for user in known]
        fastest = max(known, key=lambda user: user["speed_kmh"])
        words = f"{fastest['class']} {fastest['track_id']} at {time_words(fastest['from_s'])}"
        rest = [
            (
                f"{np.median(speeds):.0f} km/h",
                f"median speed of {counted(len(known), 'road user')}",
                None,
            ),
            (_speed(fastest), f"fastest road user: {words}", fastest["from_s"]),
        ]
    return [
        {"figure": figure, "words": words, "time_s": time_s}
        for figure, words, time_s in [(*first, None), *rest]
    ]


def speed_histogram(summary: Mapping[str, Any]) -> Histogram | None:
    """The histogram of the speeds of road users that moved; None if there are none."""
    users = summary["fixed_camera"].get("road_users") or []
    speeds = [user["speed_kmh"] for user in users if user["speed_kmh"] is not None]
    if not speeds:
        return None
    top = max(speeds)
    bin_kmh = next((one for one in _BIN_KMH if top / one < _MOST_BARS), _BIN_KMH[-1])
    n_bars = int(top // bin_kmh) + 1
    numbers = _counts(speeds, bin_kmh, n_bars)
    step = (_WIDTH - 2 * _LEFT) / n_bars
    scale = (_BOTTOM - 24) / max(numbers)
    bars = [
        Bar(
            x=round(_LEFT + i * step, 1),
            y=round(_BOTTOM - scale * n, 1),
            width=round(step - 2, 1),
            height=round(scale * n, 1),
            text=f"{i * bin_kmh}",
            words=f"{counted(n, 'road user')} from {i * bin_kmh} to {(i + 1) * bin_kmh} km/h",
        )
        for i, n in enumerate(numbers)
    ]
    return Histogram(width=_WIDTH, height=_HEIGHT, bottom=_BOTTOM, bars=bars)


def _counts(speeds: Sequence[float], bin_kmh: float, n_bars: int) -> list[int]:
    places = (np.array(speeds) // bin_kmh).astype(np.int64)
    return [int(n) for n in np.bincount(places, minlength=n_bars)]
