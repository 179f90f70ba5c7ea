"""KnownDistances: distances that the user measured, as evidence of the scale of a pair."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from track_range.detection.boxes import iou
from track_range.ranging.cameras.evidence import Evidence, SeenFrame
from track_range.ranging.cameras.unknowns import OF_PAIR

_KNOWN_SIGMA = 0.03  # relative, of a distance by tape or map to the surface that a matcher sees
_MIN_IOU = 0.4  # smallest IoU of a track with the box of the user
# times before and after the stated one at which a frame is the stated one: in 0.1 s, oncoming
# vehicles come nearer by 3 m
_EARLY_S, _LATE_S = 0.02, 0.1


class KnownDistance(NamedTuple):
    """A distance along the axis of the camera to the nearest surface of an object."""

    time_s: float
    xyxy_px: tuple[float, float, float, float]
    distance_m: float


class KnownDistances:
    """Compares each known distance with that by the rig, in the frame of its time."""

    def __init__(self, known: Sequence[KnownDistance]) -> None:
        self._due, self._unused = list(known), list(known)
        self.evidence: list[Evidence] = []  # of all frames so far

    @property
    def notes(self) -> tuple[str, ...]:
        """A message on each distance that is no evidence so far."""
        return tuple(
            f"--known-distance at {known.time_s:g} s does not show the scale of the pair: no frame "
            "at this time has a distance by the pair in this box so far."
            for known in self._unused
        )

    def add(self, seen: SeenFrame) -> None:
        """Add a frame."""
        due = [known for known in self._due if known.time_s <= seen.time_s + _EARLY_S]
        self._due = [known for known in self._due if known not in due]
        tracks, by_rig = seen.tracks, seen.by_rig
        if by_rig is None:
            return
        is_measured = tracks.observed & np.isfinite(by_rig.distance_m)
        for known in due:
            overlap = np.where(is_measured, iou(np.array([known.xyxy_px]), tracks.xyxy_px)[0], 0.0)
            if seen.time_s - known.time_s > _LATE_S or overlap.max(initial=0.0) < _MIN_IOU:
                continue
            self._unused.remove(known)
            best = int(np.argmax(overlap))
            distance_m, sigma_m = float(by_rig.distance_m[best]), float(by_rig.sigma_m[best])
            self.evidence.append(
                Evidence(
                    "known distances",
                    OF_PAIR,
                    math.log(distance_m / known.distance_m),
                    math.hypot(sigma_m / distance_m, _KNOWN_SIGMA),
                )
            )
