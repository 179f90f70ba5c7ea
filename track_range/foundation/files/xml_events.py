"""XML files as events, with limits: no document types, no entities, no deep nesting; errors are one
sentence.

A document type may declare entities that expand to gigabytes ("billion laughs") or name other
files, so it is refused.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO, NoReturn, Protocol
from xml.parsers import expat

from track_range.foundation.files.input_files import readable, shortened

MAX_DEPTH = 16  # largest depth of nested elements
MAX_TEXT = 500  # largest number of characters of an element's text that is passed on

_BLOCK_BYTES = 65_536


class XmlHandler(Protocol):
    """Receiver of elements; `path` has the names of the enclosing elements and its own; `line`
    counts from 1.
    """

    def start(self, path: list[str], attributes: Mapping[str, str], line: int) -> None:
        """An element begins; it is the last of `path`."""

    def end(self, path: list[str], text: str, line: int) -> None:
        """An element ends; `text` is its text before its first child, at most `MAX_TEXT`
        characters.
        """


def parse_xml(
    file: BinaryIO, path: Path, handler: XmlHandler | None, error: type[Exception], expected: str
) -> None:
    """Pass the elements of a file to a handler, block by block; without a handler, the file is only
    checked.

    Raises `error` if the file cannot be read, is not XML, has a document type, or is nested too
    deeply; the message names `path` and `expected`. Exceptions of the handler are passed on.
    """
    elements: list[str] = []
    text = ""
    parser = expat.ParserCreate()

    def fault(problem: str) -> Exception:
        return error(f"{path}, line {parser.CurrentLineNumber}: expected {expected}{problem}")

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal text
        text = ""
        elements.append(name)
        if len(elements) > MAX_DEPTH:
            raise fault(f", found more than {MAX_DEPTH} nested elements.")
        if handler is not None:
            handler.start(elements, attributes, parser.CurrentLineNumber)

    def end(_name: str) -> None:
        nonlocal text
        if handler is not None:
            handler.end(elements, text, parser.CurrentLineNumber)
        elements.pop()
        text = ""

    def characters(part: str) -> None:
        nonlocal text
        text = (text + part)[:MAX_TEXT] if len(text) < MAX_TEXT else text

    def refuse(*_: object) -> NoReturn:
        raise fault(
            " without a document type, found a declaration of a document type or an "
            "entity; remove it."
        )

    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = (
        start,
        end,
        characters,
    )
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    try:
        with readable(path, error):
            while block := file.read(_BLOCK_BYTES):
                parser.Parse(block, False)
            parser.Parse(b"", True)
    except expat.ExpatError as reason:
        problem = shortened(expat.ErrorString(reason.code), 100)
        raise error(
            f"{path}, line {reason.lineno}: expected {expected} in XML, found an error: {problem}."
        ) from reason
    # an encoding that Python does not have
    except (ValueError, LookupError, UnicodeError) as reason:
        raise error(f"{path}: expected {expected} as XML in UTF-8, found other text.") from reason
