"""What happens in a recording, listed by eye, and the warnings on it.

A row of the file is an occurrence: a road user, the times at which it is first seen, at which its
path and ours conflict and at which it is nearest, and what a warning on it means. The warnings on a
row are on an object of its class group, from its first sight to its last moment (the conflict or
the nearest moment), with the tolerance of the row at both ends.

    right        hit      first warning no later than the conflict, with the lead to it
                 late     first warning after the conflict
                 missed   no warning
    tolerated    warnings count for nothing
    false        warnings are false alarms

A warning on no row is a false alarm too. A warning that fits several rows belongs to one on which
it is a hit, then late, then tolerated, then false, since the rows have no boxes; each warning lists
all rows that it fits. Further warnings on a row that is right count for nothing.

A row without a class names no road user: the recording is cut, and the scored part ends.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES, STATIC_CLASSES
from track_range.evaluation.events.scores import (
    Scores,
    are_same_class,
    expected_kind,
    road_classes,
    rounded,
    sections_of,
)
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.files.csv_tables import CsvTable, read_csv_table
from track_range.results.events.event import WARNING_KINDS, Event
from track_range.results.events.files import EventFileError

OCCURRENCE_COLUMNS = ("class", "first_visible_s", "nearest_s", "warning")
BY_OCCURRENCES = (
    "object of a warning: a row of the same class group (a person may also be the rider of a "
    "two-wheeler) at the time of the warning; of several rows the one on which the warning is a "
    "hit, else late, else tolerated, else false"
)

_MEANINGS = ("right", "tolerated", "false")
_USERS = tuple(name for name in ROAD_CLASSES if name not in STATIC_CLASSES)
_MOMENTS = ("first_visible", "conflict", "nearest")
_MAX_TIME_S = 1e9


@dataclass(frozen=True, slots=True)
class Occurrence:
    """A row of the file; times in seconds from the first frame, NaN = none."""

    what: str
    class_name: str  # road class; "" = the recording is cut
    first_visible_s: float
    conflict_s: float
    nearest_s: float
    tolerance_s: float
    warning: str  # "right", "tolerated" or "false"

    def standing(self, event: Event) -> str:
        """What a warning is on this row: hit, late, tolerated, false_alarm; "" = no fit."""
        is_rider = event.class_name == "person" and self.class_name in ("bicycle", "motorcycle")
        is_similar = is_rider or are_same_class(event.class_name, self.class_name)
        from_s = self.first_visible_s - self.tolerance_s
        to_s = np.fmax(self.conflict_s, self.nearest_s) + self.tolerance_s
        if not (self.class_name and is_similar and from_s <= event.warning_s <= to_s):
            return ""
        if self.warning == "right":
            return "hit" if event.warning_s <= self.conflict_s + self.tolerance_s else "late"
        return "tolerated" if self.warning == "tolerated" else "false_alarm"


# of a warning that fits several rows, the first one
_ORDER = ("hit", "late", "tolerated", "false_alarm")


def read_occurrences(path: Path) -> tuple[Occurrence, ...]:
    """Occurrences of a file, in its order; EventFileError if it cannot be read or lacks a valid
    value.
    """
    table = read_csv_table(
        path, EventFileError, f"what happens, with the columns {','.join(OCCURRENCE_COLUMNS)}"
    )
    table.require(OCCURRENCE_COLUMNS)
    meanings = [text.lower() for text in table.texts("warning")]
    table.check("warning", np.isin(meanings, _MEANINGS), "right, tolerated or false")
    is_right = np.array(meanings, np.str_) == "right"
    is_cut = np.array([not name for name in table.texts("class")], np.bool_) & ~is_right
    classes = road_classes(table, _USERS, is_blank_allowed=is_cut)
    first_s = _times_s(table, "first_visible_s", 0.0)
    times_s = (
        first_s,
        _times_s(table, "conflict_s", first_s, is_needed=is_right),
        _times_s(table, "nearest_s", first_s),
    )
    numbers = (column.tolist() for column in (*times_s, _tolerance_s(table)))
    columns = (table.texts("what"), classes, *numbers, meanings)
    return tuple(Occurrence(*row) for row in zip(*columns, strict=True))


def _times_s(
    table: CsvTable, name: str, since_s: FloatArray | float, is_needed: BoolArray | bool = True
) -> FloatArray:
    """Times of a column, none before `since_s`; NaN where a cell that is not needed is blank."""
    values = table.numbers(name)
    is_blank = np.array([not cell for cell in table.texts(name)], np.bool_)
    is_valid = (values >= since_s) & (values <= _MAX_TIME_S)
    since = "0" if name == "first_visible_s" else "first_visible_s"
    table.check(name, is_valid | is_blank & ~np.asarray(is_needed), f"seconds from {since}")
    return values


def _tolerance_s(table: CsvTable) -> FloatArray:
    """Tolerances of the rows; the frames and seconds of the file give the duration of a frame."""
    frames = np.array([table.numbers(f"{moment}_frame") for moment in _MOMENTS])
    times_s = np.array([table.numbers(f"{moment}_s") for moment in _MOMENTS])
    is_known = (frames > 0) & (times_s > 0)
    frame_s = float(np.median(times_s[is_known] / frames[is_known])) if is_known.any() else math.nan
    is_blank = np.array([not cell for cell in table.texts("frame_tolerance")], np.bool_)
    tolerance = np.where(is_blank, 0.0, table.numbers("frame_tolerance"))
    is_valid = (tolerance == 0) | (tolerance * frame_s > 0)
    expected = "frames from 0, and frame numbers beside the seconds, which give their duration,"
    table.check("frame_tolerance", is_valid, expected)
    return np.where(tolerance > 0, tolerance * frame_s, 0.0)


def end_of(occurrences: Sequence[Occurrence]) -> float:
    """Time of the first cut of the recording; inf = it is not cut."""
    return min((one.first_visible_s for one in occurrences if not one.class_name), default=math.inf)


def occurrence_scores(
    warnings: Sequence[Event],
    occurrences: Sequence[Occurrence],
    *,
    part_s: tuple[float, float],
    hours: float | None,
) -> Scores:
    """Scores of the collision warnings of a drive of `hours`, None = unknown, against what happens
    in it.

    Rows whose moments are not all in the scored part `part_s`, from and to, are not evaluated,
    unless there is a warning on them.
    """
    warning_rows, on_row = _assigned(warnings, occurrences)
    rows = [_row(one, on_row.get(i, []), part_s) for i, one in enumerate(occurrences)]
    row_outcomes = [row["outcome"] for row in rows]
    outcomes = [warning["outcome"] for warning in warning_rows]
    results = [
        (row["kind"], "hits" if row["outcome"] == "hit" else "misses", row["lead_s"])
        for row in rows
        if row["outcome"] in ("hit", "late", "missed")
    ]
    false = [one["kind"] for one in warning_rows if one["outcome"] == "false_alarm"]
    results += [(kind, "false_alarms", None) for kind in false]
    sections = sections_of(results, WARNING_KINDS, hours)
    sections["overall"] |= {
        "late": row_outcomes.count("late"),
        "tolerated": outcomes.count("tolerated"),
        "repeated": outcomes.count("repeated"),
        "ambiguous": sum(len(warning["fits_rows"]) > 1 for warning in warning_rows),
    }
    return {**sections, "occurrences": rows, "warnings": warning_rows}


def _assigned(
    warnings: Sequence[Event], occurrences: Sequence[Occurrence]
) -> tuple[list[dict[str, Any]], dict[int, list[Event]]]:
    """Result of each warning in the order of time, and the warnings on each occurrence."""
    on_row: dict[int, list[Event]] = {}
    rows: list[dict[str, Any]] = []
    for event in sorted(warnings, key=lambda one: one.warning_s):
        fits = {i: fit for i, one in enumerate(occurrences) if (fit := one.standing(event))}
        order = sorted((_ORDER.index(fit), i in on_row, i) for i, fit in fits.items())
        row, outcome = None, "false_alarm"
        if order:
            _, is_warned, row = order[0]
            is_repeated = is_warned and occurrences[row].warning == "right"
            outcome = "repeated" if is_repeated else fits[row]
            on_row.setdefault(row, []).append(event)
        rows.append(
            {
                "kind": event.kind,
                "warning_s": rounded(event.warning_s),
                "track_id": event.track_id,
                "class": event.class_name,
                "outcome": outcome,
                "row": None if row is None else row + 1,
                "fits_rows": [i + 1 for i in fits],
            }
        )
    return rows, on_row


def _row(one: Occurrence, warnings: Sequence[Event], part_s: tuple[float, float]) -> dict[str, Any]:
    """Result of an occurrence: its columns, `outcome`, `kind`, and times and lead of its
    warnings.
    """
    has_conflict = math.isfinite(one.conflict_s)
    decisive_s = one.conflict_s if has_conflict else one.nearest_s
    is_in_part = part_s[0] <= one.first_visible_s and decisive_s <= part_s[1]
    kind, outcome, lead_s = expected_kind(one.class_name), "quiet", None
    if not one.class_name:
        outcome = "cut"
    elif warnings:
        kind, outcome = warnings[0].kind, one.standing(warnings[0])
        lead_s = rounded(one.conflict_s - warnings[0].warning_s) if has_conflict else None
    elif not is_in_part:
        outcome = "not_evaluated"
    elif one.warning == "right":
        outcome = "missed"
    return {
        "what": one.what,
        "class": one.class_name,
        "first_visible_s": rounded(one.first_visible_s),
        "conflict_s": rounded(one.conflict_s) if has_conflict else None,
        "nearest_s": rounded(one.nearest_s),
        "tolerance_s": rounded(one.tolerance_s),
        "warning": one.warning,
        "outcome": outcome,
        "kind": kind,
        "warnings_s": [rounded(event.warning_s) for event in warnings],
        "lead_s": lead_s,
    }
