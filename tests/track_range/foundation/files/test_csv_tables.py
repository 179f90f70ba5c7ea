"""Tests of CSV tables with named columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from track_range.foundation.files.csv_tables import CsvTable, read_csv_table


class TableError(Exception):
    """Error class passed to `read_csv_table` in these tests."""


def read(folder: Path, content: str | bytes, **options: object) -> CsvTable:
    file = folder / "table.csv"
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_csv_table(file, TableError, "columns a and b", **options)  # type: ignore[arg-type]


def test_spaces_blank_lines_and_byte_order_mark(tmp_path: Path) -> None:
    table = read(tmp_path, "\ufeff A ,b\r\n\r\n 1.5, x \r\n,\r\n-2,'y'\r\n")
    assert (table.header, table.lines, len(table)) == (("a", "b"), [3, 5], 2)
    assert table.finite("a").tolist() == [1.5, -2.0]
    assert table.texts("b") == ["x", "'y'"]
    assert "a" in table
    assert "c" not in table


def test_missing_column_is_empty(tmp_path: Path) -> None:
    table = read(tmp_path, "a\n1\n2\n")
    assert table.texts("b") == ["", ""]
    assert np.isnan(table.numbers("b")).all()


@pytest.mark.parametrize("cell", ["", "x", "1_000", "nan", "inf"])
def test_finite_names_line_and_column(tmp_path: Path, cell: str) -> None:
    with pytest.raises(TableError, match=r"table.csv, line 4: .* finite"):
        read(tmp_path, f"a,b\n1,2\n\n{cell},2\n").finite("a")


def test_require_names_the_missing_column(tmp_path: Path) -> None:
    table = read(tmp_path, "a,b,b\n1,2,3\n")
    table.require(["a"])
    with pytest.raises(TableError, match=r"table.csv: .*column c"):
        table.require(["a", "c"])
    with pytest.raises(TableError, match=r"table.csv: .*column b"):
        table.require(["a", "b"])


def test_short_rows_are_filled_long_ones_rejected(tmp_path: Path) -> None:
    assert read(tmp_path, "a,b\n1\n2,3,\n").texts("b") == ["", "3"]
    with pytest.raises(TableError, match=r"table.csv, line 2: .*cells"):
        read(tmp_path, "a,b\n1,2,3\n")


@pytest.mark.parametrize("row", ["1", "1,2,"])
def test_exact_rejects_rows_of_another_length(tmp_path: Path, row: str) -> None:
    with pytest.raises(TableError, match=r"table.csv, line 2"):
        read(tmp_path, f"a,b\n{row}\n", exact=True)


def test_default_header(tmp_path: Path) -> None:
    table = read(tmp_path, "1,2\n3,4\n", default_header=("a", "b", "c"))
    assert (table.header, table.lines) == (("a", "b"), [1, 2])
    table = read(tmp_path, "b,a\n3,4\n", default_header=("a", "b", "c"))
    assert (table.header, table.lines) == (("b", "a"), [2])


@pytest.mark.parametrize(
    ("content", "word"),
    [("\n\n", "empty"), (b"a,b\n\xff,1\n", "UTF-8"), (b"a,b\n\x00\n", "line|CSV")],
)
def test_not_a_table(tmp_path: Path, content: str | bytes, word: str) -> None:
    with pytest.raises(TableError, match=word):
        read(tmp_path, content).finite("a")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(TableError, match=r"none.csv: .*file"):
        read_csv_table(tmp_path / "none.csv", TableError, "columns a and b")


@pytest.mark.parametrize("separator", [";", "\t"])
def test_other_separators_and_decimal_commas(tmp_path: Path, separator: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(
        separator.join(["\na", '"b, c"', "d"])
        + "\n"
        + separator.join(["1,5", "-2,25E-01", "x,y"])
        + "\n"
    )
    table = read_csv_table(path, ValueError, "numbers")
    assert table.header == ("a", "b, c", "d")
    assert [table.numbers("a")[0], table.numbers("b, c")[0], table.texts("d")[0]] == [
        1.5,
        -0.225,
        "x,y",
    ]
