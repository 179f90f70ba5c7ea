r"""SyncMonitor: checks during the whole run that left and right show the same moment, and corrects
the pairing if not.

    frame -> changes of both images -> one side repeats its image, or shows nothing?   stereo of the frame is off
          -> now and then, and where the changes differ: `measured_lag` -> lag of up to 5 frames?
          -> wait for `n_ahead` frames -> frame with the right image that shows its moment

A lag counts after two checks of successive frames with the same result: that the right image of
some frames later or earlier has no lag. Until then, stereo is off in the frames that contradict the
present pairing.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from statistics import median
from typing import Any, Literal

import cv2
import numpy as np

from track_range.foundation.arrays import Image
from track_range.foundation.errors import Note
from track_range.foundation.files.input_files import counted
from track_range.stereo.alignment.sync_check import Lag, measured_lag
from track_range.stereo.geometry.frames import Frame, ImageView, whole_image
from track_range.stereo.geometry.rectification import RemappedView
from track_range.stereo.odometry.image_times import sampled

Side = Literal["left", "right"]
Kind = Literal["repeated", "lag", "apart", "uniform"]
Action = Literal["stereo off", "re-paired"]

_MAX_FINDINGS = 500  # largest number that is kept: one side may repeat every second image for hours
MAX_LAG = 5  # longest lag that is searched, in frames
# time between the two left images of a measurement, and its frames
_MIN_STEP_S, _STEPS = 0.07, (-1, -2, -3, 1, 2, 3)
_SAME, _OTHER = 0.4, 0.6  # largest lag in frames of simultaneous images, and smallest one of others
# successive checks after which a lag counts, or that there is none that fits
_N_AGREEING, _N_CONTRADICTING = 2, 3

PERIOD = 8  # frames between two checks without a reason
# measurements (3 ms each) per period in the long run, and at most at once
_INCOME, _MAX_CREDIT = 1.15, 60.0
# successive checks without a result after which all lags are tried: their images are there
_N_FAILED = MAX_LAG + 1
# change of the logarithm of the ratio of right and left changes that is a reason for a check
_CLEAR_RATIO = 0.15

_N_USUAL, _MIN_USUAL = 15, 3  # number of frames whose median is the usual change
# largest change of a repeated image relative to its usual one, or to the other's
_REPEATED, _NEVER_NEW = 0.25, 0.03
# standard deviation of grey levels of an image that shows nothing, and of the other
_UNIFORM, _STRUCTURED = 3.0, 8.0
# change of the small images by noise, and the smallest one by motion, grey levels
_NOISE, _MIN_CHANGE = 0.3, 1.0


@dataclass(slots=True)
class SyncFinding:
    """Part of a drive in which left and right do not show the same moment."""

    frame: int  # its first frame
    time_s: float
    side: Side  # the side that repeats its image or is late
    kind: Kind  # "apart": no lag of up to `MAX_LAG` frames fits
    lag_frames: int
    frames: int  # its length
    action: Action

    def continues(self, other: SyncFinding) -> bool:
        """Whether both are the same fault."""
        own, others = ((x.kind, x.side, x.lag_frames) for x in (self, other))
        return own == others


@dataclass(slots=True)
class _Entry:
    frame: Frame
    small: tuple[Image, Image]
    # the right image of its moment is that many frames later; None = stereo is off
    shift: int | None
    # whether the left and the right image repeat the frame before
    repeated: tuple[bool, bool] = (False, False)
    # whether the image that counts as repeated shows nothing: covered, or without a signal
    is_uniform: bool = False
    # whether stereo is off since left and right do not agree, which may have other reasons
    is_unknown: bool = False


@dataclass(slots=True)
class SyncMonitor:
    """Checks the frames of a pair in order.

    It waits for `n_ahead` frames, so that it finds most lags in time, and for twice as many until a
    check in motion.
    """

    n_ahead: int = 0
    period: int = PERIOD
    findings: list[SyncFinding] = field(default_factory=list)
    _entries: deque[_Entry] = field(default_factory=deque)  # the last frames; the newest ones wait
    _n_waiting: int = 0
    _shift: int | None = 0  # that of new frames
    _is_settled: bool = False  # whether a check has confirmed it
    _candidate: int | None = None  # another one, which the last checks found
    _n_votes: int = 0  # number of these checks
    _n_failed: int = 0  # number of the last checks that found nothing
    _last: SyncFinding | None = None  # the finding of the last frame that was returned
    _usual: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=_N_USUAL))
    _credit: float = _MAX_CREDIT
    _n_unchecked: int = PERIOD
    _is_of_right: bool = True  # whether the last check was made from the motion in the right video
    _is_urgent: bool = False  # whether there is a reason to check the next frame

    def add(self, frame: Frame) -> list[Frame]:
        """Check the next frame; returns the frames that need not wait any longer: without
        `n_ahead`, this frame.

        Their right images are simultaneous; None where such an image is unknown or missing.
        """
        if frame.right is None:
            return [frame]
        entry = _Entry(frame, (_small(frame.left), _small(frame.right)), self._shift)
        spread = np.array([cv2.meanStdDev(image)[1].item() for image in entry.small])
        entry.is_uniform = spread.min() < _UNIFORM and spread.max() > _STRUCTURED
        self._entries.append(entry)
        self._n_waiting += 1
        self._credit = min(self._credit + _INCOME / self.period, _MAX_CREDIT)
        self._n_unchecked += 1
        if entry.is_uniform:
            entry.repeated = bool(spread[0] < spread[1]), bool(spread[1] < spread[0])
        elif len(self._entries) > 1:
            self._compare(entry, self._entries[-2])
            is_due = self._is_urgent or self._n_unchecked >= self.period
            if is_due and self._credit >= 1 and not any(entry.repeated):
                self._check(entry)
        n_ahead = self.n_ahead if self._is_settled else 2 * self.n_ahead
        ready = []
        while self._n_waiting > n_ahead and (  # the right images of late frames follow
            not n_ahead or self._n_waiting > (self._entries[-self._n_waiting].shift or 0)
        ):
            ready.append(self._next())
        return ready

    def flush(self) -> Iterator[Frame]:
        """The frames that still wait, after the last frame."""
        while self._n_waiting:
            yield self._next()

    def _next(self) -> Frame:
        """The first frame that waits, with its right image."""
        place = len(self._entries) - self._n_waiting
        entry = self._entries[place]
        self._n_waiting -= 1
        at = -1 if entry.shift is None or entry.repeated[0] else place + entry.shift
        partner = self._entries[at] if 0 <= at < len(self._entries) else None
        right = None if partner is None or partner.repeated[1] else partner.frame.right
        self._note(entry, is_off=right is None)
        while len(self._entries) > MAX_LAG + 1 + self._n_waiting:
            self._entries.popleft()
        return entry.frame if right is entry.frame.right else replace(entry.frame, right=right)

    def _note(self, entry: _Entry, *, is_off: bool) -> None:
        """Add the frame to the findings."""
        before, self._last = self._last, None
        finding = self._finding_of(entry, is_off=is_off)
        if finding is None:
            return
        if before is None or not finding.continues(before):
            before = finding
            if len(self.findings) < _MAX_FINDINGS:
                self.findings.append(before)
        before.frames += 1
        # the first frames may lack a partner
        if finding.action == "re-paired":
            before.action = "re-paired"
        self._last = before

    @staticmethod
    def _finding_of(entry: _Entry, *, is_off: bool) -> SyncFinding | None:
        """What a frame alone shows, with no length yet; None = left and right are simultaneous, or
        nothing is known.
        """
        shift, frame = entry.shift or 0, entry.frame
        if not shift and (entry.is_unknown or not is_off):
            return None
        kind: Kind = "lag" if shift else "apart"
        if entry.is_uniform:
            kind = "uniform"
        elif any(entry.repeated):
            kind = "repeated"
        return SyncFinding(
            frame=frame.index,
            time_s=frame.time_s,
            side="left" if shift < 0 or entry.repeated[0] else "right",
            kind=kind,
            lag_frames=abs(shift),
            frames=0,
            action="stereo off" if is_off else "re-paired",
        )

    def _compare(self, entry: _Entry, before: _Entry) -> None:
        """Find repeated images, and whether the changes since the frame before are a reason for a
        check.
        """
        left, right = (
            cv2.norm(a, b, cv2.NORM_L1) / a.size
            for a, b in zip(entry.small, before.small, strict=True)
        )
        usual = tuple(map(median, zip(*self._usual, strict=True))) if self._usual else (left, right)
        if len(self._usual) >= _MIN_USUAL:
            entry.repeated = (
                _is_repeated(left, usual[0], right, usual[1], is_old=before.repeated[0]),
                _is_repeated(right, usual[1], left, usual[0], is_old=before.repeated[1]),
            )
        if not any(entry.repeated):
            self._usual.append((left, right))
            ratio = (right + _NOISE) / (usual[1] + _NOISE) * (usual[0] + _NOISE) / (left + _NOISE)
            self._is_urgent |= abs(math.log(ratio)) > _CLEAR_RATIO or any(before.repeated)

    def _check(self, entry: _Entry) -> None:
        """Measure the lag of the newest frame at the present shift, and look for another shift if
        it contradicts.
        """
        self._n_unchecked, self._is_urgent, self._is_of_right = 0, False, not self._is_of_right
        base = self._shift or 0
        lag = self._measured(self._newest(base), base, is_of_right=self._is_of_right)
        if lag is None:
            return
        best = base if _is_same(lag, _OTHER) else self._searched(base)
        self._n_failed = self._n_failed + 1 if best is None else 0
        if _is_other(lag):
            entry.shift = None
        elif best is None:
            self._is_urgent = entry.is_unknown = self._n_failed <= _N_FAILED
            entry.shift = None if entry.is_unknown else entry.shift
            return
        if best is not None and best == self._shift:
            self._candidate, self._n_votes, self._is_settled = None, 0, True
            return
        self._is_urgent = True
        self._n_votes = self._n_votes + 1 if best == self._candidate else 1
        self._candidate = best
        if best is not None and self._n_votes >= _N_AGREEING:
            self._change(best)
        elif best is None and self._n_votes >= _N_CONTRADICTING:
            self._shift = None

    def _searched(self, base: int) -> int | None:
        """The shift at which the newest frame has no lag; None = unknown."""
        candidate = self._candidate
        if candidate is not None and self._fits(self._newest(candidate), candidate):
            return candidate
        shift, tried = self._by_newton(base)
        if shift is not None:
            return shift
        if self._n_failed < _N_FAILED or self._credit < 2 * MAX_LAG:
            return None
        return self._best_of_all(tried)

    def _by_newton(self, base: int) -> tuple[int | None, set[int]]:
        """The shift without lag by Newton's method from `base`, None = not found; and the shifts that
        were tried.
        """
        shift, tried = base, set[int]()
        while self._n_failed <= _N_FAILED and shift not in tried and abs(shift) <= MAX_LAG:
            tried.add(shift)
            place = self._newest(shift)
            late = self._measured(place, shift)
            early = self._measured(place, shift, is_of_right=True)
            if shift != base and _is_same(late) and not _is_other(early):
                return shift, tried
            shift += _newton_step(late, early)
        return None, tried

    def _best_of_all(self, tried: set[int]) -> int | None:
        """The shift of all that were not tried at which most points have no lag; None = none, or it
        does not fit.
        """
        n_points = dict[int, int]()  # by shift without lag
        for shift in range(-MAX_LAG, MAX_LAG + 1):
            if shift in tried:
                continue
            lag = self._measured(self._newest(shift), shift)
            if lag is not None and _is_same(lag):
                n_points[shift] = lag.n_points
        if not n_points:
            return None
        best = max(n_points, key=n_points.__getitem__)
        return best if self._fits(self._newest(best), best) else None

    def _change(self, shift: int) -> None:
        """Use another shift from the first waiting frame on at which the present shift is wrong."""
        old, self._shift, self._candidate, self._n_votes = self._shift, shift, None, 0
        self._is_settled = True
        for place in range(len(self._entries) - self._n_waiting, len(self._entries)):
            if old is not None and self._fits(place, old):
                self._entries[place].shift = old
            else:
                lag = self._measured(place, shift)
                self._entries[place].shift = shift if lag is None or _is_same(lag, _OTHER) else None
        self._credit = max(self._credit, 2 * MAX_LAG)

    def _newest(self, shift: int) -> int:
        """Place of the newest left image that has a right image at a shift."""
        return len(self._entries) - 1 - max(shift, 0)

    def _fits(self, place: int, shift: int) -> bool:
        """Whether a left image and the right image at a shift show the same moment, from the motion
        in both videos.
        """
        lag = self._measured(place, shift)
        return _is_same(lag) and not _is_other(self._measured(place, shift, is_of_right=True))

    def _measured(self, place: int, shift: int, *, is_of_right: bool = False) -> Lag | None:
        """The lag, in frames, of the right image that is paired with a left image by a shift; None
        = no motion.

        `is_of_right`: from the motion in the right images.
        """
        entries, n = self._entries, len(self._entries)
        if not (0 <= place < n and 0 <= place + shift < n):
            return None
        own, partner = (place + shift, place) if is_of_right else (place, place + shift)
        times_s = [entry.frame.time_s for entry in entries]
        others = [own + step for step in _STEPS if 0 <= own + step < n]
        far = [other for other in others if abs(times_s[own] - times_s[other]) >= _MIN_STEP_S]
        other = far[0] if far else max(others, key=lambda other: abs(times_s[own] - times_s[other]))
        between = range(min(own, other) + 1, max(own, other) + 1)
        if entries[partner].repeated[not is_of_right] or any(
            entries[i].repeated[is_of_right] for i in (own, *between)
        ):
            return None
        self._credit -= 1
        before, now = (_image(entries[i].frame, is_right=is_of_right) for i in (other, own))
        lag = measured_lag(before, now, _image(entries[partner].frame, is_right=not is_of_right))
        step = (
            (times_s[own] - times_s[other])
            / median(b - a for a, b in pairwise(times_s))
            * (-1 if is_of_right else 1)
        )
        return lag and lag._replace(value=lag.value * step)

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far, one for all findings of equal kind, side and lag."""
        groups: dict[tuple[object, ...], list[SyncFinding]] = {}
        for finding in self._clear_findings:
            groups.setdefault(
                (finding.kind, finding.side, finding.lag_frames, finding.action), []
            ).append(finding)
        return tuple(map(_sentence, groups.values()))

    @property
    def _clear_findings(self) -> list[SyncFinding]:
        return [
            finding
            for finding in self.findings
            if finding.kind != "apart" or finding.frames >= _N_CONTRADICTING
        ]

    def summary(self) -> dict[str, list[dict[str, Any]]]:
        """The section `synchronisation` of summary.json, if there are findings."""
        findings = [asdict(finding) for finding in self._clear_findings]
        return {"synchronisation": findings} if findings else {}


