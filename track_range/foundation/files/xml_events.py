"""XML files as events, with limits: no document types, no entities, no deep nesting; errors are one sentence.

A document type may declare entities that expand to gigabytes ("billion laughs") or name other files, so it is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO, NoReturn, Protocol
from xml.parsers import expat

from track_range.foundation.files.input_files import readable, shortened

MAX_DEPTH = 16
"""Largest depth of nested elements."""

MAX_TEXT = 500
"""Largest number of characters of an element's text that is passed on."""

_BLOCK_BYTES = 65_536


class XmlHandler(Protocol):
    """Receiver of the elements of a file.

    `path` has the names of the element and those around it, outermost first; `line` counts from 1.
    """

    def start(self, path: list[str], attributes: Mapping[str, str], line: int) -> None:
        """An element begins; it is the last of `path`."""
        ...

    def end(self, path: list[str], text: str, line: int) -> None:
        """An element ends; `text` is its text before its first child, at most `MAX_TEXT` characters."""
        ...


def parse_xml(file: BinaryIO, path: Path, handler: XmlHandler | None, error: type[Exception], expected: str) -> None:
    """Pass the elements of a file to a handler, block by block.

    Args:
        file: the open file.
        path: its path, for messages.
        handler: receiver; its exceptions are passed on. None = the file is only checked.
        error: class of the exceptions to raise.
        expected: noun phrase for the content, for messages.

    Raises:
        error: the file cannot be read, is not XML, has a document type, or is nested too deeply.
    """
    _Events(path, handler, error, expected).parse(file)


class _Events:
    def __init__(self, path: Path, handler: XmlHandler | None, error: type[Exception], expected: str) -> None:
        self._path, self._handler, self._error, self._expected = path, handler, error, expected
        self._elements: list[str] = []
        self._text = ""
        self._parser = parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._characters
        parser.StartDoctypeDeclHandler = self._refuse
        parser.EntityDeclHandler = self._refuse

    def parse(self, file: BinaryIO) -> None:
        """Parse the whole file."""
        try:
            with readable(self._path, self._error):
                while block := file.read(_BLOCK_BYTES):
                    self._parser.Parse(block, False)
                self._parser.Parse(b"", True)
        except expat.ExpatError as reason:
            raise self._error(
                f"{self._path}, line {reason.lineno}: expected {self._expected} in XML, found an error: "
                f"{shortened(expat.ErrorString(reason.code), 100)}."
            ) from reason
        except (ValueError, LookupError, UnicodeError) as reason:  # an encoding that Python does not have
            raise self._error(
                f"{self._path}: expected {self._expected} as XML in UTF-8, found text that is not."
            ) from reason

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._elements.append(name)
        if len(self._elements) > MAX_DEPTH:
            raise self._error(
                f"{self._path}, line {self._line}: expected {self._expected}, found more than {MAX_DEPTH} nested "
                "elements."
            )
        self._text = ""
        if self._handler is not None:
            self._handler.start(self._elements, attributes, self._line)

    def _end(self, name: str) -> None:
        if self._handler is not None:
            self._handler.end(self._elements, self._text, self._line)
        self._elements.pop()
        self._text = ""

    def _characters(self, text: str) -> None:
        if len(self._text) < MAX_TEXT:
            self._text = (self._text + text)[:MAX_TEXT]

    def _refuse(self, *_: object) -> NoReturn:
        raise self._error(
            f"{self._path}, line {self._line}: expected {self._expected} without a document type, found a "
            "declaration of a document type or an entity; remove it."
        )

    @property
    def _line(self) -> int:
        return self._parser.CurrentLineNumber
