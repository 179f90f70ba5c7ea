"""Dates and times in text: ISO 8601, and the notations of loggers and apps."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.recording.telemetry.tracks.track import Clock, TelemetryError

DAY_S = 86_400.0
_DATES = (  # notations besides ISO 8601; of several with which all texts can be read, the first
    *(
        "%Y-%m-%d",
        "%d.%m.%Y",
        "%Y:%m:%d",
        "%Y.%m.%d",
        "%Y/%m/%d",
        "%Y%m%d",
        "%d-%b-%Y",
        "%d-%b-%y",
        "%d %b %Y",
        "%d %B %Y",
    ),
    *("%b %d %Y", "%B %d %Y", "%d.%m.%y"),
    *("%m/%d/%Y", "%d/%m/%Y", "%m-%d-%Y", "%d-%m-%Y"),  # with two digits, the year may be first
)
_CLOCKS = ("%H:%M:%S", "%I:%M:%S %p", "%H%M%S", "%H:%M")
_NOTATIONS = (
    "%b %d %H:%M:%S %z %Y",  # Torque
    "%b %d %H:%M:%S %Y",  # of C
    *(f"{date} {clock}{zone}" for zone in ("", " %z") for clock in _CLOCKS for date in _DATES),
    *(f"{clock} {date}" for clock in _CLOCKS[:1] for date in _DATES),
    *_CLOCKS[:2],
)
_READ = "31.05.2026, 31 May 2026, 05/31/2026 or 31-05-2026 with 21:30:00 or 9:30:00 PM"
_FRACTION = re.compile(r"(?<=:\d\d)[.,](\d+)")
_PLAIN = {  # what no notation has, and what it means; patterns
    r"\b(?:mon|tue|wed|thu|fri|sat|sun)[a-z]*[,.]?\s": "",
    r",|(?<=\d)T(?=\d)|(?:GMT|UTC)(?=[+-])": " ",
    r"\s?(?:GMT|UTC)(?![+-])|(?<=\d)Z$": " +0000",
    r"\b([ap])\.m\.": r"\1m",
    r"[年月]": "-",
    "日": " ",
}
_N_TRIED = 50  # number of texts from which the notation is found


def times_of_texts(texts: Sequence[str], path: Path) -> tuple[FloatArray, Clock]:
    """(N,) seconds since 1970, or since midnight where no text has a date, NaN = unreadable, and
    their clock.

    The clock is UTC where most texts state a time zone. Raises TelemetryError, which names `path`,
    if most texts are no times, or their order of day and month is not clear.
    """
    tried = [text for text in texts if re.search(r"\d", text)][:_N_TRIED]
    n_read = {
        notation: sum(_moment(text, notation) is not None for text in tried)
        for notation in (None, *_NOTATIONS)
    }
    notation = max(n_read, key=lambda notation: n_read[notation])
    if not tried or n_read[notation] <= len(tried) / 2:
        raise TelemetryError(
            f"{path}: expected dates and times, found {quoted((tried or list(texts))[0])}; write "
            f"them like 2026-05-31 09:30:00, as seconds since 1970, or like {_READ}."
        )
    other = (notation or "").translate(str.maketrans("dm", "md"))
    # where AM and PM are used, the month is first unless it cannot be
    if n_read.get(other) == n_read[notation] and other != notation and "%p" not in other:
        raise TelemetryError(
            f"{path}: expected dates with a clear order of day and month, found "
            f"{quoted(tried[0])}; write them like 2026-05-31 09:30:00."
        )
    moments = [_moment(text, notation) for text in texts]
    read = [moment for moment in moments if moment is not None]
    zoned = sum(moment.tzinfo is not None for moment in read)
    start = datetime(1900, 1, 1, tzinfo=UTC)  # the date of times without one
    seconds = np.array(
        [
            np.nan
            if moment is None
            else (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
            for moment in moments
        ]
    )
    if notation in _CLOCKS:
        seconds = unwrapped(seconds - start.timestamp())
    return seconds, "utc" if zoned > len(read) / 2 else "local"


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
        fraction = _FRACTION.search(text[:60])
        plain = _FRACTION.sub("", text[:60])
        for pattern, meaning in _PLAIN.items():
            plain = re.sub(pattern, meaning, plain, flags=re.IGNORECASE)
        moment = datetime.strptime(" ".join(plain.split()), notation)
    except (ValueError, OverflowError):
        return None
    return moment if fraction is None else moment + timedelta(seconds=float(f"0.{fraction[1]}"))
