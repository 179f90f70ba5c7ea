"""Tables of figures that fit into 80 columns and can be pasted: words at the left, numbers at the right."""

from __future__ import annotations

from rich import box
from rich.table import Table


def plain_table(title: str, *headings: str, n_words: int = 1) -> Table:
    """An empty table whose first `n_words` columns are words."""
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, title_justify="left")
    for number, heading in enumerate(headings):
        is_word = number < n_words
        table.add_column(heading, justify="left" if is_word else "right", no_wrap=is_word)
    return table


def figure_text(value: float | None, *, digits: int = 2, times: float = 1.0) -> str:
    """A number as text, so many times as large; "-" = there is none."""
    return "-" if value is None else f"{times * value:.{digits}f}"