def _newton_step(late: Lag | None, early: Lag | None) -> int:
    """Change of the shift by the lags measured from the left and from the right video; 0 = no lag is
    known.

    It is taken from the side whose moment is later, since points remain in view backwards in time.
    """
    if late is not None and late.value > 0:
        return round(late.value)
    if early is not None and early.value < 0:
        return round(early.value)
    for lag in (late, early):
        if lag is not None and math.isfinite(lag.sigma):
            return round(lag.value)
    return 0


def _is_same(lag: Lag | None, limit: float = _SAME) -> bool:
    return lag is not None and lag.is_known and abs(lag.value) < limit


def _is_other(lag: Lag | None) -> bool:
    return lag is not None and lag.is_known and abs(lag.value) >= _OTHER


def _is_repeated(
    change: float, usual: float, other: float, other_usual: float, *, is_old: bool
) -> bool:
    """Whether one side repeats its image while the other side moves, or has repeated it and not
    moved since.
    """
    if usual < _NEVER_NEW * other_usual:
        return other_usual > _MIN_CHANGE and change < _NEVER_NEW * other_usual
    other_moves = other > max(_MIN_CHANGE, other_usual / 2) and usual > _MIN_CHANGE
    return change < _REPEATED * usual and (other_moves or is_old)


def _image(frame: Frame, *, is_right: bool) -> ImageView:
    return frame.right if is_right and frame.right is not None else frame.left


