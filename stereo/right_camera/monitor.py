r"""RightCameraMonitor: how the right camera of a pair moves against its rig during a drive.

    rows of corresponding points   y_right - y_left = pitch (1 + Y^2) - roll u + zoom v
    disparities of static points   by the camera's motion - measured = offset (1 + X^2) + bow u^2
    flow of static points          the offset of all disparities that fits it

with X, Y: right point / f, and u, v: the same in half image widths. A wrong zero of the disparities
makes static points at all distances flow as if they were nearer: each step of the camera measures
it. Only changes since the start of the drive count, so that errors that all frames have in common,
such as residual distortion, do not.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import Note
from track_range.stereo.alignment.health import MATTERS, REFERENCE_M, Move, matters_px
from track_range.stereo.alignment.right_view import fit_rows
from track_range.stereo.geometry.alignment import Alignment, column_from_axis
from track_range.stereo.geometry.cauchy_fit import cauchy_fit
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.right_camera.change_filter import ChangeFilter, Changes
from track_range.stereo.right_camera.correction import OFFSET, RightCamera, changes_of

_MIN_POINTS = 20  # smallest number of points of a measurement
_NEAR_PX = 0.2  # smallest scatter of points, full pixels
_AGREEING_PX = 1.2  # largest residual of a point that agrees
# standard deviations of errors that last for about a second, in px: pitch, roll, zoom, offset
_LASTING_PX = np.array([0.03, 0.05, 0.15, 0.12])
_FACTOR = 1.4  # of the sigmas of rows and of the offset by the flow
# error of a step of the disparities that its points have in common, px
_STEP_SIGMA_PX = 0.06
_NEW_SIGMAS = 5.0  # of a change of the rows that the steps of the disparities take into account
_MAX_FLOW_SIGMA_PX = 1.5  # of an offset by the flow that is used
_MATTERING_ROWS_PX = 0.5  # change of rows that is noted
# number and fraction of frames with a hit, of images that shake
_MIN_HITS, _SHAKING_FRACTION = 5, 0.1
_MIN_AGREEING = 0.5  # of the points, for a step


class RightCameraMonitor:
    """Measures the changes in the frames of one stream of a rectified pair."""

    def __init__(self, rig: StereoRig) -> None:
        camera = rig.left
        self._matters_px = matters_px(rig)
        self._camera, self._filter = camera, ChangeFilter(_LASTING_PX)
        # time of the first change that matters, the last state with one, and numbers of frames
        self._moved_s, self._moved = math.nan, RightCamera(camera)
        self._n_frames = self._n_hits = 0
        # of movements before the present alignment
        self._earlier_notes: tuple[str, ...] = ()
        self._earlier_move: Move | None = None
        self.now = RightCamera(camera)
        self._followed: Alignment | None = None  # of the last frame
        # change of the offset in the frame before the last one that its correction did not contain
        self.missed_offset_px = 0.0
        self._bow_px = self._bow_variance = 0.0

    @property
    def expected_offset_px(self) -> float:
        """The change of all disparities that the flow to the next frame is expected to show."""
        return float(self._filter.expected[OFFSET] - self.now.applied_px[OFFSET])

    @property
    def move(self) -> Move | None:
        """The change of the disparities by the first movement that mattered; None = none."""
        offset_px = float(self._moved.applied_px[OFFSET])
        if self._earlier_move is not None or not offset_px:
            return self._earlier_move
        return Move(self._moved_s, offset_px, float(self._moved.change.sigma[OFFSET]))

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        return (*self._earlier_notes, *self._present_notes)

    @property
    def _present_notes(self) -> tuple[str, ...]:
        if not math.isfinite(self._moved_s):
            return ()
        if self._n_hits >= max(_MIN_HITS, _SHAKING_FRACTION * self._n_frames):
            return (
                Note(
                    f"Left and right images shake against each other from {self._moved_s:.1f} s on, in "
                    f"{100 * self._n_hits / self._n_frames:.0f} % of the frames: this is corrected, "
                    "but distances are less accurate; mount the cameras more firmly.",
                    "right-camera-shakes",
                    "warning",
                    "right",
                ),
            )
        pitch_px, roll_px, zoom_px, offset_px, _ = self._moved.applied_px.tolist()
        pct = 100 * MATTERS * abs(offset_px) / self._matters_px
        half_px = self._camera.width_px / 2
        parts = {
            f"disparities changed by {-offset_px:+.2f} px ({pct:.0f} % at {REFERENCE_M:.0f} m)": (
                offset_px
            ),
            f"rows by {pitch_px:+.1f} px": pitch_px,
            f"its roll by {math.degrees(roll_px / half_px):+.2f} degrees": roll_px,
            f"its focal length by {100 * zoom_px / half_px:+.1f} %": zoom_px,
        }
        changed = ", ".join(text for text, size_px in parts.items() if size_px)
        return (
            Note(
                f"Rig: the right camera moved at about {self._moved_s:.1f} s, or was refocused: "
                f"{changed}; this is corrected from then on. Mount the cameras more firmly.",
                "right-camera-moved",
                "warning",
                "right",
            ),
        )

    def _remember(self, time_s: float) -> None:
        """Keep the changes that matter, for the notes."""
        self._n_frames += 1
        self._n_hits += self.now.is_hit
        applied_px = np.abs(self.now.applied_px)
        have_rows_moved = (applied_px[:OFFSET] > _MATTERING_ROWS_PX).any()
        if applied_px[OFFSET] > self._matters_px or have_rows_moved:
            self._moved_s = time_s if math.isnan(self._moved_s) else self._moved_s
            self._moved = self.now

    def update(
        self,
        time_s: float,
        dt_s: float,
        left_px: FloatArray,
        right_px: FloatArray,
        expected_px: FloatArray,
        flow_offset_px: tuple[float, float],
    ) -> RightCamera:
        """Use the matched static points (N, 2) of a frame, whose right image `now` has corrected.

        `expected_px` (N,) are their disparities by the motion of the camera, NaN = unknown;
        `flow_offset_px` is the change of all disparities that fits the flow, with its sigma, NaN =
        unknown.
        """
        applied_px = self.now.applied_px
        value, sigma, step, step_sigma = np.full((4, 4), np.nan)
        # the flow to this frame shows the offset of the disparities before it
        if flow_offset_px[1] < _MAX_FLOW_SIGMA_PX:
            value[OFFSET] = flow_offset_px[0] + applied_px[OFFSET]
            sigma[OFFSET] = _FACTOR * flow_offset_px[1]
            self._filter.measure(value, sigma)
        self.missed_offset_px = float(self._filter.changes.mean[OFFSET] - applied_px[OFFSET])
        bow_px = bow_sigma_px = 0.0
        value, sigma = np.full((2, 4), np.nan)
        rows = self._rows(left_px, right_px)
        if rows is not None:
            value[:3] = rows[0] + (applied_px[:3] if self.now.is_warped else 0.0)
            sigma[:3] = rows[1]
            news_px = value - self._filter.expected
            is_new = np.abs(news_px) > _NEW_SIGMAS * sigma  # False for NaN
            points_px = right_px
            if is_new.any():
                rows_only = replace(
                    self.now, change=changes_of(np.append(np.where(is_new, news_px, 0.0), 0.0))
                )
                unchanged = replace(self.now, change=changes_of(np.zeros(5)))
                points_px = rows_only.moved_from(unchanged, right_px)
            steps = self._steps(left_px, points_px, expected_px)
            if steps is not None:
                (step[OFFSET], bow_px), (step_sigma[OFFSET], bow_sigma_px) = steps
        self._filter.advance(dt_s, step, step_sigma)
        self._filter.measure(value, sigma)
        # only a hit moves the bow
        hit = float(self._filter.changes.hit[OFFSET])
        self._bow_px += hit * bow_px
        self._bow_variance += hit * bow_sigma_px**2
        self.now = replace(self.now, change=self._change)
        self._remember(time_s)
        return self.now

    def follow(self, alignment: Alignment) -> None:
        """Take the alignment of the next frame into account: another one includes the changes."""
        before, self._followed = self._followed, alignment
        is_aligned_again = self.now.has_base  # after this alignment
        if alignment == before or is_aligned_again:
            return
        if before is None or not self._n_frames:  # nothing was measured
            self.now = replace(self.now, own=alignment)
            return
        if self.now.applied_px.any():
            change_px = alignment.offset_px - self.now.own.offset_px
            self._filter.rebase(np.array([0.0, 0.0, 0.0, change_px]))
        else:
            self._filter = ChangeFilter(_LASTING_PX)
        self.now = RightCamera(self._camera, alignment, self._change)

    def restart(self, time_s: float, base: FloatArray, alignment: Alignment) -> None:
        """Count changes from now on, with another alignment of the images that `base` corrects."""
        again = f"From {time_s:.1f} s on, the pair has another alignment, from the frames after it."
        present = (f"{note} {again}" for note in self._present_notes)
        self._earlier_notes = (*self._earlier_notes, *present)
        self._earlier_move = self.move
        self._moved_s = math.nan
        self._filter = ChangeFilter(_LASTING_PX)
        self._bow_px = self._bow_variance = 0.0
        self.now = RightCamera(self._camera, alignment, self._change, base)

    @property
    def _change(self) -> Changes:
        mean, sigma, hit = self._filter.changes
        return Changes(
            np.append(mean, self._bow_px), np.append(sigma, math.sqrt(self._bow_variance)), hit
        )

    def _rows(
        self, left_px: FloatArray, right_px: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """(3,) pitch, roll and zoom of the right image with their sigmas; None = too few points."""
        if len(left_px) < _MIN_POINTS:
            return None
        # the yaw is one of the disparities, too, which measure it better
        solution, covariance, _ = fit_rows(left_px, right_px, self._camera, least_scale_px=_NEAR_PX)
        return solution[:3], _FACTOR * np.sqrt(np.diag(covariance))[:3]

    def _steps(
        self, left_px: FloatArray, right_px: FloatArray, expected_px: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """(2,) steps of offset and bow since the last frame with their sigmas; None = unknown."""
        is_known = np.isfinite(expected_px)
        if is_known.sum() < _MIN_POINTS:
            return None
        u = column_from_axis(right_px[is_known, 0], self._camera)
        missing_px = expected_px[is_known] - (left_px - right_px)[is_known, 0]
        X = u * (self._camera.width_px / 2 / self._camera.fx_px)
        design = np.array([1 + X**2, u**2]).T
        solution, covariance, residual = cauchy_fit(design, missing_px, least_scale=_NEAR_PX)
        if (np.abs(residual) < _AGREEING_PX).mean() < _MIN_AGREEING:
            return None
        return solution, np.sqrt(np.diag(covariance) + _STEP_SIGMA_PX**2)
