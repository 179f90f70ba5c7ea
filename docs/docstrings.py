"""Extension of Griffe, which reads the docstrings for the pages of the API.

`Example:` is the section `Examples:`, and the comment beside or above a field of a class is its
docstring.
"""

from __future__ import annotations

import re
from typing import Any

import griffe


class ExampleSections(griffe.Extension):
    """Shows `Example:`, as docstrings of this project have it, as code, and not as a note."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rename the section in the object's docstring."""
        if obj.docstring is not None:
            obj.docstring.value = re.sub(
                r"^( *)Example:$", r"\1Examples:", obj.docstring.value, flags=re.MULTILINE
            )


class FieldComments(griffe.Extension):
    """Shows the comments of fields of dataclasses, where the class describes them so."""

    def on_attribute(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Set the docstring of a field without one to its comment."""
        if (
            attr.docstring is not None
            or attr.lineno is None
            or not (attr.parent and attr.parent.is_class)
        ):
            return
        lines = attr.lines_collection[attr.filepath]  # type: ignore[index]
        comment, number = re.findall(r"#\s+(.*)$", lines[attr.lineno - 1]), attr.lineno - 2
        is_beside = bool(comment)
        while not is_beside and (above := re.match(r"\s+#\s+(.*)$", lines[number])):
            comment.insert(0, above[1])
            number -= 1
        if comment:
            attr.docstring = griffe.Docstring(" ".join(comment), parent=attr)
