"""`track-range evaluate stereo`: distance errors of stereo matchers on pairs with true
disparities.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from track_range.calibration.settings import StereoEvaluationSettings
from track_range.cli.commands.evaluate import result_files
from track_range.cli.shared.console import console, print_grid, print_line
from track_range.cli.shared.parameters import command
from track_range.evaluation.stereo_evaluation import evaluate_stereo
from track_range.foundation.files.output_files import write_json
from track_range.foundation.processes import one_opencv_thread
from track_range.run.progress import step_progress
from track_range.views import tables
from track_range.views.method_comparison import comparison_grid, unmarked


class StereoOptions(StereoEvaluationSettings):
    """Options of `track-range evaluate stereo`."""

    json_file: result_files.JsonField = None
    figure: result_files.RiskFigureField = None


def _stereo(options: StereoOptions) -> None:
    result_files.check_result_files(options)
    with one_opencv_thread():  # for comparable times per frame
        figures = evaluate_stereo(options, partial(step_progress, console))
    _print(figures)
    result_files.draw_risk(_curves(figures), options.figure)
    write_json(options.json_file, figures)


_Rows = Mapping[str, Mapping[str, Any]]
_COLUMNS: tuple[tables.ColumnSpec, ...] = (
    ("coverage %", "coverage", "{:.1f}", 100.0, tables.largest),
    ("n", "n", "{:.0f}"),
    ("failed %", "failures_pct", "{:.1f}", 1.0, abs),
    ("median %", "median_relative_error_pct", "{:.2f}", 1.0, abs),
    ("mean %", "mean_relative_error_pct", "{:.2f}", 1.0, abs),
    ("95 %", "p95_relative_error_pct", "{:.2f}", 1.0, abs),
    ("bias %", "bias_pct", "{:+.2f}", 1.0, abs),
    ("error px", "median_abs_error_px", "{:.3f}", 1.0, abs),
)
_MORE_COLUMNS: tuple[tables.ColumnSpec, ...] = (
    *tables.NEAR_NORMAL,
    ("ms/frame", "ms_per_frame", "{:.1f}", 1.0, abs),
)
_INTERVALS = (  # heading, key and format of each column
    ("failed %", "failures_pct", "{:.1f} .. {:.1f}"),
    ("median %", "median_relative_error_pct", "{:.2f} .. {:.2f}"),
    ("95 %", "p95_relative_error_pct", "{:.2f} .. {:.2f}"),
    ("bias %", "bias_pct", "{:+.2f} .. {:+.2f}"),
)


def _print(figures: Mapping[str, Any]) -> None:
    title = (
        f"{figures['n_objects']} objects in {figures['n_pairs']} pairs, alignment "
        f"{figures['align']}"
    )
    matchers, common = figures["matchers"], figures["common"]
    shown = (_grid(title, matchers, _COLUMNS), _more_grid(matchers))
    print_grid(console, *map(unmarked, shown), _interval_grid(matchers))
    print_grid(console, *_comparison_grids(figures["comparison"]))
    if common:
        n_common = next(iter(common.values()))["n"]
        title = f"On common coverage ({n_common} objects measured by all matchers)"
        print_grid(console, unmarked(_grid(title, common, _COLUMNS[1:])))
    print_grid(console, *result_files.risk_grids(_curves(figures)))
    print_line(console, *figures["notes"])


def _comparison_grids(comparison: Mapping[str, Any]) -> Iterator[tables.Grid]:
    """Tables of the differences of the matchers: median error on common objects, and failures."""
    headings = {"median_relative_error_pct": "median %", "failures_pct": "failed %"}
    for key, compared in comparison.items():
        n_common, n = compared["n_common"], compared["n"]
        title = f"Compared on {n_common} of {n} objects, {compared['n_blocks']} pairs or tracks"
        n_measured = compared["n_measured"]
        yield comparison_grid(title, compared, n_measured, key=key, heading=headings[key])


def _grid(title: str, matchers: _Rows, specs: Sequence[tables.ColumnSpec]) -> tables.Grid:
    return tables.grid_of(
        title, "matcher", list(matchers), tables.columns_of(matchers.values(), specs)
    )


def _more_grid(matchers: _Rows) -> tables.Grid:
    rows = list(matchers.values())
    columns = []
    for number, band in enumerate(rows[0]["bands"]):
        medians = [tables.figure(row["bands"][number], "median_relative_error_pct") for row in rows]
        heading = f"{band['from_m']:g}-{band['to_m']:g} m (n={band['n']})"
        columns.append(tables.Column(heading, medians, "{:.2f}", cost=abs))
    title = "Median error (%) by true distance, calibration of sigma, run time"
    return tables.grid_of(
        title, "matcher", list(matchers), [*columns, *tables.columns_of(rows, _MORE_COLUMNS)]
    )


def _curves(figures: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Risk-coverage curves by the name of matcher and measure, only for sigma and the best other
    measure.
    """
    curves = {}
    for matcher, by_measure in figures["risk_coverage"].items():
        best = figures["best_confidence"].get(matcher)
        for measure in ("sigma", *([best] if best else [])):
            curves[matcher if measure == "sigma" else f"{matcher}, {measure}"] = by_measure[measure]
    return curves


def _interval_grid(matchers: _Rows) -> tables.Grid:
    lines = []
    for name, row in matchers.items():
        ends = [(pattern, row["intervals"].get(key)) for _, key, pattern in _INTERVALS]
        texts = [
            tables.NOTHING if pair is None else pattern.format(*pair) for pattern, pair in ends
        ]
        lines.append((tables.Cell(name), *(tables.Cell(text) for text in texts)))
    heads = ("matcher", *(heading for heading, _, _ in _INTERVALS))
    return tables.Grid(
        "95 % confidence intervals (bootstrap over pairs, or over the tracks of a drive)",
        heads,
        tuple(lines),
    )


app = command(StereoOptions, _stereo)
