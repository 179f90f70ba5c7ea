"""ImageClock: the times of the images of a topic, from their time stamps or from the times at which
they were recorded.
"""

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.recording.video.frame import TIME_EPSILON_S, strictly_later

_FALLBACK_RATE_HZ = 10.0  # of a topic with a single message
# images that arrive out of order are earlier by less; a clock is set back by more
_MIN_SET_BACK_S = 1.0


class ImageClock:
    """Times of one pass over the images, from (N, 2) time stamps and recording times of the first
    ones.

    A clock that is set back goes on from the last image by the usual interval. ValueError, whose
    text continues "expected": neither the time stamps nor the times of recording are those of the
    images.
    """

    def __init__(self, first_s: FloatArray) -> None:
        self.fault = _fault_of_stamps(first_s)
        times_s = first_s[:, 1 if self.fault else 0]
        self.first_time_s = float(times_s[0])
        steps_s = np.diff(times_s)
        steps_s = steps_s[steps_s > TIME_EPSILON_S]
        self.fps = float(1 / np.median(steps_s)) if steps_s.size else _FALLBACK_RATE_HZ
        self.n_backward = 0  # images that were left out
        self.set_back: list[tuple[float, float]] = []  # times at which it was, and by how much, s
        self._last_s: float | None = None
        self._shift_s = 0.0  # from the clock to the times
        self._earlier_s = np.inf  # time of the image before, if it was left out as too early by far

    def time_s(self, stamp_s: float, recorded_s: float) -> float | None:
        """The time of the next image; None = it is left out, since its time is not later."""
        clock_s = recorded_s if self.fault or np.isnan(stamp_s) else stamp_s
        shown_s = clock_s + self._shift_s
        time_s = strictly_later(shown_s, self._last_s, interval_s=1 / self.fps)
        last_s = shown_s if self._last_s is None else self._last_s
        # two images in order, both too early: the clock was set back, and no image came late
        if time_s is None and shown_s > self._earlier_s:
            time_s = last_s + 2 / self.fps
            self.set_back.append((last_s - self.first_time_s, time_s - shown_s))
            self._shift_s = time_s - clock_s
        self.n_backward += time_s is None
        is_too_early = time_s is None and shown_s < last_s - _MIN_SET_BACK_S
        self._earlier_s = shown_s if is_too_early else np.inf
        self._last_s = last_s if time_s is None else time_s
        return time_s


def _fault_of_stamps(first_s: FloatArray) -> str:
    """Why the time stamps are not the times of the images, for a note; "" = they are."""
    # see `decoding.stamp_s`; the other stamps are right by chance only
    if np.isnan(first_s).any():
        return "the nanoseconds of time stamps are 1e9 or more, which no clock states"
    if not (first_s[:, 0] > 0).any():  # a simulation may begin at 0
        return "images have no time stamps"
    is_repeated = np.diff(first_s, axis=0, append=np.full((1, 2), np.inf)) <= TIME_EPSILON_S
    repeats_stamps, repeats_both = is_repeated.mean(axis=0) > 0.5
    if not repeats_stamps:
        return ""
    if repeats_both:
        raise ValueError(
            f"images at different times, found {len(first_s)} of which most have the time stamp "
            "and time of recording of an earlier one; record or convert the bag with its times"
        )
    return "images repeat the time stamps of earlier ones"
