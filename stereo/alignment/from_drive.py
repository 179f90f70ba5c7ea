"""DriveAlignment: the disparity error of a rig from a drive through an unknown scene.

Frames about 0.1 s apart are divided into segments of 1.6 s, each with a separate bundle adjustment
(`stereo.alignment.bundle_adjustment`); their estimates of offset and curvature are combined.
Results: on KITTI's drives 0003 and 0005, 16 frames each, 0.47 and 0.44 px (curvature 1.60 and
1.47), where lidar and labels give 0.4 to 0.5 px; three segments of another drive agree within 0.03
px.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.alignment.bundle_adjustment import (
    CURVATURE,
    N_ERRORS,
    OFFSET,
    SLOPE,
    Observations,
)
from track_range.stereo.alignment.feature_tracks import (
    MIN_ROWS,
    FeatureTracks,
    PairPoints,
    TrackedFrame,
)
from track_range.stereo.alignment.health import Window, move_of
from track_range.stereo.alignment.right_view import RightView, fit_right_view, view_sigma
from track_range.stereo.alignment.segments import (
    INCONSISTENT,
    MAX_ERROR_PX,
    CombinedEstimate,
    Segment,
    combine,
    segment_of,
)
from track_range.stereo.geometry.alignment import (
    MAX_ROW_OFFSET_PX,
    UNCORRECTED_SIGMA_PX,
    Alignment,
)
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rig import StereoRig

# frames of a segment; longer segments would have more parallax, but few points are tracked that
# long
N_FRAMES = 16
MIN_FRAMES = 10  # minimum number of frames of a segment
_MAX_SEGMENTS = 3  # largest number of segments of a drive
_MAX_FRAMES = 300  # largest number of frames of a drive, in case the vehicle does not move
MIN_STEP_S = 0.09  # shortest time between two used frames, seconds
MAX_GAP_S = 0.5  # longest time between two frames of a segment, seconds
# minimum median flow between frames of a moving vehicle; other frames are not used
MIN_FLOW_PX = 0.5
# of the points between two frames of a segment; fewer indicate a cut in the video
MIN_TRACKED_FRACTION = 0.1
# minimum ratio of curvature or slope to their standard deviations at which they are estimated
_MIN_TERM_SIGMAS = 3.0
_MAX_SIGMA_PX = 0.25  # largest standard deviation of a usable offset
# remaining error at an object / spread of the strips: from 36 cars of 16 KITTI 2015 pairs
_SPREADS = 2.0
# Common error of subpixel point positions, which the jackknife does not include: on simulated
# drives the error of the offset is 0.013 px in the median and 0.05 px at most, while estimates from
# strips and times agree within 0.011 px.
PIXEL_LOCKING_PX = 0.02
# Disparity error per row offset that is corrected as a pitch but may be a shift of the image: the
# mean of |x y| / f^2 over the points of an image of 80 by 30 degrees.
_ROWS_FRACTION = 0.05
_MIN_RESIDUAL_PX = 0.05  # lower limit of the remaining error, px
NOT_MEASURED = Alignment()


class DriveAlignment:
    """Estimates the alignment of a rig from the frames of one or several drives, which `prior` has
    corrected; None = they are as the rig has them.

    `name` is what the source of the alignment calls the drives.
    """

    def __init__(
        self, rig: StereoRig, prior: Alignment | None = None, name: str = "this drive"
    ) -> None:
        self._rig, self._prior = rig, prior or rig.unaligned  # of the rectified frames
        self._name = name
        self._segments: list[tuple[int, tuple[float, float], Segment]] = []
        self._reasons: list[str] = []
        self._matched: list[PairPoints] = []
        self._view = RightView()
        self._points: list[TrackedFrame] = []
        self._last_s: float
        self._drive = 0
        self._begin_drive()

    @property
    def is_full(self) -> bool:
        """Whether the drive has enough frames; further frames are then ignored."""
        return self._n_segments_left <= 0 or self._n_frames_left <= 0

    @property
    def has_segments(self) -> bool:
        """Whether there are frames for an estimate."""
        return bool(self._segments)

    @property
    def n_moving(self) -> int:
        """Number of frames in motion so far."""
        return len(self._points) + sum(segment.n_frames for *_, segment in self._segments)

    def copy(self) -> DriveAlignment:
        """A copy for an intermediate estimate: `estimate` ends the segment that is in progress."""
        copied = copy(self)
        copied._segments, copied._reasons = list(self._segments), list(self._reasons)
        copied._points, copied._matched = list(self._points), list(self._matched)
        return copied

    def start_drive(self) -> None:
        """Start another drive with the same rig at the next frame."""
        self._close()
        self._drive += 1
        self._begin_drive()

    def add(self, frame: Frame) -> None:
        """Add the next frame; frames without a right image, or too soon after the last frame, are
        ignored.
        """
        step_s = frame.time_s - self._last_s
        if self.is_full or frame.right is None or step_s < MIN_STEP_S:
            return
        if step_s > MAX_GAP_S:
            self._close()
            self._tracks = FeatureTracks()
        self.add_points(self._tracks.add(frame.left, whole_image(frame.right), frame.time_s))

    def add_points(self, frame: TrackedFrame) -> None:
        """Add the points of the next frame, as `add` adds images."""
        self._last_s = frame.time_s
        self._n_frames_left -= 1
        self._matched.append(frame.points)
        if frame.fraction_tracked < MIN_TRACKED_FRACTION:
            self._close()
        has_points = len(frame.points.number) >= MIN_ROWS
        if self._points and has_points and frame.flow_px < MIN_FLOW_PX:
            self._n_static += 1
            return
        self._points.append(frame)
        if len(self._points) == N_FRAMES:
            self._close()

    def estimate(self) -> Alignment:
        """The alignment estimated from the drives so far; the caller decides whether it is applied.

        Without enough data for the disparities, the offset is 0 with the default standard
        deviation, and the source contains the reason; the row offset is estimated in any case.
        """
        self._close()
        view, prior = self._measured_view(), self._prior
        rows = replace(
            prior,
            row_offset_px=prior.row_offset_px + view.row_offset_px,
            roll_deg=prior.roll_deg + view.roll_deg,
            focal_ratio=prior.focal_ratio * view.focal_ratio,
        )
        if not self._segments:
            reason = (
                max(self._reasons, key=self._reasons.count) if self._reasons else "no stereo frames"
            )
            # a contradiction is no lack of data: the disparities may be wrong by as much as was
            # searched
            sigma_px = MAX_ERROR_PX if INCONSISTENT in self._reasons else rows.residual_px
            offset_sigma_px, source = (
                max(sigma_px, rows.offset_sigma_px),
                f"not enough data in this drive ({reason})",
            )
            return replace(
                rows, residual_px=sigma_px, offset_sigma_px=offset_sigma_px, source=source
            )
        segments = self._before_move
        combined = estimated_errors(segments)
        offset_px, curvature_px, slope_px = combined.error_px.tolist()
        offset_px += prior.shift_px
        offset_sigma_px, curvature_sigma_px, slope_sigma_px = combined.sigma_px.tolist()
        if not offset_sigma_px <= _MAX_SIGMA_PX:
            reason = (
                f"offset {offset_px:+.2f} px with a standard deviation of {offset_sigma_px:.2f} px"
            )
            return replace(rows, source=f"not enough data in this drive ({reason})")
        spread_px = (
            combined.spread_px
            if np.isfinite(combined.spread_px)
            else UNCORRECTED_SIGMA_PX / _SPREADS
        )
        rows_px = _ROWS_FRACTION * abs(rows.row_offset_px)
        n_frames = sum(segment.n_frames for segment in segments)
        return replace(
            rows,
            offset_px=offset_px,
            curvature_px=curvature_px,
            slope_px=slope_px,
            residual_px=max(
                _MIN_RESIDUAL_PX, math.hypot(offset_sigma_px, _SPREADS * spread_px, rows_px)
            ),
            offset_sigma_px=offset_sigma_px,
            curvature_sigma_px=curvature_sigma_px,
            slope_sigma_px=slope_sigma_px,
            source=f"{self._name}, {n_frames} frames",
        )

    def windows(self) -> tuple[Window, ...]:
        """The offset in each segment so far, with the slope and the curvature of all segments."""
        self._close()
        if not self._segments:
            return ()
        known_px = estimated_errors([segment for *_, segment in self._segments]).error_px
        windows = (
            Window(drive, *span_s, *offset_of(segment, known_px))
            for drive, span_s, segment in self._segments
        )
        return tuple(
            window._replace(offset_px=window.offset_px + self._prior.shift_px) for window in windows
        )

    @property
    def _before_move(self) -> list[Segment]:
        """The segments before the camera moved in the one drive, whose later frames a run corrects
        by the change since then; all if it did not move.
        """
        windows = self.windows()
        move = move_of(windows, self._rig)
        is_one_drive = len({window.drive for window in windows}) == 1
        until_s = move.time_s if move is not None and is_one_drive else math.inf
        return [segment for _, (_, to_s), segment in self._segments if to_s < until_s]

    def _begin_drive(self) -> None:
        self._n_segments_left, self._n_frames_left, self._n_static = _MAX_SEGMENTS, _MAX_FRAMES, 0
        self._last_s, self._tracks = -math.inf, FeatureTracks()
        # of the first segment, and number of matched frames up to the end of the last segment
        self._first_view: RightView | None = None
        self._n_steady = len(self._matched)

    def _close(self) -> None:
        """Make a segment of the frames since the last segment."""
        points, self._points = self._points, []
        n_static, self._n_static = self._n_static, 0
        if len(points) < MIN_FRAMES:
            if points:
                is_static = n_static > len(points)
                reason = (
                    "the vehicle is stationary"
                    if is_static
                    else f"fewer than {MIN_FRAMES} frames in motion"
                )
                self._reasons.append(reason)
            return
        view = self._view_of([frame.points for frame in points])
        first = self._first_view = self._first_view or view
        if self._has_moved(first, view):
            # the rest of the drive has another right camera
            del self._matched[self._n_steady :]
            self._reasons.append("the right camera moved")
            self._n_segments_left = 0
            return
        self._n_steady = len(self._matched)
        if not self._segments:
            self._view = self._measured_view().if_needed(self._rig.left)
        segment = segment_of(observations_of(points, self._view, self._rig), self._rig)
        if isinstance(segment, str):
            self._reasons.append(segment)
            return
        self._n_segments_left -= 1
        self._segments.append((self._drive, (points[0].time_s, points[-1].time_s), segment))

    @property
    def view_sigma(self) -> FloatArray:
        """(3,) standard deviations of row offset in px, roll in degrees and focal ratio."""
        half_px = self._rig.left.width_px / 2
        locking = PIXEL_LOCKING_PX * np.array([1.0, math.degrees(1 / half_px), 1 / half_px])
        return np.hypot(view_sigma(*_joined(self._matched), self._rig.left), locking)

    def _has_moved(self, first: RightView, view: RightView) -> bool:
        """Whether the rows of a segment are not those of the first one of the drive."""
        change = RightView(
            view.row_offset_px - first.row_offset_px,
            view.roll_deg - first.roll_deg,
            view.focal_ratio / first.focal_ratio,
        )
        return change.rows_px(self._rig.left) > MAX_ROW_OFFSET_PX

    def _measured_view(self) -> RightView:
        return self._view_of(self._matched)

    def _view_of(self, frames: Sequence[PairPoints]) -> RightView:
        left_px, right_px = _joined(frames)
        if len(left_px) < MIN_ROWS:
            return RightView()
        return fit_right_view(left_px, right_px, self._rig.left)


def _joined(frames: Sequence[PairPoints]) -> tuple[FloatArray, FloatArray]:
    """Points (N, 2) of the left and the right images of all frames."""
    nothing = np.zeros((0, 2))
    left_px = np.concatenate([nothing, *(points.left_px for points in frames)])
    right_px = np.concatenate([nothing, *(points.right_px for points in frames)])
    return left_px, right_px


def estimated_errors(segments: list[Segment]) -> CombinedEstimate:
    """The combined estimate, without a curvature or slope that is not significant."""
    chosen = set(range(N_ERRORS))
    combined = combine(segments, chosen)
    for error in (CURVATURE, SLOPE):
        if abs(combined.error_px[error]) <= _MIN_TERM_SIGMAS * combined.sigma_px[error]:
            chosen.discard(error)
            combined = combine(segments, chosen)
    covariance_px2 = combined.covariance_px2.copy()
    covariance_px2[0, 0] += PIXEL_LOCKING_PX**2
    return combined._replace(covariance_px2=covariance_px2)


def offset_of(segment: Segment, known_px: FloatArray) -> tuple[float, float]:
    """Offset in one segment and its standard deviation, with known curvature and slope in the
    errors (3,).
    """
    own = combine([segment], (OFFSET,), known_px)
    return float(own.error_px[OFFSET]), math.hypot(float(own.sigma_px[OFFSET]), PIXEL_LOCKING_PX)


def observations_of(
    frames: Sequence[TrackedFrame], view: RightView, rig: StereoRig
) -> Observations:
    """The observations of the points of consecutive frames, with the right points corrected by
    `view`.
    """
    frame = np.concatenate(
        [np.full(len(tracked.points.number), index) for index, tracked in enumerate(frames)]
    )
    number, left_px, right_px = (
        np.concatenate(part) for part in zip(*(f.points for f in frames), strict=True)
    )
    corrected_px = view.corrected(right_px, rig.left)
    return Observations(frame, number, np.column_stack([left_px, corrected_px[:, 0]]))
