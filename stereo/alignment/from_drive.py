"""DriveAlignment: the disparity error of a rig from a drive with it, without anything known about the scene.

Frames about 0.1 s apart are cut into segments of 1.6 s; each is a bundle of its own
(`stereo.alignment.bundle_adjustment`), and their estimates of offset and curvature are combined. Measured: on KITTI's
drives 0003 and 0005, 16 frames each, 0.47 and 0.44 px (curvature 1.60 and 1.47), where lidar and labels give 0.4 to
0.5 px; three segments of one other drive within 0.03 px.
"""

from __future__ import annotations

import math

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.alignment.bundle_adjustment import Observations
from track_range.stereo.alignment.feature_tracks import MIN_ROWS, FeatureTracks, PairPoints, grey
from track_range.stereo.alignment.model import UNCORRECTED_SIGMA_PX, Alignment
from track_range.stereo.alignment.segments import CombinedEstimate, Segment, combine, segment_of
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rig import StereoRig

N_FRAMES = 16
"""Frames of a stretch; some more give points more time to show parallax, but few points live as long."""

MIN_FRAMES = 10
"""A shorter rest says too little."""

_MAX_SEGMENTS = 3
_MAX_FRAMES = 300
"""Frames that are looked at before it gives up on a vehicle that does not move."""

MIN_STEP_S = 0.09
"""Frames nearer than this to the last one are passed by."""

_MAX_GAP_S = 0.5
_MIN_FLOW_PX = 0.5
"""Points that move less from frame to frame say that the vehicle stands still: such frames add nothing."""

_MIN_KEPT = 0.1
"""With fewer points that can be followed, the frames are not of one drive."""

_MIN_BOW_SIGMAS = 3.0
"""A bow nearer to zero is left out: one more number must earn its place."""

_MAX_SIGMA_PX = 0.25
"""A less certain estimate is none."""

_SPREADS = 2.0
"""What is left of the error at an object, as a multiple of the strips' spread: from 36 cars of 16 KITTI 2015 pairs."""

_LOCKING_PX = 0.02
"""What points followed to fractions of a pixel may be off together, which no jackknife sees: on simulated drives the
offset errs by 0.013 px in the median and by 0.05 at worst, where strips and times agree within 0.011."""

_LEAST_RESIDUAL_PX = 0.05


class DriveAlignment:
    """Takes in the frames of a drive, or of several drives with one rig, and estimates the alignment."""

    def __init__(self, rig: StereoRig) -> None:
        """For frames rectified to `rig`."""
        self._rig = rig
        self._segments: list[Segment] = []
        self._reasons: list[str] = []
        self._rows_px: list[FloatArray] = []
        self._seen: list[PairPoints] = []
        self._last_s: float
        self._begin_drive()

    @property
    def is_full(self) -> bool:
        """Whether enough of this drive has been seen; more frames of it are not looked at."""
        return self._n_segments_left <= 0 or self._n_frames_left <= 0

    def start_drive(self) -> None:
        """Say that the next frame is of another drive with the same rig."""
        self._close()
        self._begin_drive()

    def add(self, frame: Frame) -> None:
        """Look at the next frame; those without a right image, or too soon after the last one, are passed by."""
        step_s = frame.time_s - self._last_s
        if self.is_full or frame.right is None or step_s < MIN_STEP_S:
            return
        if step_s > _MAX_GAP_S:
            self._close()
            self._tracks = FeatureTracks()
        self._last_s = frame.time_s
        self._n_frames_left -= 1
        points = self._tracks.add(grey(frame.left), grey(whole_image(frame.right)))
        self._rows_px.append(points.row_offsets_px)
        if self._tracks.share_kept < _MIN_KEPT:
            self._close()
        is_seen = len(points.number) >= MIN_ROWS
        if self._seen and is_seen and self._tracks.flow_px < _MIN_FLOW_PX:
            self._n_still += 1
            return
        self._seen.append(points)
        if len(self._seen) == N_FRAMES:
            self._close()

    def estimate(self) -> Alignment:
        """The alignment that the drives so far call for; not more than asked: the caller applies it or not.

        Where they tell nothing of the disparities, the offset is 0, its sigma as before anything was seen, and the
        source says why; the rows are told in any case.
        """
        self._close()
        row_offset_px = self._row_offset_px()
        if not self._segments:
            return Alignment(row_offset_px=row_offset_px, source=f"this drive tells nothing ({self._reason()})")
        found = combine(self._segments, has_bow=True)
        if abs(found.error_px[1]) <= _MIN_BOW_SIGMAS * found.sigma_px[1]:
            found = combine(self._segments, has_bow=False)
        offset_sigma_px = math.hypot(found.sigma_px[0], _LOCKING_PX)
        if not offset_sigma_px <= _MAX_SIGMA_PX:
            reason = f"its estimate of {found.error_px[0]:+.2f} px is uncertain by {offset_sigma_px:.2f} px"
            return Alignment(row_offset_px=row_offset_px, source=f"this drive tells too little ({reason})")
        return Alignment(
            offset_px=float(found.error_px[0]),
            bow_px=float(found.error_px[1]),
            row_offset_px=row_offset_px,
            residual_px=_residual_px(found),
            offset_sigma_px=offset_sigma_px,
            bow_sigma_px=float(found.sigma_px[1]),
            source=f"this drive, {sum(stretch.n_frames for stretch in self._segments)} frames",
        )

    def _begin_drive(self) -> None:
        self._n_segments_left, self._n_frames_left, self._n_still = _MAX_SEGMENTS, _MAX_FRAMES, 0
        self._last_s, self._tracks = -math.inf, FeatureTracks()

    def _close(self) -> None:
        """Make a stretch of what has been seen since the last one."""
        seen, self._seen = self._seen, []
        n_still, self._n_still = self._n_still, 0
        if len(seen) < MIN_FRAMES:
            if seen:
                still = n_still > len(seen)
                self._reasons.append("the vehicle stands still" if still else "fewer than 10 frames in motion")
            return
        found = segment_of(_sightings(seen), self._rig)
        if isinstance(found, str):
            self._reasons.append(found)
            return
        self._n_segments_left -= 1
        self._segments.append(found)

    def _reason(self) -> str:
        return max(self._reasons, key=self._reasons.count) if self._reasons else "no pairs of images"

    def _row_offset_px(self) -> float:
        rows_px = np.concatenate([np.zeros(0), *self._rows_px])
        return float(np.median(rows_px)) if len(rows_px) >= MIN_ROWS else 0.0


def _sightings(seen: list[PairPoints]) -> Observations:
    frame = np.concatenate([np.full(len(points.number), index) for index, points in enumerate(seen)])
    number = np.concatenate([points.number for points in seen])
    xyx_px = np.concatenate([np.column_stack([points.left_px, points.right_px[:, 0]]) for points in seen])
    return Observations(frame, number, xyx_px)


def _residual_px(found: CombinedEstimate) -> float:
    spread_px = found.spread_px if np.isfinite(found.spread_px) else UNCORRECTED_SIGMA_PX / _SPREADS
    return float(max(_LEAST_RESIDUAL_PX, np.hypot(found.sigma_px[0], _SPREADS * spread_px)))
