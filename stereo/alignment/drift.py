"""DriftMonitor: measures the offset of a rig again during a drive; DriftingAlignment: the alignment at each time.

    every 30 s or more:  16 frames -> bundle adjustment -> offset, with slope and curvature as at the start
    state (o, r):  o += r dt,  r: random walk          Kalman filter of offset o in px and drift r in px/s

A frame is corrected with the measurements that ended before it. A change that is not significant is
not applied.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.alignment import from_drive
from track_range.stereo.alignment.bundle_adjustment import CURVATURE, SLOPE
from track_range.stereo.alignment.feature_tracks import FeatureTracks, TrackedFrame
from track_range.stereo.alignment.health import Window
from track_range.stereo.alignment.right_view import RightView
from track_range.stereo.alignment.segments import Segment, segment_of
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rig import StereoRig

# Shortest time and smallest number of frames between two measurements: one takes as long as about
# 20 frames of a run, and must not slow it by more than 5 %.
MIN_INTERVAL_S, MIN_INTERVAL_FRAMES = 30.0, 600
# minimum ratio of a change of the offset to its standard deviation at which it is applied
_MIN_SIGMAS = 2.0
_MAX_SIGMA_PX = 0.15  # largest standard deviation of a usable window
# of the drift before any measurement, px/s: 0.02 degrees per minute at a focal length of 700 px
_DRIFT_SIGMA = 0.004
_DRIFT_NOISE = 1e-4  # random walk of the drift, px/s per root of a second
_MAX_AHEAD_S = 90.0  # longest time for which the drift is extrapolated beyond a measurement


@dataclass(frozen=True, slots=True)
class _DriftState:
    """The offset relative to the start and its drift, after one measurement."""

    until_s: float  # end of the measurement, which applies to later frames
    time_s: float  # middle of the measurement, the time of the state
    mean: FloatArray  # (2,) change of the offset in px, drift in px/s
    covariance: FloatArray  # (2, 2)

    @property
    def offset_sigma_px(self) -> float:
        """Standard deviation of the change of the offset."""
        return math.sqrt(self.covariance[0, 0])

    def predicted(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance at a time, at most `_MAX_AHEAD_S` after the measurement."""
        dt = min(max(time_s - self.time_s, 0.0), _MAX_AHEAD_S)
        F = np.array([[1.0, dt], [0.0, 1.0]])
        Q = _DRIFT_NOISE**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        return F @ self.mean, F @ self.covariance @ F.T + Q

    def corrected(self, window: Window, change_px: float) -> _DriftState:
        """The state after another measurement, of a change of the offset since the start."""
        time_s = (window.from_s + window.to_s) / 2
        mean, P = self.predicted(time_s)
        gain = P[:, 0] / (P[0, 0] + window.sigma_px**2)
        return _DriftState(
            window.to_s, time_s, mean + gain * (change_px - mean[0]), P - np.outer(gain, P[0])
        )


@dataclass(frozen=True, slots=True)
class DriftingAlignment:
    """The alignment of a drive at each time, from the alignment at its start and later measurements
    of the offset.
    """

    start: Alignment  # for images with the right one shifted by `Alignment.shift_px`
    windows: tuple[Window, ...]  # measurements, in order of time, the first ones from the start
    _base_px: float = field(repr=False)  # the offset measured at the start
    _states: tuple[_DriftState, ...] = field(repr=False, compare=False)

    @classmethod
    def of(
        cls, applied: Alignment, measured: Alignment, windows: Sequence[Window]
    ) -> DriftingAlignment:
        """The applied and the measured alignment at the start, and the windows from which they were
        estimated.
        """
        middles_s = [(window.from_s + window.to_s) / 2 for window in windows]
        first = _DriftState(
            until_s=windows[-1].to_s if windows else 0.0,
            time_s=float(np.mean(middles_s)) if windows else 0.0,
            mean=np.zeros(2),
            covariance=np.diag([measured.offset_sigma_px**2, _DRIFT_SIGMA**2]),
        )
        return cls(applied.after_shift(), tuple(windows), measured.offset_px, (first,))

    def after(self, window: Window) -> DriftingAlignment:
        """The alignment with a later measurement, which does not change that of earlier frames."""
        state = self._states[-1].corrected(window, window.offset_px - self._base_px)
        return replace(self, windows=(*self.windows, window), _states=(*self._states, state))

    def at(self, time_s: float) -> Alignment:
        """The alignment of a frame, from the measurements that ended before it."""
        number = bisect_left(self._states, time_s, key=lambda state: state.until_s) - 1
        if number < 1:
            return self.start
        last = self._states[number]
        sigma_px = math.hypot(last.offset_sigma_px, self._states[0].offset_sigma_px)
        if abs(float(last.mean[0])) <= _MIN_SIGMAS * sigma_px:
            return self.start
        mean, covariance = last.predicted(time_s)
        residual_px = math.hypot(self.start.residual_px, math.sqrt(covariance[0, 0]))
        return replace(
            self.start, offset_px=self.start.offset_px + float(mean[0]), residual_px=residual_px
        )


