"""Repetition of requests to a storage whose network or server fails for a moment."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

from track_range.fleet.storage.errors import StorageError

_R = TypeVar("_R")

_PAUSES_S = (1.0, 3.0, 10.0)
"""Pauses after the failed attempts, s."""


def repeated(request: Callable[[], _R]) -> _R:
    """Result of a request, which is repeated after errors that may disappear.

    Raises:
        StorageError: another error, or the last attempt failed.
    """
    for pause_s in _PAUSES_S:
        try:
            return request()
        except StorageError as error:
            if not error.is_transient:
                raise
            time.sleep(pause_s)
    return request()
