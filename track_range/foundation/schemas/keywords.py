"""Names of options in errors: `--focal-px` on the command line, `focal_px=` in Python.

Sentences name options by their flags. Functions of the Python API have the decorator
`KeywordsInErrors`, which replaces the flags by keywords, except on the command line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import ContextDecorator, contextmanager
from contextvars import ContextVar
from types import TracebackType
from typing import TYPE_CHECKING

from track_range.foundation.errors import UserError

if TYPE_CHECKING:
    from track_range.foundation.schemas.options import Options

_is_command_line = ContextVar("is_command_line", default=False)

_FLAG = re.compile(
    r"`[^`]*`|\btrack-range [a-z -]+ --.*|(?<![\w-])(--[a-z][a-z0-9-]*)(?:([ =])(?=(\S*)))?",
    re.DOTALL,
)
"""A command to type, or a flag, the character before the next word, and this word, which may be its
value."""


@contextmanager
def flags_in_errors() -> Iterator[None]:
    """Context of the command line, in which errors name options by their flags."""
    token = _is_command_line.set(True)
    try:
        yield
    finally:
        _is_command_line.reset(token)


class KeywordsInErrors(ContextDecorator):
    """Context or decorator in which errors name the options of a model by their keywords."""

    def __init__(self, model: type[Options]) -> None:
        self._model = model

    def __enter__(self) -> None:
        pass

    def __exit__(
        self,
        _type: type[BaseException] | None,
        error: BaseException | None,
        _at: TracebackType | None,
    ) -> None:
        if isinstance(error, UserError) and not _is_command_line.get():
            error.args = tuple(
                with_keywords(part, self._model) if isinstance(part, str) else part
                for part in error.args
            )


def with_keywords(sentence: str, model: type[Options]) -> str:
    """A sentence with keywords for the flags of a model: `focal_px: ...` at its beginning,
    `focal_px=` elsewhere.
    """
    from track_range.foundation.schemas.options import (  # imports pydantic
        choices_of,
        option_of,
        value_type,
    )

    fields = {model.flag(name): name for name in model.model_fields}

    def keyword(match: re.Match[str]) -> str:
        flag, separator, word = match.groups()
        is_off = flag is not None and flag not in fields and flag.startswith("--no-")
        name = fields.get(f"--{flag.removeprefix('--no-')}" if is_off else flag)
        if name is None:
            return match[0]
        before, after, field = (
            sentence[: match.start()],
            sentence[match.end() :],
            model.model_fields[name],
        )
        if after.startswith((":", ", --")) and all(
            part.startswith("--") for part in before.split()
        ):
            return name
        if value_type(field) is bool:
            return f"{name}={not is_off}{separator or ''}"
        words = (*option_of(field).words, *choices_of(field))
        is_value = (
            separator == "=" or _VALUE.match(word or "") or (word or "").rstrip(".,;:") in words
        )
        return f"{name}={'' if is_value else separator or ''}"

    return _FLAG.sub(keyword, sentence)


# a quoted text, a number, a placeholder, or what is before a colon
_VALUE = re.compile(r"'|-?\d|[A-Z]|\S+:$")
