"""Table of methods that are compared on the same objects, in which only what is more than noise is
marked.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from track_range.foundation.bootstrap import CI95, FEWEST_BLOCKS
from track_range.views.tables import NOTHING, Cell, Grid

_HEADINGS = ("method", "boxes", "{}", "95 %", "difference", "95 % of difference", "result")


def comparison_grid(
    title: str,
    compared: Mapping[str, Any],
    n_measured: Mapping[str, int],
    *,
    key: str,
    heading: str,
) -> Grid:
    """A row per method of `paired_differences` of the figure `key`, with the number of boxes that
    each measured; the best one is marked only if all others are worse than it.
    """
    reference, methods = compared.get("reference"), compared.get("methods", {})
    is_best = len(methods) > 1 and all(
        row["is_worse"] for name, row in methods.items() if name != reference
    )
    rows = []
    for name, n in n_measured.items():
        row = methods.get(name)
        if row is None:
            rows.append((Cell(name), Cell(str(n)), *[Cell(NOTHING)] * 4, Cell("too few boxes")))
            continue
        texts = [
            f"{row[key]:.2f}",
            _interval(row.get(key + CI95), "{:.2f}"),
            NOTHING if name == reference else f"{row['difference']:+.2f}",
            _interval(row.get("difference" + CI95), "{:+.2f}"),
            _result(row, str(reference), compared["n_blocks"]),
        ]
        marks = [name == reference and is_best, *[False] * 4]
        rows.append((Cell(name), Cell(str(n)), *map(Cell, texts, marks)))
    return Grid(title, tuple(text.format(heading) for text in _HEADINGS), tuple(rows))


def _result(row: Mapping[str, Any], reference: str, n_blocks: int) -> str:
    if "difference" not in row:
        return "smallest"
    if row["is_worse"] is None:
        return f"too few tracks or pairs ({n_blocks} of at least {FEWEST_BLOCKS})"
    return f"worse than {reference}" if row["is_worse"] else "no difference within noise"


def _interval(ends: list[float] | None, pattern: str) -> str:
    return NOTHING if ends is None else " to ".join(map(pattern.format, ends))


def unmarked(grid: Grid) -> Grid:
    """A table without marks of the best values, which intervals do not support."""
    rows = (tuple(replace(cell, best=False) for cell in row) for row in grid.rows)
    return replace(grid, rows=tuple(rows))
