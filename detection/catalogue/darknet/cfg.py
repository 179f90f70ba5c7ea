"""Parser of Darknet's cfg files: sections of `key=value` lines and their values.

    [convolutional]        # each section is a layer, except the first, [net], which describes the input
    filters=32
    layers = -1, -4        # blanks are ignored; comments start with #

If an option occurs twice in a section, the first one is used, as in Darknet (`option_find` in
option_list.c).
"""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from track_range.detection.models.onnx_session import ModelError
from track_range.foundation.files.input_files import MAX_TEXT_BYTES, read_bytes
from track_range.foundation.files.numeric_text import number, numbers

_ALIASES = {"network": "net", "conv": "convolutional", "max": "maxpool"}
_MAX_INTEGER = 65535  # numbers of pixels, channels and layers are smaller
_MAX_NUMBER = 1e10  # Darknet's default of share_index is -1,000,000,000
_INTEGER = re.compile(r"[+-]?[0-9]+")
_MAX_SHOWN = 40  # characters of a line in messages


@dataclass(frozen=True, slots=True)
class CfgSection:
    """One section of a cfg; all methods raise ModelError for missing or invalid values."""

    path: Path
    line: int  # line of its header, from 1
    kind: str  # name in the header's brackets, aliases resolved
    options: Mapping[str, str]  # values by key, without blanks

    def error(self, reason: str) -> ModelError:
        """An error that names the file, the line and the section."""
        return ModelError(f"{self.path}, line {self.line}, [{_short(self.kind)}]: {reason}.")

    def integer(self, key: str, default: int | None = None, *, minimum: int = 0) -> int:
        """The integer under `key`, at least `minimum`."""
        return self._bounded(key, self._text(key, default), minimum)

    def integers(self, key: str) -> tuple[int, ...]:
        """The integers under `key`, which may be negative."""
        return tuple(self._bounded(key, text, -_MAX_INTEGER) for text in self._list(key))

    def numbers(self, key: str, default: float | None = None) -> tuple[float, ...]:
        """The finite numbers under `key`."""
        if default is not None and key not in self.options:
            return (default,)
        values = tuple(numbers(self._list(key)))
        if not all(abs(value) <= _MAX_NUMBER for value in values):  # NaN fails, too
            raise self._invalid(key, f"finite numbers up to {_MAX_NUMBER:,.0f}")
        return values

    def word(self, key: str, default: str, known: Collection[str]) -> str:
        """The word under `key`, one of `known`."""
        word = self.options.get(key, default)
        if word not in known:
            raise self._invalid(key, f"one of {', '.join(known)}")
        return word

    def require_defaults(self, defaults: Mapping[str, float]) -> None:
        """Check that options that are not supported are absent or have their default values."""
        for key, value in defaults.items():
            if key in self.options and self.numbers(key) != (value,):
                raise self._invalid(key, f"{key}={value:g} (the only supported value)")

    def _text(self, key: str, default: object = None) -> str:
        if default is None and key not in self.options:
            raise self.error(f"expected a line '{key}=...', found none")
        return self.options.get(key, str(default))

    def _list(self, key: str) -> list[str]:
        texts = [text for text in self._text(key).split(",") if text]
        if not texts:
            raise self._invalid(key, "numbers")
        return texts

    def _bounded(self, key: str, text: str, minimum: int) -> int:
        value = number(text)
        if not minimum <= value <= _MAX_INTEGER or value % 1 or not _INTEGER.fullmatch(text):
            raise self._invalid(key, f"integers from {minimum} to {_MAX_INTEGER}")
        return int(value)

    def _invalid(self, key: str, expected: str) -> ModelError:
        return self.error(f"expected {expected}, got '{_short(f'{key}={self.options.get(key)}')}'")


def read_sections(path: Path, known: Collection[str]) -> list[CfgSection]:
    """The sections of a cfg: [net], then sections in `known`; ModelError for an unreadable file or
    unknown sections.
    """
    content = read_bytes(path, ModelError, "a Darknet cfg", max_bytes=MAX_TEXT_BYTES)
    text = content.decode("utf-8-sig", errors="replace")  # comments may have any encoding
    sections: list[CfgSection] = []
    options: dict[str, str] = {}
    for line_number, raw in enumerate(text.split("\n"), start=1):
        line = "".join(raw.partition("#")[0].split())  # without blanks and comments
        if not line or line.startswith(";"):
            continue
        key, equals, value = line.partition("=")
        if line.startswith("["):
            kind, options = line.strip("[]"), {}
            sections.append(CfgSection(path, line_number, _ALIASES.get(kind, kind), options))
        elif equals and key and sections:
            options.setdefault(key, value)
        else:
            raise ModelError(
                f"{path}, line {line_number}: expected [section] or key=value, got "
                f"'{_short(line)}'."
            )
    if not sections or sections[0].kind != "net":
        first = f"[{_short(sections[0].kind)}]" if sections else "no section"
        raise ModelError(
            f"{path}: expected a Darknet cfg whose first section is [net], got {first}."
        )
    for section in sections[1:]:
        if section.kind not in known:
            supported = ", ".join(f"[{kind}]" for kind in known)
            raise section.error(f"this section is not supported; expected one of {supported}")
    return sections


def _short(text: str) -> str:
    shown = text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}..."
    return "".join(character if character.isprintable() else "?" for character in shown)