class DriftMonitor:
    """Measures the offset of a rectified pair again from time to time.

    `measured` was estimated from the first frames, in the windows up to `last_s`; the right images
    are shifted by `shift_px` (`Alignment.shift_px`).
    """

    def __init__(
        self, rig: StereoRig, measured: Alignment, *, last_s: float, shift_px: float = 0.0
    ) -> None:
        self._rig, self._measured, self._shift_px = rig, measured, shift_px
        self._last_s = last_s
        self._n_frames, self._added_s = 0, -math.inf
        self._tracks: FeatureTracks | None = None
        self._points: list[TrackedFrame] = []

    def add(self, frame: Frame) -> Window | None:
        """Use the next frame, if a measurement is due; returns the measurement that ends with it."""
        self._n_frames += 1
        is_due = (
            frame.time_s - self._last_s >= MIN_INTERVAL_S and self._n_frames >= MIN_INTERVAL_FRAMES
        )
        if (
            frame.right is None
            or not is_due
            or frame.time_s - self._added_s < from_drive.MIN_STEP_S
        ):
            return None
        if self._tracks is None or frame.time_s - self._added_s > from_drive.MAX_GAP_S:
            self._tracks, self._points = FeatureTracks(), []
        self._added_s = frame.time_s
        return self.add_points(self._tracks.add(frame.left, whole_image(frame.right), frame.time_s))

    def add_points(self, frame: TrackedFrame) -> Window | None:
        """Use the points of the next frame of a measurement, which ends with its last frame, or
        when the car stops.
        """
        if self._points and (
            frame.fraction_tracked < from_drive.MIN_TRACKED_FRACTION
            or frame.flow_px < from_drive.MIN_FLOW_PX
        ):
            self._end(frame.time_s)
            return None
        self._points.append(frame)
        if len(self._points) < from_drive.N_FRAMES:
            return None
        window = self._measured_window()
        self._end(frame.time_s)
        return window

    def _end(self, time_s: float) -> None:
        """Wait for the next measurement, a shorter time if this measurement failed."""
        has_all = len(self._points) == from_drive.N_FRAMES
        self._last_s = time_s if has_all else time_s - 0.8 * MIN_INTERVAL_S
        self._n_frames = 0 if has_all else round(0.8 * MIN_INTERVAL_FRAMES)
        self._tracks, self._points = None, []

    def _measured_window(self) -> Window | None:
        """The offset in the frames of this measurement; None = not accurate enough."""
        observed = from_drive.observations_of(self._points, RightView(), self._rig)
        segment = segment_of(observed, self._rig)
        if not isinstance(segment, Segment):
            return None
        known_px = np.zeros(3)
        known_px[[CURVATURE, SLOPE]] = self._measured.curvature_px, self._measured.slope_px
        offset_px, sigma_px = from_drive.offset_of(segment, known_px)
        if not sigma_px <= _MAX_SIGMA_PX:  # also for NaN
            return None
        from_s, to_s = self._points[0].time_s, self._points[-1].time_s
        return Window(0, from_s, to_s, offset_px + self._shift_px, sigma_px)