def _small(view: ImageView) -> Image:
    """A small copy of the recorded image."""
    return sampled(view.recorded if isinstance(view, RemappedView) else whole_image(view))


def _sentence(group: list[SyncFinding]) -> str:
    first, n_frames = group[0], sum(finding.frames for finding in group)
    when = f"from frame {first.frame} ({first.time_s:.2f} s) on, {counted(n_frames, 'frame')}"
    when += f" in {len(group)} parts of the drive" if len(group) > 1 else ""
    off = "stereo distances of these frames are off"
    if first.kind == "repeated":
        return Note(
            f"The {first.side} video repeats its last image while the other video moves ({when}): "
            f"{off}; check the {first.side} camera and its recording.",
            "images-repeated",
            "error",
            first.side,
        )
    if first.kind == "uniform":
        return Note(
            f"The {first.side} images are black or uniform, while the other images are not "
            f"({when}): {off}; check the lens, the exposure and the cable of the {first.side} "
            "camera.",
            "images-dark",
            "error",
            first.side,
        )
    if first.kind == "apart":
        return Note(
            f"Left and right do not show the same moment ({when}), and no lag of up to {MAX_LAG} "
            f"frames explains it: {off}; check the timestamps, and that the two videos belong "
            "together.",
            "pair-not-simultaneous",
            "error",
            "pair",
        )
    done = (
        off
        if first.action == "stereo off"
        else "left frames are paired with right frames of the same moment"
    )
    return Note(
        f"Left and right are not synchronised: the {first.side} video lags by "
        f"{counted(first.lag_frames, 'frame')} ({when}; found from the vertical motion of the "
        f"images): {done}; check for dropped and repeated frames and correct the timestamps, or "
        "use a hardware trigger.",
        "pair-lags",
        "warning",
        "pair",
    )
