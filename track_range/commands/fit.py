"""`track-range fit`: size curves from a user's own labels, and the paper's Table 3 for every plain curve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from track_range.detection.formats.kitti import LabelFileError
from track_range.foundation.errors import UsageError
from track_range.ranging.evaluation.curve_comparison import TABLE_DISTANCES_M, CurveFit, compare_curves
from track_range.ranging.fitting.box_csv import read_box_csv
from track_range.ranging.fitting.labelled_boxes import BoxSet, box_set
from track_range.ranging.fitting.model_fit import CUBOIDS, LOG_LINEAR, MODEL_NAMES, SavedModel, fit_model, usable_boxes
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.log_linear import SizeCurve, SizeCurves
from track_range.ranging.size_models.tables import TableSizes
from track_range.report import tables
from track_range.terminal_tables import tell_grid


@dataclass(frozen=True, slots=True, kw_only=True)
class FitJob:
    """What is fitted on what.

    Attributes:
        labels: folder of KITTI label files, with
        calib: calib files of the same names; or
        csv: a file of boxes with distances,
        focal_px: whose focal length this is, where it has no column for it.
        leave_out: sequences kept for testing, by name.
        curve: of `MODEL_NAMES`; None = cuboids, or log-linear where there are no 3-D boxes.
        source: what the labels are; kept in the file.
        out: the curve file to write; None = only compare.
        is_compared: print the paper's Table 3 for all plain curves.
        picture: a PNG of all plain curves over the boxes.
    """

    labels: Path | None = None
    calib: Path | None = None
    csv: Path | None = None
    focal_px: float | None = None
    leave_out: str = ""
    curve: str | None = None
    source: str = ""
    out: Path | None = None
    is_compared: bool = False
    picture: Path | None = None


def fit_size_curves(job: FitJob, console: Console) -> None:
    """Read, fit, write and tell what `job` asks for.

    Raises:
        LabelFileError, RigError, CurveError: labels, calibration, or too few of them.
        UsageError: options that do not go together.
        OutputError: the picture cannot be written.
    """
    _check(job)
    boxes, notes = _boxes(job)
    usable = usable_boxes(boxes)
    if job.is_compared or job.picture is not None:
        _compare(usable.boxes, job, console)
    if job.out is not None:
        name = job.curve or (CUBOIDS if job.labels else LOG_LINEAR)
        model = fit_model(usable.boxes, name, source=_source(job, usable.boxes))
        model.save(job.out)
        tell_grid(console, _grid(name, model))
        console.print(f"Written to {job.out}", highlight=False)
    for note in (*notes, *(f"No curve of its own for {words}." for words in usable.refused)):
        console.print(f"- {note}", highlight=False, markup=False, soft_wrap=True)


def _check(job: FitJob) -> None:
    if (job.labels is None) == (job.csv is None):
        raise UsageError("give --labels with --calib, or --csv, and not both.")
    if job.labels is not None and job.calib is None:
        raise UsageError("--labels wants --calib, the folder of calib files: without, no focal length is known.")
    if job.out is None and not job.is_compared and job.picture is None:
        raise UsageError("nothing to do: give --out FILE for a curve file, or --compare.")
    if job.curve is not None and job.curve not in MODEL_NAMES:
        raise UsageError(f"--curve {job.curve}: of {', '.join(MODEL_NAMES)}.")
    if job.csv is not None and job.curve == CUBOIDS:
        raise UsageError("--curve cuboids wants labels with 3-D boxes (--labels); a CSV file has none.")


def _boxes(job: FitJob) -> tuple[BoxSet, tuple[str, ...]]:
    if job.csv is not None:
        boxes, notes = read_box_csv(job.csv, focal_px=job.focal_px)
    elif job.labels is not None and job.calib is not None:
        boxes, notes = box_set(job.labels, job.calib), ()
    else:
        raise UsageError("give --labels with --calib, or --csv.")
    excluded = {name.strip() for name in job.leave_out.split(",") if name.strip()}
    unknown = excluded - set(boxes.sequence_names)
    if unknown:  # a slip here would fit on what is kept for testing
        raise LabelFileError(f"{job.labels or job.csv}: no sequence {', '.join(sorted(unknown))} to leave out.")
    is_out = np.array([name in excluded for name in boxes.sequence_names])[boxes.sequence]
    return boxes.select(~is_out), notes


def _source(job: FitJob, boxes: BoxSet) -> str:
    place = job.labels or job.csv
    used = ", ".join(boxes.sequence_names[k] or "one" for k in np.unique(boxes.sequence))
    return f"{job.source or (place.name if place else '')}, sequences {used}"


def _compare(boxes: BoxSet, job: FitJob, console: Console) -> None:
    names = [str(name) for name in np.unique(boxes.class_name)]
    found = {name: compare_curves(boxes, name) for name in names}
    for fits in found.values():
        tell_grid(console, comparison_grid(fits))
    if job.picture is not None:
        points = {name: boxes.select(boxes.class_name == name) for name in names}
        from track_range.report.figures import curve_picture  # matplotlib takes a third of a second to load

        curve_picture(
            {name: (points[name].wh_over_f, points[name].distance_m, fits) for name, fits in found.items()}, job.picture
        )
        console.print(f"Drawn in {job.picture}", highlight=False)


def comparison_grid(fits: Sequence[CurveFit]) -> tables.Grid:
    """One class's curves, a row each."""
    columns = [
        tables.Column("residual m2", [fit.residual_m2 for fit in fits], "{:.0f}", cost=abs),
        tables.Column("fitted %", [fit.fitted_error_pct for fit in fits], "{:.2f}", cost=abs),
        tables.Column("other drives %", _known([fit.other_drives_error_pct for fit in fits]), "{:.2f}", cost=abs),
    ]
    for k, true_m in enumerate(TABLE_DISTANCES_M):
        columns.append(tables.Column(f"at {true_m:g} m", _known([fit.at_m[k] for fit in fits])))
    title = f"{fits[0].class_name}: {fits[0].n} boxes"
    return tables.grid_of(title, "curve", [fit.curve for fit in fits], columns)


