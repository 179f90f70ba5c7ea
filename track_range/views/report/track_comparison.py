"""Road users of two runs on one video, matched by the boxes of each frame; the largest
disagreements come first.

The disagreement of two distances, fused as in the overlay, else filtered, is their difference in
joint standard deviations, sqrt(sigma_1^2 + sigma_2^2).
"""

import base64
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np

from track_range.detection.classes import STATIC_CLASSES
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.pipeline.colours import WHITE
from track_range.ranging.truth.errors import match_boxes
from track_range.results.approaches import closest_approaches, reference_distance
from track_range.results.rows.rows import Rows, most_frequent
from track_range.views.report.content.events import sigma_words, time_words
from track_range.views.videos.event_clips import frame_at

_MIN_FRAMES = 3  # common frames of matched tracks
_MIN_SIGMA = 0.01  # smallest relative standard deviation, also where it is unknown
# from the middle of a box to the edge of its picture, at least
_CROP_PX, _CROP_BOXES = np.array([200.0, 110.0]), 1.2


def track_differences(first: Rows, second: Rows) -> tuple[list[dict[str, Any]], FloatArray]:
    """Road users that both runs measure, the largest disagreement first, and track IDs (2, K) of
    all matched boxes.

    Keys: `names` (most frequent class and ID in each run), `frames` (number of common ones),
    medians of second against first `difference_pct` and `closing_mps` (NaN = unknown), and of the
    frame with the largest disagreement `sigmas`, `time_s`, `words` (the two distances) and `boxes`.
    """
    runs = [_detected(run) for run in (first, second)]
    if not all("x1_px" in run and len(run) for run in runs):
        return [], np.empty((2, 0))
    matches = _Matches.of(runs)
    matched = np.unique(matches.track_id, axis=1)
    differences = []
    for pair in matched.T:
        is_pair = (matches.track_id == pair[:, None]).all(axis=0)
        common = np.flatnonzero(is_pair & np.isfinite(matches.sigmas))
        if len(common) >= _MIN_FRAMES:
            classes = [
                most_frequent(run["class"][run["track_id"] == i])
                for run, i in zip(runs, pair, strict=True)
            ]
            names = [f"{name} {i}" for name, i in zip(classes, pair, strict=True)]
            differences.append({"names": names, **matches.difference(common)})
    return sorted(differences, key=lambda difference: -difference["sigmas"]), matched


@dataclass(frozen=True, slots=True)
class _Matches:
    """The K matched boxes of two runs, (2, K, ...) each."""

    boxes: FloatArray
    time_s: FloatArray  # (K,) in the first run
    distance_m: FloatArray
    sigma_m: FloatArray
    closing_mps: FloatArray
    track_id: FloatArray
    sigmas: FloatArray  # (K,) differences of the distances in standard deviations

    @classmethod
    def of(cls, runs: Sequence[Rows]) -> Self:
        """The matches of two runs with boxes."""
        boxes = [run.boxes_px for run in runs]
        frames = [run["frame"] for run in runs]
        match = match_boxes(frames[0], boxes[0], frames[1], boxes[1])
        rows = [np.flatnonzero(match >= 0), match[match >= 0]]

        def both(values: Iterable[FloatArray]) -> FloatArray:
            return np.stack([side[kept] for side, kept in zip(values, rows, strict=True)])

        distances = [reference_distance(run, ("fused", "fused_kf")) for run in runs]
        distance_m = both(distance_m for distance_m, _ in distances)
        sigma_m = both(sigma_m for _, sigma_m in distances)
        difference_sigma_m = np.hypot(*np.fmax(sigma_m, _MIN_SIGMA * distance_m))
        return cls(
            both(boxes),
            runs[0]["time_s"][rows[0]],
            distance_m,
            sigma_m,
            both(run["closing_mps"] for run in runs),
            both(run["track_id"] for run in runs),
            np.abs(distance_m[1] - distance_m[0]) / difference_sigma_m,
        )

    def difference(self, common: IntArray) -> dict[str, Any]:
        """The difference of two tracks in their common matches, but for the names."""
        first_m, second_m = self.distance_m[:, common]
        gap_mps = self.closing_mps[1, common] - self.closing_mps[0, common]
        at = common[np.argmax(self.sigmas[common])]
        return {
            "frames": len(common),
            "difference_pct": 100 * float(np.median(second_m / first_m - 1)),
            "closing_mps": float(np.nanmedian(gap_mps)) if np.isfinite(gap_mps).any() else np.nan,
            "sigmas": float(self.sigmas[at]),
            "time_s": float(self.time_s[at]),
            "words": [
                f"{distance_m:.1f} ±{sigma_words(sigma_m)} m"
                for distance_m, sigma_m in zip(
                    self.distance_m[:, at], self.sigma_m[:, at], strict=True
                )
            ],
            "boxes": list(self.boxes[:, at]),
        }


def unmatched_names(run: Rows, matched: FloatArray) -> Iterator[str]:
    """Road users of a run without a matched box, nearest first, with their smallest distances."""
    rows = _detected(run)
    for user in closest_approaches(rows):
        if user["track_id"] not in matched and user["min_distance_m"] is not None:
            nearest = f"{user['min_distance_m']:.1f} m at {time_words(user['min_distance_m_at_s'])}"
            yield f"{user['class']} {user['track_id']} ({nearest})"


def _detected(run: Rows) -> Rows:
    """Rows of detected road users."""
    return run.select(run["observed"] & ~np.isin(run["class"], STATIC_CLASSES))


def picture(overlay: Path | None, time_s: float, box: FloatArray) -> str:
    """The part of an overlay around a box as a data URI; `time_s` from its first frame; "" = there
    is no picture.
    """
    image = None if overlay is None else frame_at(overlay, time_s)
    if image is None:
        return ""
    x1, y1, x2, y2 = np.rint(box).astype(int).tolist()
    cv2.rectangle(image, (x1, y1), (x2, y2), WHITE, 4)
    middle, half = (box[:2] + box[2:]) / 2, np.maximum(_CROP_PX, _CROP_BOXES * (box[2:] - box[:2]))
    edges = np.clip([middle - half, middle + half], 0, image.shape[1::-1]).astype(int)
    part = image[slice(*edges[:, 1]), slice(*edges[:, 0])]
    encoded = cv2.imencode(".jpg", part)[1].tobytes() if part.size else b""
    return f"data:image/jpeg;base64,{base64.b64encode(encoded).decode()}" if encoded else ""
