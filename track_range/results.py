"""What a run found in one frame, and the files that keep it: tracks.csv and mot.txt rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from detection.detections import FloatArray
from ranging.ranges import Ranges
from stereo.frames import Frame
from tracking.tracks import Tracks

MEASURED_METHODS = ("mono", "lane", "stereo", "sgbm", "fused")
"""Methods with a distance and a sigma in tracks.csv, in the columns' order."""

FILTERED_METHODS = ("mono_kf", "stereo_kf", "fused_kf")
"""The same after the per-track distance filter."""


@dataclass(frozen=True, slots=True)
class FrameResult:
    """Everything known about one frame's tracks; all arrays are in the tracks' order.

    Attributes:
        frame: the images and the time.
        tracks: boxes with identities.
        ranges: distance by method name (`MEASURED_METHODS`, `FILTERED_METHODS`); a method that did not run is absent.
        closing_mps: (N,) speed at which the gap shrinks, from the filtered fused distance; NaN = unknown.
        ttc_s: (N,) time to collision, distance / closing speed where it closes; NaN elsewhere.
        xyz_m: (N, 3) ranged point in the left camera's frame, from the fused distance; NaN = unknown.
    """

    frame: Frame
    tracks: Tracks
    ranges: Mapping[str, Ranges]
    closing_mps: FloatArray
    ttc_s: FloatArray
    xyz_m: FloatArray
