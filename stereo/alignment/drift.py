"""DriftMonitor: measures the offset of a rig again during a drive; DriftingAlignment: the alignment at each time.

    every 30 s or more:  16 frames -> bundle adjustment -> offset, with slope and curvature as at the start
    state (o, r):  o += r dt,  r: random walk          Kalman filter of offset o in px and drift r in px/s

A frame is corrected with the measurements that ended before it, so that results do not depend on the order in which
threads run. A change that is not significant is not applied.
"""

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.alignment import from_drive
from track_range.stereo.alignment.bundle_adjustment import CURVATURE, SLOPE
from track_range.stereo.alignment.feature_tracks import FeatureTracks, TrackedFrame
from track_range.stereo.alignment.health import Window
from track_range.stereo.alignment.model import Alignment, RightView
from track_range.stereo.alignment.segments import Segment, segment_of
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


class DriftingAlignment:
    """The alignment of a run at each time, from the alignment at its start and later measurements
    of the offset.

    It starts with the applied and the measured alignment, and the windows from which they were
    estimated.
    """

    def __init__(self, applied: Alignment, measured: Alignment, windows: Sequence[Window]) -> None:
        # for images with the right one shifted by `Alignment.shift_px`
        self.start = applied.after_shift()
        # measurements, in order of time, the first ones from the start
        self.windows = tuple(windows)
        self._base_px = measured.offset_px
        time_s = (
            float(np.mean([(window.from_s + window.to_s) / 2 for window in windows]))
            if windows
            else 0.0
        )
        covariance = np.diag([measured.offset_sigma_px**2, _DRIFT_SIGMA**2])
        self._times_s = [windows[-1].to_s if windows else 0.0]
        self._states: list[tuple[float, FloatArray, FloatArray]] = [
            (time_s, np.zeros(2), covariance)
        ]

    def add(self, window: Window) -> None:
        """Add a later measurement."""
        self.windows = (*self.windows, window)
        time_s = (window.from_s + window.to_s) / 2
        state, covariance = self._predicted(self._states[-1], time_s)
        gain = covariance[:, 0] / (covariance[0, 0] + window.sigma_px**2)
        state = state + gain * (window.offset_px - self._base_px - state[0])
        covariance = covariance - np.outer(gain, covariance[0])
        self._times_s.append(window.to_s)
        self._states.append((time_s, state, covariance))

    def at(self, time_s: float) -> Alignment:
        """The alignment of a frame, from the measurements that ended before it."""
        number = bisect_left(self._times_s, time_s) - 1
        if number < 1:
            return self.start
        _, last, last_covariance = self._states[number]
        last_sigma_px, first_sigma_px = (
            math.sqrt(c[0, 0]) for c in (last_covariance, self._states[0][2])
        )
        if abs(float(last[0])) <= _MIN_SIGMAS * math.hypot(last_sigma_px, first_sigma_px):
            return self.start
        state, covariance = self._predicted(self._states[number], time_s)
        residual_px = math.hypot(self.start.residual_px, math.sqrt(covariance[0, 0]))
        return replace(
            self.start, offset_px=self.start.offset_px + float(state[0]), residual_px=residual_px
        )

    def _predicted(
        self, last: tuple[float, FloatArray, FloatArray], time_s: float
    ) -> tuple[FloatArray, FloatArray]:
        last_s, state, covariance = last
        dt = min(max(time_s - last_s, 0.0), _MAX_AHEAD_S)
        step = np.array([[1.0, dt], [0.0, 1.0]])
        noise = _DRIFT_NOISE**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        return step @ state, step @ covariance @ step.T + noise


class DriftMonitor:
    """Measures the offset of a rectified pair again from time to time, and adds it to `drifting`.

    `measured` was estimated from the first frames; the right images are shifted by `shift_px`
    (`Alignment.shift_px`).
    """

    def __init__(
        self,
        rig: StereoRig,
        drifting: DriftingAlignment,
        measured: Alignment,
        *,
        shift_px: float = 0.0,
    ) -> None:
        self._rig, self._drifting, self._measured, self._shift_px = (
            rig,
            drifting,
            measured,
            shift_px,
        )
        self._last_s = drifting.windows[-1].to_s if drifting.windows else 0.0
        self._n_frames, self._added_s = 0, -math.inf
        self._tracks: FeatureTracks | None = None
        self._points: list[TrackedFrame] = []

    @property
    def notes(self) -> tuple[str, ...]:
        """Always empty; the windows are part of the health of the rig."""
        return ()

    def add(self, frame: Frame) -> None:
        """Use the next frame, if a measurement is due."""
        self._n_frames += 1
        is_due = (
            frame.time_s - self._last_s >= MIN_INTERVAL_S and self._n_frames >= MIN_INTERVAL_FRAMES
        )
        if (
            frame.right is None
            or not is_due
            or frame.time_s - self._added_s < from_drive.MIN_STEP_S
        ):
            return
        if self._tracks is None or frame.time_s - self._added_s > from_drive.MAX_GAP_S:
            self._tracks, self._points = FeatureTracks(), []
        self._added_s = frame.time_s
        self.add_points(self._tracks.add(frame.left, whole_image(frame.right), frame.time_s))

    def add_points(self, frame: TrackedFrame) -> None:
        """Use the points of the next frame of a measurement, which ends with its last frame, or
        when the car stops.
        """
        if self._points and (
            frame.fraction_tracked < from_drive.MIN_TRACKED_FRACTION
            or frame.flow_px < from_drive.MIN_FLOW_PX
        ):
            self._end(frame.time_s)
            return
        self._points.append(frame)
        if len(self._points) == from_drive.N_FRAMES:
            self._measure()
            self._end(frame.time_s)

    def _end(self, time_s: float) -> None:
        """Wait for the next measurement, a shorter time if this measurement failed."""
        has_all = len(self._points) == from_drive.N_FRAMES
        self._last_s = time_s if has_all else time_s - 0.8 * MIN_INTERVAL_S
        self._n_frames = 0 if has_all else round(0.8 * MIN_INTERVAL_FRAMES)
        self._tracks, self._points = None, []

    def _measure(self) -> None:
        segment = segment_of(
            from_drive.observations_of(self._points, RightView(), self._rig), self._rig
        )
        if isinstance(segment, Segment):
            known_px = np.zeros(3)
            known_px[[CURVATURE, SLOPE]] = self._measured.curvature_px, self._measured.slope_px
            offset_px, sigma_px = from_drive.offset_of(segment, known_px)
            if sigma_px <= _MAX_SIGMA_PX:  # False for NaN
                from_s, to_s = self._points[0].time_s, self._points[-1].time_s
                self._drifting.add(Window(0, from_s, to_s, offset_px + self._shift_px, sigma_px))