def _known(values: Sequence[float]) -> list[float | None]:
    return [None if np.isnan(value) else value for value in values]


def _grid(name: str, model: SavedModel) -> tables.Grid:
    """A row per class: what was fitted."""
    if isinstance(model, CuboidSizes):
        priors = list(model.priors.values())
        columns = [
            tables.Column(f"{what} m", [prior.hwl_m[k] for prior in priors], "{:.2f}")
            for k, what in enumerate(("height", "width", "length"))
        ]
        columns.append(tables.Column("height +- %", [100 * prior.log_sigma[0] for prior in priors]))
        columns.append(tables.Column("objects", [prior.n_tracks for prior in priors], "{:.0f}"))
        columns.append(tables.Column("boxes", [prior.n_boxes for prior in priors], "{:.0f}"))
        return tables.grid_of("Priors over sizes", "class", list(model.priors), columns)
    if not isinstance(model, SizeCurves | TableSizes):
        raise TypeError(f"{name}: no table for {type(model).__name__}")
    curves = model.whole if isinstance(model, SizeCurves) else model.curves
    columns = [
        tables.Column(f"{tables.SIGMA} %", [100 * curve.sigma_relative for curve in curves.values()]),
        tables.Column("boxes", [curve.n for curve in curves.values()], "{:.0f}"),
    ]
    if isinstance(model, SizeCurves):
        columns = [*_coefficients(list(model.whole.values())), *columns]
    return tables.grid_of(f"Size curves: {name}", "class", list(curves), columns)


def _coefficients(curves: Sequence[SizeCurve]) -> list[tables.Column]:
    heads = ("intercept", "log height", "log width", "bearing")
    return [tables.Column(head, [curve.coefficients[k] for curve in curves], "{:.3f}") for k, head in enumerate(heads)]
