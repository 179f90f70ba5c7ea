"""Result files of evaluations, checked before the evaluation, and risk-coverage tables."""

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from track_range.cli.shared.console import console, print_line
from track_range.foundation.errors import UsageError
from track_range.foundation.files.output_files import OutputError
from track_range.foundation.schemas.options import option
from track_range.views import tables

JsonField = Annotated[
    Path | None, option("JSON file for the results.", flag="--json", metavar="FILE")
]
RiskFigureField = Annotated[
    Path | None,
    option("SVG or PNG file for the chart of the risk-coverage curves.", metavar="FILE.svg"),
]

_OUTPUTS = {
    "json_file": "--json",
    "table": "--table",
    "figure": "--figure",
    "out": "--out",
    "junit": "--junit",
}
"""Options that name files to write, by field."""

# options that name inputs, by field, if the name of the field differs
_INPUT_FLAGS = {"models": "--model", "folder": "DIR", "folders": "DIR"}

_RESULTS = ("summary.json", "evaluation.json")  # of a run, which is an input

CHART_SUFFIXES = (".svg", ".png")  # accepted endings of a chart's file name


def check_result_files(options: Any) -> None:
    """Check the files of results before the evaluation, so that no result is lost afterwards.

    `options` have `json_file` and perhaps `table`, `figure` and `out`; all other paths in them, and
    the files in folders, are inputs. UsageError: a chart's name has another ending than
    `CHART_SUFFIXES`; OutputError: a file is an input or given twice, its folder does not exist, or
    it cannot be written.
    """
    files = {
        flag: file
        for name, flag in _OUTPUTS.items()
        if (file := getattr(options, name, None)) is not None
    }
    for flag, file in files.items():
        if flag == "--figure" and file.suffix.lower() not in CHART_SUFFIXES:
            raise UsageError(
                f"--figure {file}: expected a name that ends in {' or '.join(CHART_SUFFIXES)}."
            )
        _check_is_no_input(flag, file, options)
        _check_can_be_written(file)
    replaced = [os.path.realpath(file) for file in files.values() if _is_replaced(file)]
    if len(set(replaced)) < len(replaced):
        raise OutputError(
            f"{' and '.join(files)}: expected different files; choose another name for one of them."
        )


def _check_is_no_input(flag: str, file: Path, options: Any) -> None:
    for name, value in vars(options).items() if file.exists() else ():
        # an existing file in the folder of an option may be one of the inputs, and not an earlier
        # result
        is_input = (
            file.suffix != ".json" or file.name in _RESULTS
            if flag == "--json"
            else file.suffix != ".xml"
            if flag == "--junit"
            else name == "images" and file.suffix.lower() == ".png"
        )
        for path in _paths(value) if name not in _OUTPUTS else ():
            if path.samefile(file) or (is_input and path.is_dir() and path.samefile(file.parent)):
                source = _INPUT_FLAGS.get(name, f"--{name.replace('_', '-')}")
                raise OutputError(
                    f"{file}: expected a new file for {flag}, got the file of {source}; choose "
                    "another name."
                )


def _paths(value: object) -> Iterator[Path]:
    """The existing paths of an option; a text counts if it names a file, such as a model and its
    `MODEL.yaml`.
    """
    values = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    for item in values:
        if isinstance(item, Path) and item.exists():
            yield item
        elif isinstance(item, str) and os.path.isfile(item):
            yield Path(item)
            if (sidecar := Path(item).with_suffix(".yaml")).is_file():
                yield sidecar


def _check_can_be_written(file: Path) -> None:
    if file.is_dir():
        raise OutputError(
            f"{file}: cannot be written (it is a folder); give the path of a file in it."
        )
    if not file.parent.is_dir():
        raise OutputError(
            f"{file}: cannot be written (no folder {file.parent}); create the "
            "folder, or choose another."
        )
    if not os.access(file.parent if _is_replaced(file) else file, os.W_OK):
        raise OutputError(f"{file}: cannot be written (permission denied); choose another file.")


def _is_replaced(file: Path) -> bool:
    """Whether a new file takes the place of this file; devices and pipes are written in place."""
    return file.is_file() or not file.exists()


# answered fractions of the boxes in the risk-coverage tables, per cent
ANSWERED_PCT = (100, 95, 90, 80, 50)

_Curves = Mapping[str, Mapping[str, Any]]


def draw_risk(curves: _Curves, path: Path | None) -> None:
    """Draw curves by name, if a file is given."""
    if path is not None:
        # imports matplotlib: a third of a second
        from track_range.views.report.figures import risk_coverage_chart

        risk_coverage_chart({name: curve["curve"] for name, curve in curves.items()}, path)
        print_line(console, f"Written: {path}")


def risk_grids(curves: _Curves) -> list[tables.Grid]:
    """Failures, mean and 95th percentile of the error among the most certain boxes, by the answered
    fraction.
    """
    grids = []
    for title, key, area in (
        (
            "Failures (%) when only the most certain boxes have a distance",
            "failures_pct",
            "area_failures_pct",
        ),
        (
            "Mean error (%) of the boxes with a distance",
            "mean_relative_error_pct",
            "area_error_pct",
        ),
        (
            "95th percentile of the error (%) of the boxes with a distance",
            "p95_relative_error_pct",
            None,
        ),
    ):
        columns = [
            tables.Column(
                f"{pct} %", [_at(curve, pct, key) for curve in curves.values()], "{:.2f}", cost=abs
            )
            for pct in ANSWERED_PCT
        ]
        if area is not None:
            columns += tables.columns_of(curves.values(), [("area", area, "{:.2f}", 1.0, abs)])
        grids.append(tables.grid_of(title, "answered", list(curves), columns))
    return grids


def _at(curve: Mapping[str, Any], answered_pct: int, key: str) -> float | None:
    row = next(row for row in curve["curve"] if row["answered_pct"] == answered_pct)
    return tables.figure(row, key)
