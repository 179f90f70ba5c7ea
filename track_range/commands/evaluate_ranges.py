"""`track-range evaluate ranges`: box-only methods on labelled boxes with true distances; no video needed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from rich.console import Console

from track_range.foundation.errors import UsageError
from track_range.ranging.evaluation.box_evaluation import closing_figures, figures, folds
from track_range.ranging.evaluation.box_filters import FilterName, filtered
from track_range.ranging.evaluation.box_methods import MethodOptions, measured_by, method_names
from track_range.ranging.fitting.labelled_boxes import BoxSet, box_set
from track_range.report import tables
from track_range.results.output_files import write_text
from track_range.terminal_tables import tell_grid

FitOn = Literal["labels", "boxes"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RangesTest:
    """What is measured on what.

    Attributes:
        labels: folder of KITTI label files.
        calib: folder of calib files of the same names.
        boxes: "labels", or "rrc:DIR".
        noise_px: standard deviation of noise on every edge.
        seed: of the noise.
        filter_name: of the filter over time.
        is_cross_validated: refit the size curves leaving sequences out, in place of the packaged or given ones.
        is_same_drive: fit on the very drive that is tested, as the paper did.
        fit_on: the boxes that curves are fitted on: the labels', or such as are measured.
        methods: names; empty = all.
        curves: a curve file; None = the packaged ones.
        camera_height_m: above the road, for the ground plane; None = not known.
    """

    labels: Path
    calib: Path
    boxes: str = "labels"
    noise_px: float = 0.0
    seed: int = 0
    filter_name: FilterName = "none"
    is_cross_validated: bool = False
    is_same_drive: bool = False
    fit_on: FitOn = "labels"
    methods: tuple[str, ...] = ()
    curves: Path | None = None
    camera_height_m: float | None = None


def evaluate_ranges(test: RangesTest, *, console: Console) -> dict[str, Any]:
    """Measure, print the tables and give the figures.

    Raises:
        LabelFileError, RigError, CurveError: labels, calibration or curves that cannot be used.
        UsageError: a method or boxes that are not there.
    """
    _check(test)
    boxes = box_set(test.labels, test.calib, boxes=test.boxes, noise_px=test.noise_px, seed=test.seed)
    is_exact = test.boxes == "labels" and test.noise_px == 0
    train = boxes if test.fit_on == "boxes" or is_exact else box_set(test.labels, test.calib)
    options = MethodOptions(
        curves=test.curves,
        is_cross_validated=test.is_cross_validated,
        is_same_drive=test.is_same_drive,
        box_sigma_px=test.noise_px if test.boxes == "labels" else None,
        camera_height_m=test.camera_height_m,
    )
    found = measured_by(test.methods or method_names(), boxes, train, options)
    methods: dict[str, Any] = {}
    for name, column in found.items():
        smooth = filtered(boxes, column, test.filter_name)
        scores = figures(boxes, smooth.column.distance_m, smooth.column.sigma_m)
        closing = closing_figures(boxes, smooth.closing_mps) if test.filter_name != "none" else {}
        methods[name] = {kind: {**score, **closing.get(kind, {})} for kind, score in scores.items()}
    told = _told(test, boxes, methods)
    for grid in grids(told):
        tell_grid(console, grid)
    for note in told["notes"]:
        console.print(f"- {note}", highlight=False, markup=False, soft_wrap=True)
    return told


def keep_ranges_figures(told: Mapping[str, Any], *, json_file: Path | None, table: Path | None) -> None:
    """Write the figures as JSON, and the tables as Markdown, where asked.

    Raises:
        OutputError: one cannot be written.
    """
    if json_file is not None:
        write_text(json_file, json.dumps(told, indent=2, allow_nan=False) + "\n")
    if table is not None:
        parts = [tables.markdown_table(grid) for grid in grids(told)]
        notes = "\n".join(f"- {note}" for note in told["notes"])
        write_text(table, "\n\n".join([*parts, notes]) + "\n")


def _check(test: RangesTest) -> None:
    unknown = [name for name in test.methods if name not in method_names()]
    if unknown:
        raise UsageError(f"--method {','.join(unknown)}: of {', '.join(method_names())}.")
    if test.boxes != "labels" and not (test.boxes.startswith("rrc:") and test.boxes != "rrc:"):
        raise UsageError(f"--boxes {test.boxes}: labels or rrc:DIR wanted.")
    if (test.is_cross_validated or test.is_same_drive) and test.curves is not None:
        raise UsageError("--cross-validate and --same-drive fit their own curves: leave --curves out.")
    if test.is_cross_validated and test.is_same_drive:
        raise UsageError("--cross-validate leaves out the drive that --same-drive fits on: give one of them.")


def _told(test: RangesTest, boxes: BoxSet, methods: Mapping[str, Any]) -> dict[str, Any]:
    n_sequences = len(boxes.sequence_names)
    return {
        "labels": str(test.labels),
        "boxes": test.boxes,
        "noise_px": test.noise_px,
        "seed": test.seed,
        "filter": test.filter_name,
        "cross_validated": test.is_cross_validated,
        "same_drive": test.is_same_drive,
        "fit_on": test.fit_on,
        "camera_height_m": test.camera_height_m,
        "n_boxes": len(boxes),
        "n_sequences": n_sequences,
        "methods": dict(methods),
        "notes": list(_notes(test, n_sequences, len(list(folds(boxes))))),
    }


def _notes(test: RangesTest, n_sequences: int, n_folds: int) -> list[str]:
    which = f"leaving out what they are tested on, {n_folds} folds over {n_sequences} sequences"
    if test.is_same_drive:
        which = "each drive on itself alone, which says nothing of other drives (how the paper was measured)"
    elif n_sequences == 1:
        which = "the one sequence there is, and tested on the same boxes"
    fitted = "the labels' exact boxes" if test.fit_on == "labels" else "boxes such as are measured"
    is_refitted = test.is_cross_validated or test.is_same_drive
    own = "refitted in the same way" if is_refitted else f"{test.curves or 'the packaged ones'}"
    notes = [
        "Truth: z at which the ray through the label's box centre meets its 3-D box; labels at 5-100 m, not truncated, "
        "occluded <= 1; a class's figures over 10-100 m, far ones over 30-100 m, bands over 5-100 m.",
        f"Plain curves: fitted on {fitted}, {which}. Size curves of mono: {own}.",
    ]
    if test.filter_name != "none":
        notes.append("Filtered over time, ego speed unknown; closing speed against labels half a second either way.")
    return notes


_COLUMNS: tuple[tuple[str, str, str, float, tables.Cost | None], ...] = (
    ("cover %", "coverage", "{:.0f}", 100.0, None),
    ("n", "n", "{:.0f}", 1.0, None),
    ("mean %", "mean_relative_error_pct", "{:.2f}", 1.0, abs),
    ("median %", "median_relative_error_pct", "{:.2f}", 1.0, abs),
    ("bias %", "bias_pct", "{:+.2f}", 1.0, abs),
    (f"in 1{tables.SIGMA} %", "within_1_sigma", "{:.0f}", 100.0, tables.from_normal(tables.WITHIN_1_SIGMA)),
    (f"in 2{tables.SIGMA} %", "within_2_sigma", "{:.0f}", 100.0, tables.from_normal(tables.WITHIN_2_SIGMA)),
    ("rear %", "rear_view_pct", "{:.2f}", 1.0, abs),
    ("far %", "far_pct", "{:.2f}", 1.0, abs),
    ("rear,far %", "rear_view_far_pct", "{:.2f}", 1.0, abs),
    ("closing m/s", "closing_median_error_mps", "{:.2f}", 1.0, abs),
    ("95 % m/s", "closing_p95_error_mps", "{:.2f}", 1.0, abs),
)


def grids(told: Mapping[str, Any]) -> list[tables.Grid]:
    """A table per class, a row per method."""
    methods: Mapping[str, Mapping[str, Any]] = told["methods"]
    kinds = dict.fromkeys(kind for row in methods.values() for kind in row)
    return [_grid(kind, {name: row[kind] for name, row in methods.items() if kind in row}) for kind in kinds]


def _grid(kind: str, rows: Mapping[str, Mapping[str, Any]]) -> tables.Grid:
    columns = [
        tables.Column(heading, [tables.figure(row, key) for row in rows.values()], pattern, scale, cost)
        for heading, key, pattern, scale, cost in _COLUMNS
    ]
    bands = [(band["from_m"], band["to_m"]) for band in next(iter(rows.values()))["bands"]]
    columns += [
        tables.Column(
            f"{low:g}-{high:g} m", [tables.band_error_pct(row, (low, high)) for row in rows.values()], cost=abs
        )
        for low, high in bands
    ]
    n_tracks = max(int(row["n_tracks"]) for row in rows.values())
    return tables.grid_of(f"{kind}: {n_tracks} tracks", "method", list(rows), columns)
