"""Detection of boxes whose frame numbers are off by one: the commonest error of converters between label formats."""

from __future__ import annotations

import numpy as np

from track_range.detection.boxes import iou
from track_range.foundation.arrays import FloatArray, IntArray

_MAX_FRAMES = 200  # largest number of frames that are compared
_MIN_BOXES = 20  # smallest number of truth boxes in the compared frames from which a shift is detected
_MIN_IOU = 0.8  # smallest mean IoU of the shifted boxes; detectors reach about 0.8, copies of the same boxes 1
_MAX_LOSS = 0.5  # largest ratio of 1 - mean IoU with the shift to that without: a shift costs more than noise
_MIN_GAIN = 0.005  # smallest gain of the mean IoU by the shift; boxes of static objects match at every shift


def frame_shift(truth_frame: IntArray, truth_px: FloatArray, frame: IntArray, xyxy_px: FloatArray) -> int:
    """The number, -1, 0 or 1, that added to the frame numbers of boxes makes them match truth boxes best.

    0 also if there are too few boxes, or if the difference is too small to be certain.
    """
    frames = np.unique(truth_frame)
    frames = frames[:: max(len(frames) // _MAX_FRAMES, 1)]
    overlaps = {shift: _mean_iou(frames, (truth_frame, truth_px), (frame + shift, xyxy_px)) for shift in (0, -1, 1)}
    best = max(overlaps, key=lambda shift: overlaps[shift])
    if overlaps[best] < max(_MIN_IOU, overlaps[0] + _MIN_GAIN) or 1 - overlaps[best] > _MAX_LOSS * (1 - overlaps[0]):
        return 0
    return best


def _mean_iou(frames: IntArray, truth: tuple[IntArray, FloatArray], others: tuple[IntArray, FloatArray]) -> float:
    """Mean over truth boxes of the largest IoU with another box in their frame, where it has one; 0 = too few boxes."""
    best = [np.zeros(0)]
    for number in frames:
        overlap = iou(truth[1][truth[0] == number], others[1][others[0] == number]).max(axis=1, initial=0.0)
        best.append(overlap[overlap > 0])
    values = np.concatenate(best)
    return float(values.mean()) if len(values) >= _MIN_BOXES else 0.0


def frame_shift_note(
    name: str, truth_frame: IntArray, truth_px: FloatArray, frame: IntArray, xyxy_px: FloatArray
) -> tuple[str, ...]:
    """A note if boxes match the truth much better one frame earlier or later; see `frame_shift`."""
    shift = frame_shift(truth_frame, truth_px, frame, xyxy_px)
    if not shift:
        return ()
    change = "decreased" if shift < 0 else "increased"
    return (
        f"{name}: the tracks match the ground truth much better if their frame numbers are {change} by 1; "
        "check that the frame numbers of both start at 0.",
    )
