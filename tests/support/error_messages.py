"""What the message of an error of the user is like: one short, printable sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from track_range.foundation.errors import UserError

MAX_MESSAGE = 300
"""Largest number of characters of a message without the path."""


def error_message(
    kind: type[UserError], call: Callable[..., object], *arguments: Any, **options: Any
) -> str:
    """The message of the error of `kind` that a call raises; it must be one short sentence."""
    with pytest.raises(kind) as raised:
        call(*arguments, **options)
    message = str(raised.value)
    check_sentence(message, *arguments)
    return message


def check_sentence(message: str, *paths: object) -> None:
    """Check that a message is one short, printable sentence without regard to these paths in
    it."""
    assert message.isprintable()
    for path in paths:
        message = message.replace(str(path), "")
    assert len(message) <= MAX_MESSAGE
