"""Evaluations against labels, named by what they evaluate; like `track-range evaluate ... --json`.
Names are imported when they are first used.
"""

from typing import TYPE_CHECKING, Any

from track_range.api.lazy_names import LazyNames

if TYPE_CHECKING:
    from track_range.detection.formats.image_labels.image_truth import ImageTruth as ImageTruth

_NAMES = LazyNames(
    __name__,
    {
        "track_range.api.evaluation": "tracks=evaluate_tracks ranges=evaluate_ranges stereo=evaluate_stereo "
        "motion=evaluate_motion events=evaluate_events",
        "track_range.detection.evaluation": "detections=evaluate_detections",
        "track_range.detection.evaluation.object_sizes": "detections_by_size=evaluate_by_size",
        "track_range.detection.evaluation.score_calibration": "score_calibration=evaluate_calibration",
        "track_range.detection.formats.image_labels.image_truth": "ImageTruth",
    },
)

__all__ = [*_NAMES.listed]


def __getattr__(name: str) -> Any:
    return _NAMES.value(name)


def __dir__() -> list[str]:
    return sorted(__all__)
