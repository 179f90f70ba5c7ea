"""Damaged copies of valid files as a hypothesis strategy, and the check of a reader on them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from hypothesis import strategies as st

from tests.support.error_messages import check_sentence
from track_range.foundation.errors import UserError

NASTY_CELLS = (
    *(
        "",
        " ",
        "x",
        "nan",
        "-inf",
        "1e400",
        "-1",
        "0",
        "0.5",
        "1e18",
        "1e-320",
        "99999999999999999999",
        "2147483648",
    ),
    *(
        "1_0",
        "9,66",
        "1;2",
        "0x10",
        "٣",
        "1.5.2",
        "--1",
        "true",
        "null",
        "~",
        "2001-99-99",
        "!!int abc",
        "!!bool maybe",
    ),
    *(
        '"',
        "'",
        "#",
        "=",
        ":",
        "- ",
        "[",
        "{",
        "&a",
        "*a",
        "\0",
        "\t",
        "\r",
        "\u2028",
        "\ufeff",
        "😀",
        "%",
        "\\",
    ),
    *("[" * 3000, "9" * 5000, "x" * 200_000, "1," * 3000, "1 " * 3000),
)
"""Values that readers of numbers, YAML, JSON or CSV have accepted or failed on."""

_CELL = re.compile(rb"[^\s,;:=\[\]{}\"]+")
_LINE_ENDS = (b"\r", b"\r\n", b"\n\n", b"", b"\x0b")


@st.composite
def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """Copies of a file with one to three kinds of damage."""
    for _ in range(draw(st.integers(1, 3))):
        content = draw(st.sampled_from(_DAMAGES))(draw, content)
    return content


def check_damaged(read: Callable[[Path], object], path: Path, content: bytes) -> UserError | None:
    """Write `content` to `path` and check how `read` takes it, see `check_reading`."""
    path.write_bytes(content)
    return check_reading(read, path)


def check_reading(read: Callable[[Path], object], path: Path) -> UserError | None:
    """Check that `read` returns, or raises a UserError with one short sentence that names `path`.

    Returns:
        The error; None if there was none.
    """
    try:
        read(path)
    except UserError as error:
        message = str(error)
        assert path.name in message
        check_sentence(message, path)
        return error
    return None


def _flip(draw: st.DrawFn, content: bytes) -> bytes:
    if not content:
        return content
    index = draw(st.integers(0, len(content) - 1))
    return (
        content[:index] + bytes([content[index] ^ draw(st.integers(1, 255))]) + content[index + 1 :]
    )


def _insert(draw: st.DrawFn, content: bytes) -> bytes:
    index = draw(st.integers(0, len(content)))
    return content[:index] + draw(st.binary(min_size=1, max_size=8)) + content[index:]


def _cut(draw: st.DrawFn, content: bytes) -> bytes:
    return content[: draw(st.integers(0, len(content)))]


def _cut_out(draw: st.DrawFn, content: bytes) -> bytes:
    first, last = sorted(draw(st.tuples(*[st.integers(0, len(content))] * 2)))
    return content[:first] + content[last:]


def _repeat_line(draw: st.DrawFn, content: bytes) -> bytes:
    lines = content.splitlines(keepends=True) or [b""]
    index = draw(st.integers(0, len(lines) - 1))
    return b"".join(
        [*lines[:index], lines[index] * draw(st.sampled_from((0, 2, 3, 50))), *lines[index + 1 :]]
    )


def _swap_lines(draw: st.DrawFn, content: bytes) -> bytes:
    lines = content.splitlines(keepends=True) or [b""]
    first, last = draw(st.tuples(*[st.integers(0, len(lines) - 1)] * 2))
    lines[first], lines[last] = lines[last], lines[first]
    return b"".join(lines)


def _replace_cell(draw: st.DrawFn, content: bytes) -> bytes:
    cells = list(_CELL.finditer(content))
    if not cells:
        return content
    first, last = cells[draw(st.integers(0, len(cells) - 1))].span()
    return content[:first] + draw(st.sampled_from(NASTY_CELLS)).encode() + content[last:]


def _swap_cells(draw: st.DrawFn, content: bytes) -> bytes:
    cells = list(_CELL.finditer(content))
    if len(cells) < 2:
        return content
    target, source = (cells[draw(st.integers(0, len(cells) - 1))] for _ in range(2))
    return content[: target.start()] + source.group() + content[target.end() :]


def _change_line_ends(draw: st.DrawFn, content: bytes) -> bytes:
    return content.replace(b"\n", draw(st.sampled_from(_LINE_ENDS)))


def _change_encoding(draw: st.DrawFn, content: bytes) -> bytes:
    return content.decode("latin-1").encode(
        draw(st.sampled_from(("utf-8-sig", "utf-16", "utf-16-le", "utf-32")))
    )


_DAMAGES = (
    _flip,
    _insert,
    _cut,
    _cut_out,
    _repeat_line,
    _swap_lines,
    *(_replace_cell,) * 3,  # finds more than the others
    _swap_cells,
    _change_line_ends,
    _change_encoding,
)
