"""Dates and times in text: ISO 8601, and the notations of loggers and apps."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.recording.telemetry.tracks.track import Clock, TelemetryError

DAY_S = 86_400.0
_FORMATS = (  # besides ISO 8601; the first with which most texts can be read
    "%a %b %d %H:%M:%S %Z%z %Y",  # Torque
    "%a %b %d %H:%M:%S %Z %Y",
    "%d-%b-%Y %H:%M:%S.%f",
    "%d-%b-%Y %H:%M:%S",
    "%d.%m.%Y %H:%M:%S.%f",
    "%d.%m.%Y %H:%M:%S",
    "%Y:%m:%d %H:%M:%S",
    "%m/%d/%Y %I:%M:%S %p",
    "%m/%d/%Y %I:%M:%S.%f %p",
    "%d/%m/%Y %H:%M:%S",
    "%d/%m/%Y %H:%M:%S.%f",
    "%m/%d/%Y %H:%M:%S",
    "%m/%d/%Y %H:%M:%S.%f",
    "%H:%M:%S.%f",
    "%H:%M:%S",
    "%I:%M:%S %p",
    "%I:%M:%S.%f %p",
)
# day and month may be exchanged
_UNCLEAR = re.compile(r"(0?[1-9]|1[0-2])/(0?[1-9]|1[0-2])/\d{4} [\d:.]+")
_N_TRIED = 50  # number of texts from which the notation is found


def times_of_texts(texts: Sequence[str], path: Path) -> tuple[FloatArray, Clock]:
    """(N,) seconds since 1970, or since midnight where no text has a date, NaN = unreadable, and
    their clock.

    The clock is UTC where most texts state a time zone. Raises TelemetryError, which names `path`,
    for dates whose order of day and month is not clear.
    """
    tried = [text for text in texts if text][:_N_TRIED]
    notation = max(
        (None, *_FORMATS),
        key=lambda notation: sum(_moment(text, notation) is not None for text in tried),
    )
    if (
        notation is not None
        and notation.startswith("%d/%m")
        and all(_UNCLEAR.fullmatch(text) for text in texts if text)
    ):
        raise TelemetryError(
            f"{path}: expected dates with a clear order of day and month, found "
            f"{quoted(tried[0])}; write them like 2026-05-31 09:30:00."
        )
    moments = [_moment(text, notation) for text in texts]
    zoned = sum(moment is not None and moment.tzinfo is not None for moment in moments)
    start = datetime(1900, 1, 1, tzinfo=UTC)  # the date of times without one
    seconds = np.array(
        [
            np.nan
            if moment is None
            else (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
            for moment in moments
        ]
    )
    if notation is not None and "Y" not in notation:
        seconds = unwrapped(seconds - start.timestamp())
    return seconds, "utc" if zoned > len(texts) / 2 else "local"


def unwrapped(time_s: FloatArray) -> FloatArray:
    """(N,) times of the day in seconds that go on after midnight; NaN = unknown."""
    known = np.isfinite(time_s)
    result = time_s.copy()
    result[known] += DAY_S * np.cumsum(
        np.diff(time_s[known], prepend=time_s[known][:1]) < -DAY_S / 2
    )
    return result


def _moment(text: str, notation: str | None) -> datetime | None:
    """The moment that a text states in a notation, None = ISO 8601; returns None for other
    texts.
    """
    try:
        if notation is None:
            return datetime.fromisoformat(text[:40].replace("/", "-"))
        return datetime.strptime(text[:60], notation)
    except (ValueError, OverflowError):
        return None
