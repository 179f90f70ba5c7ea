"""`track-range evaluate motion`: closing speed, speed over ground, time to collision, warnings on
labelled drives.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from track_range.cli.commands.evaluate.result_files import JsonField, check_result_files
from track_range.cli.shared.console import console, print_grid, print_notes
from track_range.cli.shared.parameters import command
from track_range.evaluation.motion.evaluate import evaluate_motion
from track_range.evaluation.motion.settings import MotionEvaluationSettings
from track_range.foundation.files.output_files import write_json
from track_range.views import tables


class MotionOptions(MotionEvaluationSettings):
    """Options of `track-range evaluate motion`."""

    json_file: JsonField = None


def _motion(options: MotionOptions) -> None:
    check_result_files(options)
    figures = evaluate_motion(options)
    print_grid(console, *_grids(figures))
    print_notes(console, figures["notes"])
    write_json(options.json_file, figures)


_SPEED: tuple[tables.ColumnSpec, ...] = (
    ("n", "n", "{:.0f}"),
    ("coverage %", "coverage", "{:.0f}", 100.0),
    (f"median m/s{tables.INTERVAL}", "median_mps", "{:.2f}"),
    ("95 % m/s", "p95_mps", "{:.2f}"),
    *tables.WITHIN_SIGMAS,
)
_CELL: tuple[tables.ColumnSpec, ...] = (
    ("n", "n", "{:.0f}"),
    ("coverage %", "coverage", "{:.0f}", 100.0),
    (f"rms{tables.INTERVAL}", "rms", "{:.2f}"),
    ("median", "median_error", "{:.2f}"),
    (f"stated {tables.SIGMA}", "stated_sigma", "{:.2f}"),
    *tables.WITHIN_SIGMAS,
)
_QUANTITIES = {
    "closing": "Closing speed, m/s",
    "speed": "Speed over ground, m/s",
    "ttc": "Time to collision, s",
}
_TTC: tuple[tables.ColumnSpec, ...] = (
    ("n", "n", "{:.0f}"),
    ("coverage %", "coverage", "{:.0f}", 100.0),
    (f"median %{tables.INTERVAL}", "median_pct", "{:.1f}"),
    ("RTE %", "rte_pct", "{:.1f}"),
    ("MiD", "mid", "{:.1f}"),
)
_WARNINGS: tuple[tables.ColumnSpec, ...] = (
    ("hours", "hours", "{:.2f}"),
    ("false alarms", "false_alarms", "{:.0f}"),
    ("per hour", "per_hour", "{:.1f}"),
    ("in alarm s", "in_alarm_s", "{:.1f}"),
)


def _grids(figures: Mapping[str, Any]) -> Iterator[tables.Grid]:
    yield tables.delta_1_grid({figures.get("method", "fused"): figures["distance"]})
    for title, section in (("Closing speed", figures), ("Speed over ground", figures["speed"])):
        rows = {f"all, {band} m": row for band, row in section["bands"].items()}
        for name, by_band in section["by_class"].items():
            rows |= {f"{name}, {band} m": row for band, row in by_band.items() if row["n"]}
        yield tables.grid_of(title, "objects", list(rows), tables.columns_of(rows.values(), _SPEED))
    ttc = {key.replace("_", " "): row for key, row in figures["ttc"].items()}
    yield tables.grid_of(
        "Time to collision", "true time", list(ttc), tables.columns_of(ttc.values(), _TTC)
    )
    if score := figures.get("velocity_score"):
        columns = [
            tables.Column(f"{name} (m/s)\N{SUPERSCRIPT TWO}", [value], "{:.2f}")
            for name, value in score.items()
        ]
        yield tables.grid_of("TuSimple's velocity score", "", ["all"], columns)
    interval = figures["warnings"]["per_hour_95"] or (None, None)
    limits = zip(("95 % from", "to"), interval, strict=True)
    causes = figures["warnings"]["by_cause"]
    counts = [tables.Column(name, [count], "{:.0f}") for name, count in causes.items()]
    rates = [tables.Column(name, [limit], "{:.1f}") for name, limit in limits]
    columns = [*tables.columns_of([figures["warnings"]], _WARNINGS), *rates, *counts]
    yield tables.grid_of("Warnings", "", ["all"], columns)
    yield from _cell_grids(figures)


def _cell_grids(figures: Mapping[str, Any]) -> Iterator[tables.Grid]:
    """Tables by cell, of those with boxes, and then by drive, of several drives."""
    for by, corner, fewest in (("cell", "objects", 1), ("drive", "drive", 2)):
        for name, title in _QUANTITIES.items():
            worst = figures["worst_drives"][name] if by == "drive" else None
            rows = {key: row for key, row in figures[f"{by}s"][name].items() if row["n"]}
            names = [f"{key} (worst)" if key == worst else key for key in rows]
            columns = tables.columns_of(rows.values(), _CELL)
            if len(rows) >= fewest:
                yield tables.grid_of(f"{title}, by {by}", corner, names, columns)


app = command(MotionOptions, _motion)
