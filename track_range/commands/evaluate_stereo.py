"""`track-range evaluate stereo`: stereo matchers side by side on pairs whose true disparities are known."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from track_range.calibration.drive_pairs import is_drive, read_drive
from track_range.foundation.errors import UsageError
from track_range.report import tables
from track_range.run.progress import say, step_progress
from track_range.stereo.alignment.file import load_alignment
from track_range.stereo.alignment.from_reference import fit_reference
from track_range.stereo.alignment.model import Alignment
from track_range.stereo.evaluation.disparity_errors import (
    Column,
    common_figures,
    corrected,
    left_out_alignments,
    matcher_figures,
)
from track_range.stereo.evaluation.kitti_2015 import PairFileError, StereoPair, is_kitti_2015, pair_names, read_pairs
from track_range.stereo.matching.box_matchers import MATCHER_NAMES, Measured, measure_pairs
from track_range.terminal_tables import tell_grid

OFF, LEAVE_TWO_OUT = "off", "leave-two-out"
DEFAULT_MATCHERS = "patch,sgbm,sgbm-centre,sgbm-hh"


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoTest:
    """What is measured on what.

    Attributes:
        pairs: folder in KITTI 2015's layout, or of a drive with labels.
        rig: a rig file; None = the folder's own.
        matchers: names, see `stereo.box_matchers`.
        align: "off", "leave-two-out", or an alignment file.
        seed: of the bootstrap.
    """

    pairs: Path
    rig: Path | None = None
    matchers: tuple[str, ...] = tuple(DEFAULT_MATCHERS.split(","))
    align: str = OFF
    seed: int = 0


def evaluate_stereo(test: StereoTest, *, console: Console) -> dict[str, Any]:
    """Figures as `--json` keeps them, printed as tables.

    Raises:
        UsageError: an unknown matcher, or leave-two-out where there are no pairs to leave out.
        PairFileError, RigError, VideoError, LabelFileError: the pairs, their rig, the alignment cannot be used.
    """
    _check_names(test.matchers)
    known = None if test.align in (OFF, LEAVE_TWO_OUT) else load_alignment(Path(test.align))
    n_pairs = _expected(test)
    with step_progress(console, "pairs") as advance:
        pairs = _counted(_pairs(test, known), advance, n_pairs)
        measured = measure_pairs(pairs, test.matchers)
    if not len(measured.objects):
        raise PairFileError(f"{test.pairs}: no object in it of which enough is known to measure against.")
    columns, alignment = _aligned(measured, test, known)
    found = _with_times(matcher_figures(columns, measured.objects, seed=test.seed), measured)
    figures = {
        "pairs": str(test.pairs),
        "n_pairs": len(measured.objects.cameras),
        "n_objects": len(measured.objects),
        "align": test.align,
        "alignment": alignment,
        "matchers": found,
        "common": common_figures(columns, measured.objects, seed=test.seed) if len(columns) > 1 else {},
        "notes": list(measured.notes),
    }
    _tell(figures, console)
    return figures


def _check_names(names: Sequence[str]) -> None:
    for name in names:
        if name not in MATCHER_NAMES:
            raise UsageError(f"--matcher: '{name}' is no matcher; there are: {', '.join(MATCHER_NAMES)}.")
    if len(set(names)) < len(names):
        raise UsageError("--matcher: one is named twice.")


def _expected(test: StereoTest) -> int | None:
    """How many pairs there are, where it is known beforehand."""
    if not (is_kitti_2015(test.pairs) or is_drive(test.pairs)):
        raise PairFileError(
            f"{test.pairs}: neither a set like KITTI 2015 (image_2, image_3, disp_occ_0, obj_map) nor a drive "
            "(left.mp4, right.mp4 and truth.csv or truth.txt) is there."
        )
    if not is_kitti_2015(test.pairs):
        if test.align == LEAVE_TWO_OUT:
            raise UsageError(f"--align {LEAVE_TWO_OUT} is for sets of single pairs, and {test.pairs} is a drive.")
        return None
    n_pairs = len(pair_names(test.pairs))
    if test.align == LEAVE_TWO_OUT and n_pairs < 4:
        raise UsageError(f"--align {LEAVE_TWO_OUT}: at least 4 pairs wanted, {test.pairs} has {n_pairs}.")
    return n_pairs


def _pairs(test: StereoTest, known: Alignment | None) -> Iterator[StereoPair]:
    row_offset_px = 0.0 if known is None else known.rows_to_move_px
    read = read_pairs if is_kitti_2015(test.pairs) else read_drive
    return read(test.pairs, rig=test.rig, row_offset_px=row_offset_px)


def _counted(pairs: Iterator[StereoPair], advance: Any, n_pairs: int | None) -> Iterator[StereoPair]:
    for number, pair in enumerate(pairs):
        yield pair
        advance(number + 1, n_pairs)


def _aligned(measured: Measured, test: StereoTest, known: Alignment | None) -> tuple[dict[str, Column], Any]:
    """The columns put right, and what by, for the figures."""
    objects, columns = measured.objects, measured.columns
    n_pairs = len(objects.cameras)
    if test.align != LEAVE_TWO_OUT:
        alignment = known or Alignment()
        everywhere = dict.fromkeys(range(n_pairs), alignment)
        return {name: corrected(column, objects, everywhere) for name, column in columns.items()}, asdict(alignment)
    by_pair = {
        name: left_out_alignments(column, objects, fit_reference, seed=test.seed) for name, column in columns.items()
    }
    told = {
        name: {"mean_offset_px": float(np.mean([each.offset_px for each in found.values()]))}
        for name, found in by_pair.items()
    }
    return {name: corrected(column, objects, by_pair[name]) for name, column in columns.items()}, told


def _with_times(figures: dict[str, dict[str, Any]], measured: Measured) -> dict[str, dict[str, Any]]:
    return {name: {**found, "ms_per_frame": round(measured.ms_per_frame[name], 3)} for name, found in figures.items()}


_SIGMA = tables.SIGMA
_Rows = Mapping[str, Mapping[str, Any]]
_Wanted = tuple[str, str, str, float, tables.Cost | None]
"""Heading, key, format, factor and cost of a column, as `tables.METHOD_COLUMNS`."""

_COLUMNS: tuple[_Wanted, ...] = (
    ("cover %", "coverage", "{:.1f}", 100.0, lambda value: -value),
    ("n", "n", "{:.0f}", 1.0, None),
    ("fail %", "failures_pct", "{:.1f}", 1.0, abs),
    ("median %", "median_relative_error_pct", "{:.2f}", 1.0, abs),
    ("mean %", "mean_relative_error_pct", "{:.2f}", 1.0, abs),
    ("95 %", "p95_relative_error_pct", "{:.2f}", 1.0, abs),
    ("bias %", "bias_pct", "{:+.2f}", 1.0, abs),
    ("error px", "median_abs_error_px", "{:.3f}", 1.0, abs),
)
_MORE_COLUMNS: tuple[_Wanted, ...] = (
    (f"in 1{_SIGMA} %", "within_1_sigma", "{:.0f}", 100.0, tables.from_normal(tables.WITHIN_1_SIGMA)),
    (f"in 2{_SIGMA} %", "within_2_sigma", "{:.0f}", 100.0, tables.from_normal(tables.WITHIN_2_SIGMA)),
    ("ms/frame", "ms_per_frame", "{:.1f}", 1.0, abs),
)
_INTERVALS = (
    ("fail %", "failures_pct", "{:.1f} .. {:.1f}"),
    ("median %", "median_relative_error_pct", "{:.2f} .. {:.2f}"),
    ("95 %", "p95_relative_error_pct", "{:.2f} .. {:.2f}"),
    ("bias %", "bias_pct", "{:+.2f} .. {:+.2f}"),
)


def _tell(figures: Mapping[str, Any], console: Console) -> None:
    title = f"{figures['n_objects']} objects in {figures['n_pairs']} pairs, alignment {figures['align']}"
    matchers = figures["matchers"]
    tell_grid(console, _grid(title, matchers, _COLUMNS))
    tell_grid(console, _more_grid(matchers))
    tell_grid(console, _interval_grid(matchers))
    common = figures["common"]
    if common:
        n_common = next(iter(common.values()))["n"]
        title = f"On the {n_common} objects that all matchers measured"
        tell_grid(console, _grid(title, common, _COLUMNS[1:]))
    for note in figures["notes"]:
        say(console, note)


def _grid(title: str, matchers: _Rows, wanted: Sequence[_Wanted]) -> tables.Grid:
    return tables.grid_of(title, "matcher", list(matchers), _columns(matchers, wanted))


def _more_grid(matchers: _Rows) -> tables.Grid:
    """Medians by band of distance, how honest sigma is, and time."""
    rows = list(matchers.values())
    columns = []
    for number, band in enumerate(rows[0]["bands"]):
        medians = [tables.figure(row["bands"][number], "median_relative_error_pct") for row in rows]
        heading = f"{band['from_m']:g}-{band['to_m']:g} m (n={band['n']})"
        columns.append(tables.Column(heading, medians, "{:.2f}", cost=abs))
    title = "Median error % by true distance, sigma, time"
    return tables.grid_of(title, "matcher", list(matchers), [*columns, *_columns(matchers, _MORE_COLUMNS)])


def _columns(matchers: _Rows, wanted: Sequence[_Wanted]) -> list[tables.Column]:
    return [
        tables.Column(heading, [tables.figure(row, key) for row in matchers.values()], pattern, scale, cost)
        for heading, key, pattern, scale, cost in wanted
    ]


def _interval_grid(matchers: _Rows) -> tables.Grid:
    """95 % bootstrap intervals, matcher by matcher."""
    lines = []
    for name, found in matchers.items():
        ends = [(pattern, found["intervals"].get(key)) for _, key, pattern in _INTERVALS]
        texts = [tables.NOTHING if pair is None else pattern.format(*pair) for pattern, pair in ends]
        lines.append((tables.Cell(name), *(tables.Cell(text) for text in texts)))
    heads = ("matcher", *(heading for heading, _, _ in _INTERVALS))
    return tables.Grid("95 % intervals (bootstrap over pairs, or a drive's tracks)", heads, tuple(lines))
