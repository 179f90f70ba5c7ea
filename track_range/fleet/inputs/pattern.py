"""FilePattern: names of the files of a clip with placeholders, such as
`{vehicle}/{clip}_left.mp4`.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from string import Formatter

from track_range.fleet.inputs.clip import CLIP_SETTINGS, FleetInputError
from track_range.foundation.files.input_files import quoted

CLIP = "clip"  # placeholder of the clip's name
# columns of a manifest that are not labels, which a placeholder would be
_RESERVED = CLIP_SETTINGS | {"left", "right"}
_MAX_FIELDS = 8  # largest number of placeholders; the time of a comparison grows with them


@dataclass(frozen=True, slots=True)
class Template:
    """A text with placeholders in braces: pairs of a literal text and the name after it; a double
    brace is a brace.
    """

    text: str
    parts: tuple[tuple[str, str | None], ...]

    @classmethod
    def of(cls, text: str, option: str) -> Template:
        """The template of the value of an option; FleetInputError if a brace is open or a
        placeholder is not a name.
        """
        try:
            parsed = list(Formatter().parse(text))
        except ValueError as error:
            raise FleetInputError(
                f"{option} {quoted(text)}: expected names in braces such as {{clip}} ({error}); "
                f"write {{{{ for a brace."
            ) from error
        for _, name, spec, conversion in parsed:
            if spec or conversion or (name is not None and not name.isidentifier()):
                raise FleetInputError(
                    f"{option} {quoted(text)}: expected names of letters, digits and underscores in braces, such as "
                    "{clip} or {vehicle}."
                )
        return cls(text, tuple((literal, name) for literal, name, _, _ in parsed))

    @property
    def names(self) -> tuple[str, ...]:
        """Placeholders in the order of their first use."""
        return tuple(dict.fromkeys(name for _, name in self.parts if name is not None))

    def filled(self, values: Mapping[str, str]) -> str:
        """The text with values for its placeholders; raises KeyError for a placeholder without a
        value.
        """
        return "".join(
            literal + ("" if name is None else values[name]) for literal, name in self.parts
        )

    def expression(self) -> re.Pattern[str]:
        """Regular expression of the texts that match, with a group for each placeholder.

        A placeholder matches as few characters as possible, at least one; only the clip's
        placeholder matches "/".
        """
        expression = ""
        for literal, name in self.parts:
            expression += re.escape(literal)
            if name is not None:
                group = f"(?P<{name}>"
                characters = ".+?" if name == CLIP else "[^/]+?"
                expression += f"(?P={name})" if group in expression else f"{group}{characters})"
        return re.compile(expression, re.DOTALL)


@dataclass(frozen=True, slots=True)
class FilePattern:
    """Value of --pattern: names of the left or only video of a clip, and of the right video,
    relative to a folder.
    """

    text: str
    left: Template
    right: Template | None

    @classmethod
    def of(cls, text: str) -> FilePattern:
        """The pattern of `--pattern`; raises FleetInputError if it does not determine the videos of
        a clip.
        """
        names = text.split(",")
        if len(names) > 2 or not all(name.strip() for name in names):
            raise _fault(
                text,
                "expected the name of one video, or of left and right video separated by a comma.",
            )
        left, *others = (
            Template.of(name.strip().removeprefix("./"), "--pattern") for name in names
        )
        for template in (left, *others):
            _check(template)
        right = others[0] if others else None
        if right is not None and (right.text == left.text or set(right.names) != set(left.names)):
            raise _fault(
                text,
                "expected two different names with the same placeholders, such as "
                "'{clip}_left.mp4,{clip}_right.mp4'.",
            )
        return cls(text, left, right)


def _check(template: Template) -> None:
    """Raise an error unless a template is the relative name of a file with {clip} and distinct
    placeholders.
    """
    text, names = template.text, template.names
    if CLIP not in names:
        raise _fault(text, "expected {clip} in the name of each video, found none.")
    if text.startswith("/") or "://" in text or ".." in text.split("/"):
        raise _fault(text, "expected a name relative to the folder of the recordings.")
    if reserved := [name for name in names if name in _RESERVED]:
        raise _fault(
            text,
            f"{{{reserved[0]}}} is an option of a run; give it in a manifest, or "
            "choose another name.",
        )
    if len(names) > _MAX_FIELDS:
        raise _fault(text, f"expected at most {_MAX_FIELDS} placeholders.")
    for (_, before), (literal, name) in itertools.pairwise(template.parts):
        if not literal and name is not None and before is not None:
            raise _fault(text, f"expected a separator between {{{before}}} and {{{name}}}.")


def _fault(text: str, message: str) -> FleetInputError:
    return FleetInputError(f"--pattern {quoted(text)}: {message}")
