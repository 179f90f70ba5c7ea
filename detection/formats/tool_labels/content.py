"""The content of a label file as plain values, whether it is JSON, XML or CSV.

JSON is as it is, and a CSV is a list of rows by name of the column. An element of XML has its
attributes and children by name: a child without attributes and children is its text, of which the
first counts, and other children are lists.

    <object><name>car</name><box left="1"/></object>        {"object": [{"name": "car", "box": [{"left": "1"}]}]}
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.label_format import START_BYTES
from track_range.foundation.files.csv_tables import read_csv_table
from track_range.foundation.files.input_files import open_regular, readable
from track_range.foundation.files.structured_text import read_json
from track_range.foundation.files.xml_events import parse_xml

_MAX_BYTES = 250_000_000  # of a file
_MAX_ELEMENTS = 20_000_000  # of XML


def content_of(file: Path, title: str) -> Any:
    """The content of a file with labels of the tool `title`; raises LabelFileError."""
    expected = f"labels of {title}"
    with open_regular(file, LabelFileError, expected) as opened, readable(file, LabelFileError):
        start = opened.read(START_BYTES).decode("utf-8-sig", errors="replace").lstrip()
    if start.startswith(("{", "[")):
        return read_json(file, LabelFileError, expected, max_bytes=_MAX_BYTES)
    if start.startswith("<"):
        elements = _Elements()
        with open_regular(file, LabelFileError, expected, max_bytes=_MAX_BYTES) as opened:
            parse_xml(opened, file, elements, LabelFileError, expected)
        return elements.content
    table = read_csv_table(file, LabelFileError, expected)
    return [dict(zip(table.header, row, strict=False)) for row in table.rows]


class _Elements:
    """Receiver of the elements of a file (`xml_events.XmlHandler`)."""

    def __init__(self) -> None:
        self.content: dict[str, Any] = {}
        self._open = [self.content]  # of the elements that have not ended
        self._n_elements = 0

    def start(self, path: list[str], attributes: Mapping[str, str], line: int) -> None:
        self._n_elements += 1
        if self._n_elements > _MAX_ELEMENTS:
            raise LabelFileError(
                f"expected at most {_MAX_ELEMENTS} elements, found more in line {line}"
            )
        self._open.append(dict(attributes))

    def end(self, path: list[str], text: str, line: int) -> None:
        element, parent, name = self._open.pop(), self._open[-1], path[-1]
        if not element:
            parent.setdefault(name, text.strip())
        elif isinstance(parent.get(name), list):
            parent[name].append(element)
        else:
            parent[name] = [element]
