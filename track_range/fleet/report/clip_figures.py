"""Figures from the rows of clips.parquet: hours, errors, calibration drift, failures, notes,
throughput.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from datetime import datetime
from typing import TYPE_CHECKING

import numpy as np

from track_range.fleet.output.record import ERROR_FIGURES
from track_range.fleet.report.track_figures import Figures
from track_range.foundation.arrays import BoolArray, FloatArray

if TYPE_CHECKING:
    import pyarrow as pa

# vertical offset, and constant error of the disparities
ALIGNMENT_FIGURES = ("row_offset_px", "offset_px")
MIN_H = 0.1  # shortest video with rates per hour
MAX_GROUPS = 100  # largest number of rows of the calibration drift
# columns that group it, the first that exists
_GROUP_COLUMNS = ("vehicle", "label_vehicle", "camera", "rig")
_ENDS = 5  # number of clips whose median is the first or last value of a drift
_MAX_NAMED = 5  # largest number of clips that are named in a row
_MAX_ROWS = 20  # largest number of reasons, notes, nodes and clips in a table
_S_PER_H = 3600.0
_FILE = re.compile(r"^(?=[^\s/\\]*[/\\])\S*: ")  # at the start of an error
# what differs between messages of one kind: quoted names, and numbers, by themselves or as parts of
# names and versions
_VARIABLE = re.compile(
    r"'[^']*'|(?P<number>(?<![\w.,:/\\-])[+-]?\d+(?:\.\d+)?(?![\w/\\-]|[.,:]\w))|\d+(?:[.,]\d+)*"
)


class ClipColumns:
    """Rows of clips.parquet by column; a column that is missing or has another type than expected
    is empty.
    """

    def __init__(self, table: pa.Table) -> None:
        self._table = table
        self.names: list[str] = table.column_names

    def __len__(self) -> int:
        return int(self._table.num_rows)

    def where(self, rows: BoolArray) -> ClipColumns:
        """The rows of a mask (N,)."""
        import pyarrow as pa

        return ClipColumns(self._table.filter(pa.array(rows)))

    def with_status(self, status: str) -> ClipColumns:
        """The clips that are "done" or "failed"."""
        return self.where(np.array(self.texts("status"), np.str_) == status)

    def _has(self, name: str, *types: str) -> bool:
        import pyarrow as pa

        return name in self.names and any(
            getattr(pa.types, f"is_{kind}")(self._table.schema.field(name).type) for kind in types
        )

    def texts(self, name: str) -> list[str]:
        """Column as text; "" = null."""
        if name not in self.names or self._has(name, "nested"):
            return [""] * len(self)
        return ["" if value is None else str(value) for value in self._table[name].to_pylist()]

    def numbers(self, name: str) -> FloatArray:
        """Column (N,) as numbers; NaN = null, or not a column of numbers."""
        if not self._has(name, "floating", "integer"):
            return np.full(len(self), np.nan)
        values: FloatArray = self._table[name].cast("float64").to_numpy()
        return values

    def lists(self, name: str) -> list[list[str]]:
        """Column of lists of texts."""
        lists = self._table[name].to_pylist() if self._has(name, "list") else [None] * len(self)
        return [[str(text) for text in texts or ()] for texts in lists]

    def utc_s(self, name: str) -> FloatArray:
        """Column of times (N,) in ISO 8601 as Unix time; NaN = not a time, or without a time
        zone.
        """
        return np.array([_unix_time(text) for text in self.texts(name)], np.float64)

    def prefixes(self, suffix: str) -> list[str]:
        """The columns of numbers with a suffix, by name without this suffix, if they have a
        value.
        """
        names = [
            name.removesuffix(suffix)
            for name in self.names
            if name.endswith(suffix) and name != suffix
        ]
        return [name for name in names if np.isfinite(self.numbers(f"{name}{suffix}")).any()]


def _unix_time(text: str) -> float:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return float("nan")
    return moment.timestamp() if moment.tzinfo is not None else float("nan")


def video_s_by_hour(done: ClipColumns) -> dict[int | None, float]:
    """Seconds of video by hour of the day (UTC); None = clips without UTC."""
    seconds: dict[int | None, float] = defaultdict(float)
    durations_s = np.nan_to_num(done.numbers("seconds"), posinf=0.0, neginf=0.0)
    for start_s, duration_s in zip(
        done.utc_s("start_utc").tolist(), durations_s.tolist(), strict=True
    ):
        if not np.isfinite(start_s):
            seconds[None] += duration_s
            continue
        end_s = start_s + duration_s
        while start_s < end_s:
            hour_end_s = (start_s // _S_PER_H + 1) * _S_PER_H
            seconds[int(start_s // _S_PER_H % 24)] += min(end_s, hour_end_s) - start_s
            start_s = hour_end_s
    return dict(seconds)


def error_figures(done: ClipColumns) -> list[Figures]:
    """Median over the clips of each figure by method, and the clip with the largest median
    error.
    """
    rows = []
    for method in done.prefixes(f"_{ERROR_FIGURES[0]}"):
        errors_pct = done.numbers(f"{method}_{ERROR_FIGURES[0]}")
        worst = int(np.nanargmax(errors_pct))
        rows.append(
            {
                "method": method,
                "clips": int(np.isfinite(errors_pct).sum()),
                "coverage": _median(done.numbers(f"{method}_coverage")[np.isfinite(errors_pct)]),
                **{name: _median(done.numbers(f"{method}_{name}")) for name in ERROR_FIGURES},
                "worst_pct": float(errors_pct[worst]),
                "worst_clip": done.texts("clip")[worst],
            }
        )
    return sorted(rows, key=lambda row: str(row["method"]).endswith("_kf"))


def group_column(clips: ClipColumns, requested: str | None) -> str | None:
    """Column that groups the calibration drift; None = no such column."""
    if requested is not None:
        return requested if requested in clips.names else None
    return next((name for name in _GROUP_COLUMNS if any(clips.texts(name))), None)


def drift_figures(done: ClipColumns, group: str | None) -> list[Figures]:
    """Alignment of the pairs over time, per value of the column `group` (None = all clips in one
    row).

    At most `MAX_GROUPS` values with the largest changes are kept.

    Keys: group, clips, points (list of [Unix time or null, value] by figure), first, last and
    change by figure (medians of the first and last `_ENDS` dated clips), from_utc_s, to_utc_s.
    """
    values = {name: done.numbers(f"alignment_{name}") for name in ALIGNMENT_FIGURES}
    is_aligned = np.isfinite(np.array(list(values.values()))).any(axis=0)
    names = np.array(done.texts(group) if group is not None else ["all clips"] * len(done), np.str_)
    utc_s = done.utc_s("start_utc")
    rows = []
    for name in np.unique(names[is_aligned]):
        chosen = is_aligned & (names == name)
        row: Figures = {"group": str(name), "clips": int(chosen.sum())}
        dated = chosen & np.isfinite(utc_s)
        if dated.any():
            row |= {"from_utc_s": float(utc_s[dated].min()), "to_utc_s": float(utc_s[dated].max())}
        for figure in ALIGNMENT_FIGURES:
            row[figure] = _drift(utc_s[dated], values[figure][dated]) | {
                "median": _median(values[figure][chosen])
            }
        rows.append(row)
    if len(rows) > MAX_GROUPS:
        rows.sort(
            key=lambda row: -max(abs(row[figure]["change"] or 0.0) for figure in ALIGNMENT_FIGURES)
        )
        del rows[MAX_GROUPS:]
    return sorted(rows, key=lambda row: str(row["group"]))


def _drift(utc_s: FloatArray, values: FloatArray) -> Figures:
    known = np.isfinite(values)
    order = np.argsort(utc_s[known], kind="stable")
    utc_s, values = utc_s[known][order], values[known][order]
    n = min(_ENDS, max(1, len(values) // 2))
    first, last = _median(values[:n]), _median(values[-n:])
    return {
        "first": first,
        "last": last,
        "change": last - first
        if first is not None and last is not None and len(values) > 1
        else None,
        "points": np.stack([utc_s, values], axis=1).tolist(),
    }


def failure_figures(failed: ClipColumns) -> list[Figures]:
    """Failed clips by kind and reason, most frequent first; file names and numbers do not
    distinguish reasons.
    """
    by_reason: dict[tuple[str, str], list[tuple[str, str]]] = defaultdict(list)
    for clip, kind, error, left in zip(
        *map(failed.texts, ("clip", "error_kind", "error", "left")), strict=True
    ):
        is_of_left = left and error.startswith(f"{left}: ")
        reason = error[len(left) + 2 :] if is_of_left else _FILE.sub("", error)
        by_reason[kind or "unknown", _pattern(reason)].append((clip, reason))
    groups = sorted(by_reason.items(), key=lambda item: (-len(item[1]), item[0]))
    return [
        {
            "kind": kind,
            "reason": _merged(reasons),
            "n": len(reasons),
            "clips": list(names[:_MAX_NAMED]),
        }
        for (kind, _), clips in groups[:_MAX_ROWS]
        for names, reasons in [zip(*clips, strict=True)]
    ]


def _pattern(text: str) -> str:
    """A text in which numbers and quoted names are replaced."""
    return _VARIABLE.sub("\0", text)


def _merged(texts: Sequence[str]) -> str:
    """The first of the texts of one pattern, with the range of each number that differs: "682 to
    933 px".
    """
    columns = zip(
        *([match["number"] for match in _VARIABLE.finditer(text)] for text in texts), strict=True
    )

    def merged(match: re.Match[str]) -> str:
        numbers = next(columns)
        if match["number"] is None or None in numbers:
            return match[0]
        low, high = (pick(numbers, key=float) for pick in (min, max))
        return match[0] if float(low) == float(high) else f"{low} to {high}"

    return _VARIABLE.sub(merged, texts[0])


def note_figures(done: ClipColumns) -> list[Figures]:
    """Most frequent notes of the runs, with the ranges of their numbers, the number of clips and
    one of the clips.
    """
    groups: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for clip, notes in zip(done.texts("clip"), done.lists("warnings"), strict=True):
        for pattern, note in {_pattern(note): note for note in notes}.items():
            groups[pattern].append((clip, note))
    shown = sorted(groups.values(), key=lambda group: -len(group))[: _MAX_ROWS // 2]
    return [
        {"n": len(group), "note": _merged([note for _, note in group]), "clip": group[0][0]}
        for group in shown
    ]


def stage_figures(done: ClipColumns) -> dict[str, float]:
    """Mean time of each stage in ms per frame, over all frames."""
    frames = done.numbers("frames")
    means = {}
    for name in done.prefixes("_ms"):
        ms = done.numbers(f"{name}_ms")
        known = np.isfinite(ms) & (frames > 0)
        if known.any() and ms[known].any():
            means[name] = float(np.average(ms[known], weights=frames[known]))
    return means


def node_figures(done: ClipColumns) -> list[Figures]:
    """Clips, time and memory by node, busiest first."""
    names = np.array(done.texts("node"), np.str_)
    rows = []
    for name in np.unique(names):
        chosen = done.where(names == name)
        memory_mb = chosen.numbers("peak_memory_mb")
        rows.append(
            {
                "node": str(name) or "unknown",
                "clips": len(chosen),
                **work_figures(chosen),
                "median_memory_mb": _median(memory_mb),
                "max_memory_mb": float(np.nanmax(memory_mb))
                if np.isfinite(memory_mb).any()
                else None,
            }
        )
    return sorted(rows, key=lambda row: -row["worker_h"])[:_MAX_ROWS]


def work_figures(done: ClipColumns) -> Figures:
    """Hours of video and of workers, speed of a worker, and time per clip outside the run."""
    video_s, worker_s, frames = (
        float(np.nansum(done.numbers(name))) for name in ("seconds", "wall_s", "frames")
    )
    return {
        "video_h": video_s / _S_PER_H,
        "worker_h": worker_s / _S_PER_H,
        "frames_per_worker_s": frames / worker_s if worker_s > 0 else None,
        "video_s_per_worker_s": video_s / worker_s if worker_s > 0 else None,
        "median_overhead_s": _median(done.numbers("overhead_s")),
    }


def _median(values: FloatArray | Sequence[float]) -> float | None:
    known = np.asarray(values)[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None
