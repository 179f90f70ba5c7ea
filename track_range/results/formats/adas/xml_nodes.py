"""Elements of ASAM's XML formats."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from track_range.foundation.files import atomic_files


def node(tag: str, *children: ElementTree.Element, **attributes: Any) -> ElementTree.Element:
    """An element with its children and attributes."""
    element = ElementTree.Element(tag, {name: str(value) for name, value in attributes.items()})
    element.extend(children)
    return element


def write_nodes(path: Path, root: ElementTree.Element) -> None:
    """Write a document atomically."""
    ElementTree.indent(root)
    content = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    atomic_files.write_bytes(path, content + b"\n")
