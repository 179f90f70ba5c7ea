"""The terminal: tables, notes and lines.

A table wider than the terminal is split into parts below each other, so that no figure is broken in two.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from track_range.report.tables import Grid, grids

console = Console()
"""Where commands print."""


def print_line(console: Console, text: str) -> None:
    """Print a line as it is: no markup, no colours, not wrapped."""
    console.print(text, highlight=False, markup=False, soft_wrap=True)


def print_notes(console: Console, notes: Iterable[str]) -> None:
    """Print notes, a line with a dash each."""
    for note in notes:
        print_line(console, f"- {note}")


def print_summary(console: Console, summary: Mapping[str, Any]) -> None:
    """Print the summary's grids."""
    for grid in grids(summary):
        print_grid(console, grid)


def print_grid(console: Console, grid: Grid) -> None:
    """Print a grid, the best figures bold and green; columns beyond the console's width follow below, named anew."""
    if grid.title and grid.columns:
        # A line of its own: as the table's title it would be broken at the table's width.
        console.print(Text(grid.title, "italic"))
    for part in _fitting(grid, console.width):
        console.print(_table(part))


def _fitting(grid: Grid, width: int) -> Iterator[Grid]:
    """The grid in parts of at most `width` cells, each with the first column and at least one other."""
    if not grid.columns:
        return
    needed = [_width(grid, i) + 1 for i in range(len(grid.columns))]
    first = 1
    while True:
        last, used = first + 1, 1 + needed[0] + sum(needed[first : first + 1])
        while last < len(needed) and used + needed[last] <= width:
            used += needed[last]
            last += 1
        rows = tuple((row[0], *row[first:last]) for row in grid.rows)
        yield Grid(grid.title, (grid.columns[0], *grid.columns[first:last]), rows)
        if last >= len(needed):
            return
        first = last


def _width(grid: Grid, i: int) -> int:
    """Cells that a column needs."""
    texts = [*_heading(grid.columns[i]).split("\n"), *(row[i].text for row in grid.rows)]
    return max(map(cell_len, texts))


def _heading(words: str) -> str:
    """Two lines of heading keep a table with five bands of distance within 80 columns."""
    return words.replace(" ", "\n", 1)


def _table(grid: Grid) -> Table:
    """A grid for Rich; nothing in it is read as markup."""
    table = Table(box=box.SIMPLE_HEAD, padding=0)
    for i, heading in enumerate(grid.columns):
        table.add_column(
            Text(_heading(heading)), justify="left" if i == 0 else "right", no_wrap=i == 0, overflow="fold"
        )
    for row in grid.rows:
        table.add_row(*(Text(cell.text, "bold green" if cell.best else "") for cell in row))
    return table
