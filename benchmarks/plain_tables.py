"""Tables of figures for 80 columns that can be pasted as text: words are left-aligned, numbers right-aligned."""

from __future__ import annotations

from rich import box
from rich.table import Table


def plain_table(title: str, *headings: str, n_words: int = 1) -> Table:
    """An empty table with words in the first `n_words` columns and numbers in the others."""
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, title_justify="left")
    for number, heading in enumerate(headings):
        is_word = number < n_words
        table.add_column(heading, justify="left" if is_word else "right", no_wrap=is_word)
    return table


def figure_text(value: float | None, *, digits: int = 2, times: float = 1.0) -> str:
    """`times * value` as text with `digits` decimals; "-" for None."""
    return "-" if value is None else f"{times * value:.{digits}f}"
