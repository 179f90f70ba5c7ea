"""What happened in a run, for the terminal and notebooks: the extremes of each class, and the events."""

import html
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.files.input_files import counted
from track_range.results.events.event import Event, severity_key
from track_range.views.report.content.events import kind_words, object_words, sigma_words, time_words
from track_range.views.report.sentences import event_headline
from track_range.views.report.tables import NOTHING, Cell, Grid

MOST_EVENTS = 5  # that are listed in the terminal, the most severe ones
_EXTREMES = (  # heading, key, key of its sigma and sign of the value that comes first
    ("nearest m", "min_distance_m", "min_distance_sigma_m", 1),
    ("closing m/s", "max_closing_mps", "max_closing_sigma_mps", -1),
    ("TTC s", "min_ttc_front_s", "", 1),
)


def class_grid(users: Sequence[Mapping[str, Any]]) -> Grid:
    """One row per class of `closest_approaches`: their number, and each extreme with its track and time."""
    headings = [text for heading, *_ in _EXTREMES for text in (heading, "track and time")]
    names = sorted({user["class"] for user in users}, key=ROAD_CLASSES.index)
    rows = []
    for name in names:
        own = [user for user in users if user["class"] == name]
        cells = [name, str(len(own))]
        for _, key, sigma_key, sign in _EXTREMES:
            first = min(
                (user for user in own if user[key] is not None), key=lambda user: sign * user[key], default=None
            )
            cells += [NOTHING, NOTHING] if first is None else _extreme(first, key, sigma_key)
        rows.append(tuple(map(Cell, cells)))
    return Grid("Road users", ("class", "number", *headings), tuple(rows))


def user_grid(users: Sequence[Mapping[str, Any]], most: int) -> Grid:
    """One row per road user of `closest_approaches`, the nearest `most`."""
    headings = [text for heading, *_ in _EXTREMES for text in (heading, "time")]
    rows = []
    for user in users[:most]:
        cells = [f"{user['class']} {user['track_id']}"]
        for _, key, sigma_key, _ in _EXTREMES:
            cells += [NOTHING, NOTHING] if user[key] is None else _extreme(user, key, sigma_key, named=False)
        rows.append(tuple(map(Cell, cells)))
    title = "Closest approaches" if len(users) <= most else f"The {most} closest approaches of {len(users)}"
    return Grid(title, ("road user", *headings), tuple(rows))


def html_table(grid: Grid) -> str:
    """A grid as an HTML table, "" without rows."""
    lines = [("th", grid.columns), *(("td", [cell.text for cell in row]) for row in grid.rows)]
    rows = ("".join(f"<{tag}>{html.escape(text)}</{tag}>" for text in texts) for tag, texts in lines)
    return f"<p>{html.escape(grid.title)}</p><table><tr>{'</tr><tr>'.join(rows)}</tr></table>" if grid.rows else ""


def _extreme(user: Mapping[str, Any], key: str, sigma_key: str, *, named: bool = True) -> list[str]:
    sigma = user[sigma_key] if sigma_key else None
    time = time_words(user[f"{key}_at_s"])
    value = f"{user[key]:.1f}" if sigma is None else f"{user[key]:.1f} ±{sigma_words(sigma)}"
    return [value, f"{user['track_id']} at {time}" if named else time]


def event_lines(events: Sequence[Event]) -> Iterator[str]:
    """The warnings or the number of events in one line, then a line for each of the most severe events."""
    headline = event_headline(events)
    yield f"{headline['figure']}: {headline['words']}."
    listed = sorted(sorted(events, key=severity_key)[:MOST_EVENTS], key=lambda event: event.start_s)
    for event in listed:
        yield f"  {time_words(event.start_s):>7}  {kind_words(event.kind)}, {object_words(event)}: {event.reason}"
    if len(events) > len(listed):
        yield f"  and {counted(len(events) - len(listed), 'event')} more in events.csv"
