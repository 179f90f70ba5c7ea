"""Darknet's cfg text: sections of `key=value` lines, and what they say as numbers.

    [convolutional]        # a section is a layer, the first one, [net], the input
    filters=32
    layers = -1, -4        # blanks mean nothing; what follows # is a comment

An option given twice counts as it stands first, as in Darknet (`option_find` of its option_list.c).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from track_range.detection.models.onnx_session import ModelError

_ALIASES = {"network": "net", "conv": "convolutional", "max": "maxpool"}
_MOST = 65535
"""No whole number of a cfg that we read is larger: pixels, channels, layers."""
_SHOWN_CHARACTERS = 40


@dataclass(frozen=True, slots=True)
class Section:
    """One section.

    Attributes:
        path, line: where it stands; lines count from 1.
        kind: what stands in its brackets, short forms written out.
        options: its lines, without blanks.
    """

    path: Path
    line: int
    kind: str
    options: Mapping[str, str]

    def error(self, reason: str) -> ModelError:
        """An error that names the file, the line and the section."""
        return ModelError(f"{self.path}, line {self.line}, [{self.kind}]: {reason}.")

    def whole(self, key: str, default: int | None = None, *, least: int = 0) -> int:
        """The whole number under `key`, from `least` on.

        Raises:
            ModelError: something else stands there, or nothing and there is no default.
        """
        return self._bounded(key, self._text(key, default), least)

    def wholes(self, key: str) -> tuple[int, ...]:
        """The whole numbers under `key`, which may be negative.

        Raises:
            ModelError: there are none.
        """
        return tuple(self._bounded(key, text, -_MOST) for text in self._list(key))

    def numbers(self, key: str, default: float | None = None) -> tuple[float, ...]:
        """The numbers under `key`.

        Raises:
            ModelError: there are none and no default, or one of them is not finite.
        """
        if default is not None and key not in self.options:
            return (default,)
        try:
            values = tuple(float(text) for text in self._list(key))
        except ValueError as error:
            raise self._wrong(key, "numbers wanted") from error
        if not all(math.isfinite(value) for value in values):
            raise self._wrong(key, "numbers wanted")
        return values

    def word(self, key: str, default: str, known: Collection[str]) -> str:
        """The word under `key`, one of those known.

        Raises:
            ModelError: another one.
        """
        word = self.options.get(key, default)
        if word not in known:
            raise self._wrong(key, f"known here: {', '.join(known)}")
        return word

    def refuse(self, usual: Mapping[str, float]) -> None:
        """Check options that change what a layer computes in ways unknown here: each absent, or as usual.

        Raises:
            ModelError: one of them is set.
        """
        for key, value in usual.items():
            if key in self.options and self.numbers(key) != (value,):
                raise self._wrong(key, f"only {key}={value:g} can be imported")

    def _text(self, key: str, default: object) -> str:
        if default is None and key not in self.options:
            raise self.error(f"it has no line '{key}=...'")
        return self.options.get(key, str(default))

    def _list(self, key: str) -> list[str]:
        texts = [text for text in self._text(key, None).split(",") if text]
        if not texts:
            raise self._wrong(key, "numbers wanted")
        return texts

    def _bounded(self, key: str, text: str, least: int) -> int:
        try:
            value = int(text)
        except ValueError:
            value = _MOST + 1
        if not least <= value <= _MOST:
            raise self._wrong(key, f"whole numbers from {least} to {_MOST} wanted")
        return value

    def _wrong(self, key: str, wanted: str) -> ModelError:
        return self.error(f"'{_short(f'{key}={self.options.get(key)}')}' cannot be used; {wanted}")


def read_sections(path: Path, known: Collection[str]) -> list[Section]:
    """The sections of a cfg, [net] first and only there.

    Args:
        path: the cfg.
        known: kinds of sections that may come, [net] apart.

    Raises:
        ModelError: no readable cfg, or a section that is not known.
    """
    sections = list(_sections(path, _text_of(path)))
    if not sections or sections[0].kind != "net":
        found = f"the first section is [{sections[0].kind}]" if sections else "no sections"
        raise ModelError(f"{path}: {found}; a Darknet cfg begins with [net].")
    for section in sections[1:]:
        if section.kind not in known:
            raise section.error(f"this kind of section cannot be imported; known: {', '.join(f'[{k}]' for k in known)}")
    return sections


def _text_of(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8-sig", errors="replace")  # comments come in every encoding
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror}).") from error


def _sections(path: Path, text: str) -> Iterator[Section]:
    options: dict[str, str] = {}
    is_open = False
    for number, line in _lines(text):
        if line.startswith("["):
            kind = line.strip("[]")
            options, is_open = {}, True
            yield Section(path, number, _ALIASES.get(kind, kind), options)
            continue
        key, equals, value = line.partition("=")
        if not (equals and key and is_open):
            raise ModelError(
                f"{path}, line {number}: '{_short(line)}' is no line of a Darknet cfg: [section], then key=value."
            )
        options.setdefault(key, value)


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Numbered lines that say something, without blanks and comments."""
    for number, raw in enumerate(text.split("\n"), start=1):
        line = "".join(raw.partition("#")[0].split())
        if line and not line.startswith(";"):
            yield number, line


def _short(text: str) -> str:
    shown = text if len(text) <= _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]}..."
    return "".join(character if character.isprintable() else "?" for character in shown)
