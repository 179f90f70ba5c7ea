"""Evaluations against labels, named by what they evaluate; like `track-range evaluate ... --json`.
Names are imported when they are first used.
"""

from typing import TYPE_CHECKING, Any

from track_range.api.lazy_names import LazyNames

# ruff: noqa: F401  # type checkers and the documentation read the names below
if TYPE_CHECKING:
    from track_range.api.evaluation import (
        evaluate_cuboids as cuboids,
        evaluate_events as events,
        evaluate_motion as motion,
        evaluate_ranges as ranges,
        evaluate_run as run,
        evaluate_stereo as stereo,
        evaluate_tracks as tracks,
    )
    from track_range.detection.evaluation import evaluate_detections as detections
    from track_range.detection.evaluation.object_sizes import evaluate_by_size as detections_by_size
    from track_range.detection.evaluation.score_calibration import (
        evaluate_calibration as score_calibration,
    )
    from track_range.detection.formats.image_labels.image_truth import ImageTruth as ImageTruth

_NAMES = LazyNames(
    __name__,
    {
        "track_range.api.evaluation": "tracks=evaluate_tracks ranges=evaluate_ranges stereo=evaluate_stereo "
        "motion=evaluate_motion cuboids=evaluate_cuboids events=evaluate_events run=evaluate_run",
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
