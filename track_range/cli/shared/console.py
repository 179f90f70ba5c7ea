"""Output to the terminal: lines, notes and tables.

A table wider than the terminal is split into parts below each other, so that no figure is broken
over two lines.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from track_range.foundation.files.input_files import printable
from track_range.views.tables import Grid, grids

console = Console()  # console of all commands (standard output)
_N_FIRST = 20  # notes that `print_first` prints
_N_FIRST = 20  # notes that `print_first` prints


def print_line(console: Console, *lines: str) -> None:
    """Print lines without markup, highlighting or wrapping."""
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def print_notes(console: Console, notes: Iterable[str]) -> None:
    """Print notes, each on a line after a dash."""
    print_line(console, *(f"- {printable(note)}" for note in notes))


def print_first(console: Console, title: str, notes: Sequence[str]) -> None:
    """Print a title, the first notes and the number of further notes; nothing if there are none."""
    if notes:
        more = [f"and {len(notes) - _N_FIRST} more"] if len(notes) > _N_FIRST else []
        print_line(console, title)
        print_notes(console, [*notes[:_N_FIRST], *more])


def print_summary(console: Console, summary: Mapping[str, Any]) -> None:
    """Print the tables of a run's summary."""
    print_grid(console, *grids(summary))


def print_grid(console: Console, *shown: Grid) -> None:
    """Print grids with the best values bold and green; columns that do not fit are in further
    tables below.
    """
    for grid in shown:
        if grid.title and grid.columns:
            # a separate line, because Rich wraps the title of a table at the width of the table
            console.print(Text(grid.title, "italic"))
        for part in [grid] if grid.has_sentences else _fitting(grid, console.width):
            console.print(_table(part))
            console.print()


def _fitting(grid: Grid, width: int) -> Iterator[Grid]:
    """Parts of the grid that are at most `width` characters wide, each with the first column and at
    least one other.
    """
    if not grid.columns:
        return
    needed = [_width(grid, i) + 1 for i in range(len(grid.columns))]
    first = 1
    while True:
        last, used = first + 1, needed[0] - 1 + sum(needed[first : first + 1])
        while last < len(needed) and used + needed[last] <= width:
            used += needed[last]
            last += 1
        rows = tuple((row[0], *row[first:last]) for row in grid.rows)
        yield Grid(grid.title, (grid.columns[0], *grid.columns[first:last]), rows)
        if last >= len(needed):
            return
        first = last


def _width(grid: Grid, i: int) -> int:
    texts = [*_heading(grid.columns[i]).split("\n"), *(row[i].text for row in grid.rows)]
    return max(map(cell_len, texts))


def _heading(text: str) -> str:
    """Heading in two lines, so that a table with five distance bands fits into 80 columns."""
    return text.replace(" ", "\n", 1)


def _table(grid: Grid) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=0, show_edge=False)
    for i, heading in enumerate(grid.columns):
        justify: Literal["left", "right"] = "left" if i == 0 or grid.has_sentences else "right"
        is_name = i == 0 and not grid.has_sentences
        table.add_column(Text(_heading(heading)), justify=justify, no_wrap=is_name, overflow="fold")
    for row in grid.rows:
        table.add_row(*(Text(cell.text, "bold green" if cell.best else "") for cell in row))
    return table
