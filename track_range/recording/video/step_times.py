"""StepTimes: the times of frames that a program gives one by one, on any clock, in seconds or in
whole nanoseconds.
"""

import math
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, NamedTuple

from track_range.foundation.errors import Note
from track_range.recording.video.frame import FrameError

# steps between frames, so many in a row, that are probably no seconds
_LONG_STEP_S, _N_LONG_STEPS = 5.0, 3
_NS = 1_000_000_000
_OF_LAST = "the time of the last frame"
_NO_SECONDS = Note(
    "time_s: the latest frames are more than 5 s apart, so no road user is tracked; give time_s in "
    "seconds, or time_ns in nanoseconds.",
    "times-not-in-seconds",
    "error",
)


class Moment(NamedTuple):
    """A time on the clock of the images."""

    clock_s: float
    ns: int | None = None  # the same in whole nanoseconds, if it was given so

    def since_s(self, other: "Moment") -> float:
        """Seconds since another moment, without the rounding of large numbers of nanoseconds."""
        if self.ns is not None and other.ns is not None:
            return (self.ns - other.ns) / _NS
        return self.clock_s - other.clock_s


@dataclass(slots=True)
class StepTimes:
    """The first and the last moment of a drive, whose times increase."""

    first: Moment | None = None
    last: Moment | None = None
    n_long_steps: int = 0  # in a row, up to the last frame

    def moment(self, time_s: Any, time_ns: Any) -> Moment:
        """The moment of the next frame, in seconds or in whole nanoseconds; FrameError for another
        value, or a time that does not increase.
        """
        if time_ns is not None:
            return self._of_ns(time_s, time_ns)
        is_number = isinstance(time_s, Real) and not isinstance(time_s, bool)
        if is_number and math.isfinite(time_s) and self._increases(Moment(float(time_s))):
            return Moment(float(time_s))
        after = "" if self.last is None else f" after {self.last.clock_s} s, {_OF_LAST}"
        raise FrameError(f"time_s: expected a time in seconds{after}, found {time_s!r}.")

    def _of_ns(self, time_s: Any, time_ns: Any) -> Moment:
        if time_s is not None:
            raise FrameError("time_ns: expected either time_s or time_ns, found both.")
        if isinstance(time_ns, Integral) and not isinstance(time_ns, bool):
            moment = Moment(int(time_ns) / _NS, int(time_ns))
            if self._increases(moment):
                return moment
        last = self.last
        last_ns = None if last is None else last.ns or round(last.clock_s * _NS)
        after = "" if last_ns is None else f" after {last_ns} ns, {_OF_LAST}"
        raise FrameError(f"time_ns: expected whole nanoseconds{after}, found {time_ns!r}.")

    def since_first_s(self, moment: Moment) -> float:
        """Time of a frame from the first one."""
        return moment.since_s(self.first or moment)

    def add(self, moment: Moment) -> None:
        """Use the moment of a frame that was processed."""
        is_long = self.last is not None and moment.since_s(self.last) > _LONG_STEP_S
        self.n_long_steps = min(self.n_long_steps + 1, _N_LONG_STEPS) if is_long else 0
        self.first, self.last = self.first or moment, moment

    @property
    def notes(self) -> tuple[str, ...]:
        """A message for the user on times that are probably no seconds."""
        return (_NO_SECONDS,) if self.n_long_steps == _N_LONG_STEPS else ()

    def _increases(self, moment: Moment) -> bool:
        return self.last is None or moment.since_s(self.last) > 0
