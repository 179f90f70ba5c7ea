"""The outcome of a run, for the terminal and notebooks: the extremes of each class, and the
events.
"""

import html
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.files.input_files import counted
from track_range.results.events.event import Event, severity_key
from track_range.views.report.content.events import (
    kind_words,
    object_words,
    sigma_words,
    time_words,
)
from track_range.views.report.sentences import event_headline
from track_range.views.tables import NOTHING, Cell, Grid

MOST_EVENTS = 5  # that are listed in the terminal, the most severe ones
_DISTANCE_FIGURES = (
    "median error {median_relative_error_pct:.1f} %, mean {mean_relative_error_pct:.1f} %, over "
    "{n} boxes"
)
_EXTREMES = (  # heading, key, key of its sigma and sign of the value that comes first
    ("nearest m", "min_distance_m", "min_distance_sigma_m", 1),
    ("closing m/s", "max_closing_mps", "max_closing_sigma_mps", -1),
    ("TTC s", "min_ttc_front_s", "", 1),
)


def class_grid(users: Sequence[Mapping[str, Any]]) -> Grid:
    """One row per class of `closest_approaches`: number of road users, and each extreme with its
    track and time.
    """
    rows = []
    for name in sorted({user["class"] for user in users}, key=ROAD_CLASSES.index):
        own = [user for user in users if user["class"] == name]
        texts = [name, str(len(own))]
        for _, key, sigma_key, sign in _EXTREMES:
            known = [user for user in own if user[key] is not None]
            first = min(known, key=lambda user: sign * user[key], default=None)
            place = (
                NOTHING
                if first is None
                else f"{first['track_id']} at {time_words(first[f'{key}_at_s'])}"
            )
            texts += [_value(first, key, sigma_key), place]
        rows.append(tuple(map(Cell, texts)))
    headings = (text for heading, *_ in _EXTREMES for text in (heading, "track and time"))
    return Grid("Road users", ("class", "number", *headings), tuple(rows))


def user_grid(users: Sequence[Mapping[str, Any]], most: int) -> Grid:
    """One row per road user of `closest_approaches`, the nearest `most`."""
    title = (
        "Closest approaches"
        if len(users) <= most
        else f"The {most} closest approaches of {len(users)}"
    )
    rows = (
        (
            f"{user['class']} {user['track_id']}",
            *(_value(user, key, sigma_key) for _, key, sigma_key, _ in _EXTREMES),
        )
        for user in users[:most]
    )
    columns = ("road user", *(heading for heading, *_ in _EXTREMES))
    return Grid(title, columns, tuple(tuple(map(Cell, texts)) for texts in rows))


def _value(user: Mapping[str, Any] | None, key: str, sigma_key: str) -> str:
    if user is None or user[key] is None:
        return NOTHING
    sigma = user[sigma_key] if sigma_key else None
    return f"{user[key]:.1f}" if sigma is None else f"{user[key]:.1f} ±{sigma_words(sigma)}"


def html_table(grid: Grid) -> str:
    """A grid as an HTML table, "" without rows."""
    lines = [("th", grid.columns), *(("td", [cell.text for cell in row]) for row in grid.rows)]
    rows = (
        "".join(f"<{tag}>{html.escape(text)}</{tag}>" for text in texts) for tag, texts in lines
    )
    return (
        f"<p>{html.escape(grid.title)}</p><table><tr>{'</tr><tr>'.join(rows)}</tr></table>"
        if grid.rows
        else ""
    )


def event_lines(
    events: Sequence[Event], n_users: int, visibility: Mapping[str, Any] | None = None
) -> Iterator[str]:
    """The warnings or the number of events of `n_users` road users in one line, then a line for
    each of the most severe events; a low `visibility` in place of no event.
    """
    headline = event_headline(events, n_users, visibility)
    between = ": " if events or headline["words"].startswith("The ") else " "
    yield f"{headline['figure']}{between}{headline['words']}."
    listed = sorted(sorted(events, key=severity_key)[:MOST_EVENTS], key=lambda event: event.start_s)
    for event in listed:
        yield (
            f"  {time_words(event.start_s):>7}  {kind_words(event.kind)}, {object_words(event)}: "
            f"{event.reason}"
        )
    if len(events) > len(listed):
        yield f"  and {counted(len(events) - len(listed), 'event')} more in events.csv"


def accuracy_lines(summary: Mapping[str, Any]) -> Iterator[str]:
    """Lines on the errors of distance, closing speed and tracks that were measured, of a run with
    ground truth.
    """
    yield f"Accuracy against the ground truth, {summary['frames']} frames:"
    for name, section, figures in (
        ("distance", summary["methods"].get("fused_kf"), _DISTANCE_FIGURES),
        (
            "within 25 %",
            summary["methods"].get("fused_kf"),
            "{within_25_percent:.1%} of the distances",
        ),
        (
            "closing speed",
            summary.get("closing"),
            "median error {median_error_mps:.2f} m/s, over {n} boxes",
        ),
        (
            "tracks",
            summary["tracks"],
            "IDF1 {idf1:.0f} %, MOTA {mota:.0f} %, {idsw} identity switches",
        ),
    ):
        with suppress(KeyError, TypeError):  # a figure is missing or None
            yield f"  {name:<14} {figures.format(**section or {})}"
