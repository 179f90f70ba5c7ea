"""`track-range evaluate tracks`: HOTA, CLEAR and identity metrics of tracks against ground
truth.
"""

import math
from collections.abc import Mapping
from typing import Any

from track_range.cli.commands.evaluate.result_files import JsonField, check_result_files
from track_range.cli.shared.console import console, print_grid, print_line, print_notes
from track_range.cli.shared.parameters import command
from track_range.evaluation.sequences.evaluation import COUNTS, evaluate_tracks
from track_range.evaluation.sequences.settings import TrackEvaluationSettings
from track_range.foundation.files.output_files import write_json
from track_range.tracking.evaluation.motmetrics_comparison import REASONS
from track_range.views.tables import INTERVAL, Column, Grid, columns_of, figure, grid_of

# in lower case the keys of results
_SHOWN = ("HOTA", "MOTA", "IDF1")  # with their intervals
_HEADS = "HOTA DetA AssA LocA MOTA MOTP IDF1 IDsw FP FN Frag MT ML".split()


class TracksOptions(TrackEvaluationSettings):
    """Options of `track-range evaluate tracks`."""

    json_file: JsonField = None


def _tracks(options: TracksOptions) -> None:
    check_result_files(options)
    figures = evaluate_tracks(options)
    print_notes(console, figures["notes"])
    print_grid(console, _grid(figures))
    print_line(console, f"Rule: {figures['rule']}.")
    if options.compare is not None:
        _print_comparison(figures)
    write_json(options.json_file, figures)


def _print_comparison(figures: Mapping[str, Any]) -> None:
    """Print the results of motmetrics beside track-range's results, with reasons for
    differences.
    """
    rows: dict[str, Mapping[str, Any]] = {
        "track-range": figures["combined"],
        "motmetrics": figures["motmetrics"]["combined"],
    }
    compared = {
        head: [figure(row, head.lower()) for row in rows.values()]
        for head in _HEADS
        if head.lower() in REASONS
    }
    columns = [Column(head, values, _pattern(head.lower())) for head, values in compared.items()]
    print_grid(
        console, grid_of("The same boxes evaluated with motmetrics", "", list(rows), columns)
    )
    differing: dict[str, list[str]] = {}
    for head, (own, reference) in compared.items():
        if not _is_same(own, reference):
            differing.setdefault(REASONS[head.lower()], []).append(head)
    reasons = [f"{', '.join(heads)}: {reason}." for reason, heads in differing.items()]
    print_notes(console, reasons or ["All results agree."])


def _is_same(value: float | None, other: float | None) -> bool:
    return (
        value == other
        if value is None or other is None
        else math.isclose(value, other, abs_tol=1e-6)
    )


def _grid(figures: Mapping[str, Any]) -> Grid:
    rows: dict[str, Mapping[str, Any]] = dict(figures["sequences"])
    if len(rows) > 1:
        rows["combined"] = figures["combined"]
    columns = columns_of(
        rows.values(),
        (
            (head + INTERVAL * (head in _SHOWN), head.lower(), _pattern(head.lower()))
            for head in _HEADS
        ),
    )
    return grid_of(f"Tracks of class {figures['class']}", "sequence", list(rows), columns)


def _pattern(key: str) -> str:
    return "{:.0f}" if key in COUNTS else "{:.1f}"


app = command(TracksOptions, _tracks)
