"""FrameResult: tracks, distances and times to collision of one frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from track_range.detection.detections import Detections
from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.arrays import FloatArray
from track_range.ranging.filtering.collision_course import PassingOffsets
from track_range.ranging.ranges import Ranges
from track_range.ranging.warning.warnings import Warnings
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks


@dataclass(frozen=True, slots=True)
class FrameResult:
    """Tracks of one frame with their distances; every array is in the order of the tracks.

    Attributes:
        frame: the images and their time; with `--anonymize` the anonymized left image only.
        tracks: N boxes with identities.
        ranges: distances by name of the method, including "fused" and the filtered ones (NAME_kf); a method that did
            not run is absent.
        closing_mps: (N,) closing speed in m/s (positive = approaching), from the filtered fused distance; NaN =
            unknown.
        closing_sigma_mps: (N,) its standard deviation.
        ttc_s: (N,) time to collision in seconds, distance / closing speed; NaN = not approaching.
        ttc_sigma_s: (N,) its standard deviation.
        xyz_m: (N, 3) ranged point in the left camera's frame (x right, y down, z forward), from the fused distance;
            NaN = unknown.
        disparity: (H, W) disparities in px, NaN = unknown; None if dense stereo did not run.
        lanes: lines of the ego lane; None if no lane detector ran.
        candidates: all detections of the frame, of all classes and with low scores; None = not needed.
        misses: lateral offset of each track at its time to collision; None if it was not estimated.
        ego_mps: speed of the camera along its axis in m/s, negative = backwards; NaN = unknown.
        ego_sigma_mps: its standard deviation; NaN = unknown.
        warnings: probability of contact and alarm of each track; None if they were not estimated.
    """

    frame: Frame
    tracks: Tracks
    ranges: Mapping[str, Ranges]
    closing_mps: FloatArray
    closing_sigma_mps: FloatArray
    ttc_s: FloatArray
    ttc_sigma_s: FloatArray
    xyz_m: FloatArray
    disparity: npt.NDArray[np.float32] | None = None
    lanes: LaneLines | None = None
    misses: PassingOffsets | None = None
    candidates: Detections | None = None
    ego_mps: float = math.nan
    ego_sigma_mps: float = math.nan
    warnings: Warnings | None = None

    @property
    def index(self) -> int:
        """Number of the frame in the video, from 0."""
        return self.frame.index

    @property
    def time_s(self) -> float:
        """Seconds from the first frame of the video."""
        return self.frame.time_s

    @property
    def utc_s(self) -> float:
        """Seconds since 1970-01-01 00:00 UTC; NaN = unknown."""
        return self.frame.utc_s

    def may_hit(self, row: int) -> bool:
        """False if the track in this row is known to pass by the camera without a collision."""
        return self.misses is None or bool(self.misses.may_hit[row])
