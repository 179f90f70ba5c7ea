"""`track-range evaluate ranges`: distance errors of the ranging methods on labelled boxes."""

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from track_range.cli.commands.evaluate import result_files
from track_range.cli.shared.console import console, print_grid, print_notes
from track_range.cli.shared.parameters import command
from track_range.evaluation.range_evaluation import evaluate_ranges
from track_range.foundation.files.output_files import write_json, write_text
from track_range.foundation.schemas.options import option
from track_range.ranging.evaluation.settings import RangeEvaluationSettings
from track_range.run.progress import step_progress
from track_range.views import tables
from track_range.views.method_comparison import comparison_grid, unmarked


class RangesOptions(RangeEvaluationSettings):
    """Options of `track-range evaluate ranges`."""

    table: Annotated[Path | None, option("Markdown file for the tables.", metavar="FILE.md")] = None
    figure: result_files.RiskFigureField = None
    json_file: result_files.JsonField = None


def _ranges(options: RangesOptions) -> None:
    result_files.check_result_files(options)
    figures = evaluate_ranges(options, partial(step_progress, console))
    curves = _curves(figures)
    grids = [
        *map(unmarked, _grids(figures)),
        *_comparison_grids(figures),
        *_drive_grids(figures),
        tables.delta_1_grid({name: row["all"] for name, row in figures["literature"].items()}),
        *map(unmarked, _literature_grids(figures)),
        *(result_files.risk_grids(curves) if curves else ()),
    ]
    print_grid(console, *grids)
    print_notes(console, figures["notes"])
    result_files.draw_risk(curves, options.figure)
    write_json(options.json_file, figures)
    if options.table is not None:
        notes = "\n".join(f"- {note}" for note in figures["notes"])
        write_text(options.table, "\n\n".join([*map(tables.markdown_table, grids), notes]) + "\n")


_COLUMNS: tuple[tables.ColumnSpec, ...] = (
    ("coverage %", "coverage", "{:.0f}", 100.0),
    ("n", "n", "{:.0f}"),
    (f"mean %{tables.INTERVAL}", "mean_relative_error_pct", "{:.2f}", 1.0, abs),
    tables.DELTA_1,
    (f"median %{tables.INTERVAL}", "median_relative_error_pct", "{:.2f}", 1.0, abs),
    ("bias %", "bias_pct", "{:+.2f}", 1.0, abs),
    *tables.NEAR_NORMAL,
    ("rear %", "rear_view_pct", "{:.2f}", 1.0, abs),
    ("far %", "far_pct", "{:.2f}", 1.0, abs),
    ("rear,far %", "rear_view_far_pct", "{:.2f}", 1.0, abs),
    ("closing m/s", "closing_median_error_mps", "{:.2f}", 1.0, abs),
    ("95 % m/s", "closing_p95_error_mps", "{:.2f}", 1.0, abs),
)


def _grids(figures: Mapping[str, Any]) -> list[tables.Grid]:
    """A table per class with a row per method."""
    methods: Mapping[str, Mapping[str, Any]] = figures["methods"]
    kinds = dict.fromkeys(kind for row in methods.values() for kind in row)
    grids = []
    for kind in kinds:
        rows = {name: row[kind] for name, row in methods.items() if kind in row}
        n_tracks = max(int(row["n_tracks"]) for row in rows.values())
        grids.append(tables.method_grid(f"{kind}: {n_tracks} tracks", rows, _COLUMNS))
    return grids


def _comparison_grids(figures: Mapping[str, Any]) -> Iterator[tables.Grid]:
    """A table per class with the differences of the methods on common boxes."""
    key = "median_relative_error_pct"
    for kind, compared in figures["comparison"].items():
        title = f"{kind}, on {compared['n_common']} of {compared['n']} boxes that all measured"
        n_measured = compared["n_measured"]
        yield comparison_grid(title, compared, n_measured, key=key, heading="median %")


def _drive_grids(figures: Mapping[str, Any]) -> Iterator[tables.Grid]:
    """A table per class with a row per drive, of the methods that state a sigma; without a second
    drive, none.
    """
    methods: Mapping[str, Mapping[str, Any]] = figures["methods"]
    for kind in dict.fromkeys(kind for row in methods.values() for kind in row):
        of_kind = {name: row[kind] for name, row in methods.items() if kind in row}
        stated = {name: row for name, row in of_kind.items() if row["median_sigma_pct"] is not None}
        if any(len(scores["by_drive"]) > 1 for scores in stated.values()):
            yield _drive_grid(kind, stated)


def _drive_grid(kind: str, scores: Mapping[str, Mapping[str, Any]]) -> tables.Grid:
    """The table of one class, with the worst drive of each method in its title."""
    drives, columns, worst = list[str](), list[tables.Column](), list[str]()
    for name, of_method in scores.items():
        by_drive = of_method["by_drive"]
        tracks = [] if columns else [("tracks", "n_tracks", "{:.0f}")]
        specs = [(f"{name} {heading}", *rest) for heading, *rest in _DRIVE_COLUMNS]
        drives = list(by_drive)
        columns += tables.columns_of(by_drive.values(), [*tracks, *specs])
        if (one := of_method["worst_drive"]) is not None:
            worst.append(f"{name} {one} ({by_drive[one]['bias_pct']:+.1f} %)")
    title = f"{kind} by drive, worst: {', '.join(worst) or tables.NOTHING}"
    return tables.grid_of(title, "drive", drives, columns)


_DRIVE_COLUMNS: tuple[tables.ColumnSpec, ...] = (
    ("n", "n", "{:.0f}"),
    ("bias %", "bias_pct", "{:+.1f}"),
    *tables.WITHIN_SIGMAS,
)


_LITERATURE: tuple[tables.ColumnSpec, ...] = (  # metrics of published evaluations
    ("n", "n", "{:.0f}"),
    ("coverage %", "coverage", "{:.1f}", 100.0),
    ("abs rel %", "abs_rel", "{:.2f}", 100.0, abs),
    ("sq rel m", "sq_rel_m", "{:.3f}", 1.0, abs),
    ("RMSE m", "rmse_m", "{:.2f}", 1.0, abs),
    ("RMSE log", "rmse_log", "{:.3f}", 1.0, abs),
    ("< 1.25 %", "delta_1_25", "{:.1f}", 100.0, tables.largest),
    ("< 1.25^2 %", "delta_1_25_2", "{:.1f}", 100.0, tables.largest),
)


def _literature_grids(figures: Mapping[str, Any]) -> list[tables.Grid]:
    """A table per class; for frames, objects or distances of published evaluations also over all
    classes.

    The JSON file always has these metrics.
    """
    is_published = (
        figures["frames"] is not None
        or figures["objects"] != "visible"
        or figures["truth"] != "surface"
    )
    by_method: Mapping[str, Mapping[str, Any]] = figures["literature"] if is_published else {}
    grids = []
    for kind in next(iter(by_method.values()), {}):
        columns = tables.columns_of((row[kind] for row in by_method.values()), _LITERATURE)
        title = f"{kind}, all distances, truth: {figures['truth']}"
        grids.append(tables.grid_of(title, "method", list(by_method), columns))
    return grids


def _curves(figures: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    return {
        f"{method}, {kind}": curve
        for method, by_class in figures["risk_coverage"].items()
        for kind, curve in by_class.items()
    }


app = command(RangesOptions, _ranges)
