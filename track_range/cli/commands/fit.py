"""`track-range fit`: fits size curves to labels, and compares the curves of one measure of the box."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from track_range.cli.console import console, print_grid, print_line, print_notes
from track_range.cli.parameters import command
from track_range.ranging.fitting.fit import TABLE_DISTANCES_M, CurveFit, fit_sizes
from track_range.ranging.fitting.settings import FitSettings
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.log_linear import SizeCurves
from track_range.ranging.size_models.plain_curves import TableSizes
from track_range.ranging.size_models.size_model import StoredSizeModel
from track_range.views.report import tables


def _fit(settings: FitSettings) -> None:
    fitted = fit_sizes(settings)
    for curves in fitted.comparison.values():
        print_grid(console, _comparison_grid(curves))
    if settings.picture is not None:
        from track_range.views.report.figures import curve_picture  # imports matplotlib: a third of a second

        points = {name: fitted.boxes.select(fitted.boxes.class_name == name) for name in fitted.comparison}
        curve_picture(
            {name: (points[name].wh_over_f, points[name].distance_m, fitted.comparison[name]) for name in points},
            settings.picture,
        )
        print_line(console, f"Written: {settings.picture}")
    if fitted.model is not None:
        print_grid(console, _model_grid(fitted.name, fitted.model))
        print_line(console, f"Written: {settings.out}")
    print_notes(console, fitted.notes)


def _comparison_grid(fits: Sequence[CurveFit]) -> tables.Grid:
    """Table of the curves of one class, a row per curve."""
    columns = [
        tables.Column("residual m2", [fit.residual_m2 for fit in fits], "{:.0f}", cost=abs),
        tables.Column("fitted %", [fit.fitted_error_pct for fit in fits], "{:.2f}", cost=abs),
        tables.Column("other sequences %", _known([fit.other_drives_error_pct for fit in fits]), "{:.2f}", cost=abs),
    ]
    for k, true_m in enumerate(TABLE_DISTANCES_M):
        columns.append(tables.Column(f"at {true_m:g} m", _known([fit.at_m[k] for fit in fits])))
    title = f"{fits[0].class_name}: {fits[0].n} boxes"
    return tables.grid_of(title, "curve", [fit.curve for fit in fits], columns)


def _known(values: Sequence[float]) -> list[float | None]:
    return [None if np.isnan(value) else value for value in values]


def _model_grid(name: str, model: StoredSizeModel) -> tables.Grid:
    """Table of a fitted model, a row per class."""
    if isinstance(model, CuboidSizes):
        priors = list(model.priors.values())
        columns = [
            tables.Column(f"{what} m", [prior.hwl_m[k] for prior in priors], "{:.2f}")
            for k, what in enumerate(("height", "width", "length"))
        ]
        columns += [
            tables.Column("height ± %", [100 * prior.log_sigma[0] for prior in priors]),
            tables.Column("objects", [prior.n_tracks for prior in priors], "{:.0f}"),
            tables.Column("boxes", [prior.n_boxes for prior in priors], "{:.0f}"),
        ]
        return tables.grid_of("Priors over sizes", "class", list(model.priors), columns)
    if not isinstance(model, SizeCurves | TableSizes):
        raise TypeError(f"{name}: no table for {type(model).__name__}")
    curves = model.whole if isinstance(model, SizeCurves) else model.curves
    columns = [
        tables.Column(f"{tables.SIGMA} %", [100 * curve.sigma_relative for curve in curves.values()]),
        tables.Column("boxes", [curve.n for curve in curves.values()], "{:.0f}"),
    ]
    if isinstance(model, SizeCurves):
        heads = ("intercept", "log height", "log width", "bearing")
        columns[:0] = [
            tables.Column(head, [curve.coefficients[k] for curve in model.whole.values()], "{:.3f}")
            for k, head in enumerate(heads)
        ]
    return tables.grid_of(f"Size curves: {name}", "class", list(curves), columns)


app = command(FitSettings, _fit)
