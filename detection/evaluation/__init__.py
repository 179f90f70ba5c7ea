"""Accuracy of detectors on labelled images: average precision, also by size of object, and
calibration of scores.
"""

from track_range.detection.evaluation.average_precision import (
    MIN_BOXES,
    DetectionScores,
    evaluate_detections,
)

__all__ = ["MIN_BOXES", "DetectionScores", "evaluate_detections"]
