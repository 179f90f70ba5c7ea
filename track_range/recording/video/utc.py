"""UtcStart: the time of day at which a recording starts, from the file's header, its name or a
clock.

    header with time zone > header in UTC > name of the file

A header states the start or, on some phones and dashcams, the end of the recording, without saying
which. If the name contains a time too, it decides: names contain the start in local time, and time
zones are multiples of 15 minutes. Some dashcams write their local time to the header, which should
be UTC: if it equals the time in the name, the zone is unknown.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from track_range.foundation.files.input_files import quoted

# largest difference of local time and UTC (Kiribati), and their step
ZONE_SPAN_S, ZONE_STEP_S = 14 * 3600.0, 900.0
STAMP_RESOLUTION_S = 1.0  # of times in headers and names
# largest difference between times of a header and a name that are the same moment; assumed
_AGREEMENT_S = 5.0

_EARLIEST, _LATEST = datetime(1990, 1, 1, tzinfo=UTC), datetime(2100, 1, 1, tzinfo=UTC)
"""Range of plausible times; headers without a time often state 1904 or 1970."""

# 20260131_142530, 2026-01-31_14-25-30, 2026_0131_142530, 20260131T142530Z
_TIME_IN_NAME = re.compile(
    r"(?<!\d)((?:19|20)\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])"
    r"(?:[-_.T ]{1,3}|[ _]at[ _])?"
    r"([01]\d|2[0-3])[-_.:h]?([0-5]\d)[-_.:m]?([0-5]\d)(?:\.?(\d{3}))?(?!\d)(?:(Z)|([+-]\d{4})(?!\d))?"
)
_SHORT_TIME_IN_NAME = re.compile(  # of 2010 to 2049, as Nextbase and 70mai write it: 260131_142530
    r"(?<!\d)([1-4]\d)(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])[-_]([01]\d|2[0-3])([0-5]\d)([0-5]\d)(?!\d)"
)


_STATED = "--start-utc"  # source of a time that the user states


@dataclass(frozen=True, slots=True)
class UtcStart:
    """UTC of a recording's first frame."""

    start_s: float  # seconds since 1970-01-01 00:00 UTC
    source: str  # source of the time, for summary.json
    # largest error besides that of the recorder's clock; None = unknown
    uncertainty_s: float | None
    # whether the time zone is unknown: `start_s` may be the recorder's local time
    is_local: bool = False

    @property
    def is_stated(self) -> bool:
        """Whether the user has stated this time."""
        return self.source == _STATED

    def summary(self) -> dict[str, Any]:
        """Section `utc` of summary.json."""
        start = datetime.fromtimestamp(self.start_s, UTC).isoformat(timespec="milliseconds")
        return {
            "start": start.replace("+00:00", "Z"),
            "source": self.source,
            "uncertainty_s": self.uncertainty_s,
        }

    def note(self) -> str | None:
        """Message for the user if the time zone is unknown."""
        if not self.is_local:
            return None
        return (
            f"The time zone of the column utc is unknown (source: {self.source}): it may be the "
            "local time of the recorder; give the time of the first frame with --start-utc."
        )

    def shifted(self, by_s: float) -> UtcStart:
        """The time of a moment `by_s` seconds later."""
        return replace(self, start_s=self.start_s + by_s)


@dataclass(frozen=True, slots=True)
class Stamp:
    """A date and time that a header or a name states."""

    time_s: float  # seconds since 1970, in UTC, or in local time if `is_local`
    source: str  # source of the time, for summary.json
    is_local: bool = False  # whether no time zone is stated
    is_start: bool = True  # whether it is known to be the start of the recording


def parsed_utc(text: str) -> UtcStart:
    """The time of `--start-utc`, ISO 8601 and UTC if it states no zone; raises ValueError if it is
    no date and time.
    """
    moment = _parsed(text)
    if moment is None:
        raise ValueError(
            f"expected a date and time such as 2026-01-31T14:25:30.000Z, got {quoted(text)}"
        )
    return UtcStart(moment.timestamp(), _STATED, None)


def stamp_in_header(metadata: Mapping[str, str]) -> Stamp | None:
    """The date and time in a video file's metadata; None if there are none, or implausible ones."""
    apple = _parsed(metadata.get("com.apple.quicktime.creationdate", ""))
    if apple is not None:
        return Stamp(apple.timestamp(), "creation date with time zone of the video file")
    created = _parsed(metadata.get("creation_time", ""))
    return (
        None
        if created is None
        else Stamp(created.timestamp(), "creation time of the video file", is_start=False)
    )


def stamp_in_name(name: str) -> Stamp | None:
    """The last date and time in a file name; None if there is none."""
    matches = list(_TIME_IN_NAME.finditer(name))
    if matches:
        *digits, thousandths, zulu, offset = matches[-1].groups()
    elif short := list(_SHORT_TIME_IN_NAME.finditer(name)):
        year, *later = short[-1].groups()
        digits, thousandths, zulu, offset = [f"20{year}", *later], None, None, None
    else:
        return None
    try:
        moment = datetime(*(int(part) for part in digits), tzinfo=UTC)  # type: ignore[misc, arg-type]
    except ValueError:  # February 30
        return None
    time_s = moment.timestamp() + int(thousandths or 0) / 1000
    if offset:
        time_s -= int(f"{offset[0]}1") * 60 * (60 * int(offset[1:3]) + int(offset[3:5]))
    return Stamp(time_s, "file name", is_local=not (zulu or offset))


def start_of(header: Stamp | None, name: Stamp | None, duration_s: float) -> UtcStart | None:
    """The start of a file that lasts `duration_s`, from the times of its header and of its name;
    None = unknown.
    """
    if header is None:
        if name is None:
            return None
        uncertainty_s = ZONE_SPAN_S if name.is_local else STAMP_RESOLUTION_S
        return UtcStart(name.time_s, name.source, uncertainty_s, is_local=name.is_local)
    if header.is_start:
        return UtcStart(header.time_s, header.source, STAMP_RESOLUTION_S)
    # the header may state the end
    unconfirmed = UtcStart(header.time_s, header.source, round(STAMP_RESOLUTION_S + duration_s, 3))
    if name is None:
        return unconfirmed
    for start_s in (header.time_s, header.time_s - duration_s):
        difference_s = name.time_s - start_s
        # the zone is UTC, or local time was written as UTC
        if name.is_local and abs(difference_s) <= _AGREEMENT_S:
            return UtcStart(start_s, header.source, ZONE_SPAN_S, is_local=True)
        if (
            abs(math.remainder(difference_s, ZONE_STEP_S) if name.is_local else difference_s)
            <= _AGREEMENT_S
        ):
            return UtcStart(start_s, header.source, STAMP_RESOLUTION_S)
    return unconfirmed


def _parsed(text: str) -> datetime | None:
    """A plausible date and time in ISO 8601, UTC if it names no zone; None for other texts."""
    try:
        moment = datetime.fromisoformat(text.strip())
        if moment.tzinfo is None:
            moment = moment.replace(tzinfo=UTC)
        is_plausible = _EARLIEST <= moment <= _LATEST
    except (ValueError, OverflowError):
        return None
    return moment if is_plausible and len(text.strip()) > len("2026-01-31") else None
