"""Detection of boxes whose frame numbers are shifted, mostly by one, the most common error of label
converters.
"""

import numpy as np

from track_range.detection.boxes import iou
from track_range.foundation.arrays import FloatArray, IntArray

_MAX_FRAMES = 200  # largest number of frames that are compared
# smallest number of truth boxes in the compared frames from which a shift is detected
_MIN_BOXES = 20
# smallest mean IoU of the shifted boxes; detectors reach about 0.8, copies of the same boxes 1
_MIN_IOU = 0.8
# largest ratio of 1 - mean IoU with the shift to that without: a shift costs more than noise
_MAX_LOSS = 0.5
_N_VOTES = 10  # truth frames that are compared with all others; up to twice as many
# smallest gain of the mean IoU by the shift; boxes of static objects match at every shift
_MIN_GAIN = 0.005


def frame_shift(
    truth_frame: IntArray, truth_px: FloatArray, frame: IntArray, xyxy_px: FloatArray
) -> int:
    """The number that, added to the frame numbers of boxes, makes them match truth boxes best.

    0 also if there are too few boxes, or if the difference is too small to be certain.
    """
    frames = np.unique(truth_frame)
    frames = frames[:: max(len(frames) // _MAX_FRAMES, 1)]
    shifts = (0, -1, 1, voted_shift(truth_frame, truth_px, frame, xyxy_px))
    overlaps = {
        shift: _mean_iou(frames, (truth_frame, truth_px), (frame + shift, xyxy_px))
        for shift in shifts
    }
    best = max(overlaps, key=lambda shift: overlaps[shift])
    if overlaps[best] < max(_MIN_IOU, overlaps[0] + _MIN_GAIN) or 1 - overlaps[best] > _MAX_LOSS * (
        1 - overlaps[0]
    ):
        return 0
    return best


def voted_shift(
    truth_frame: IntArray, truth_px: FloatArray, frame: IntArray, xyxy_px: FloatArray
) -> int:
    """The shift with the largest sum of IoU between truth boxes of some frames and all boxes; 0 =
    no boxes.
    """
    if not len(truth_frame) or not len(frame):
        return 0
    order = np.argsort(frame, kind="stable")
    frames, starts = np.unique(frame[order], return_index=True)
    asked = np.unique(truth_frame)
    asked = asked[:: max(len(asked) // _N_VOTES, 1)]
    overlaps = (iou(truth_px[truth_frame == number], xyxy_px[order]) for number in asked)
    votes = np.stack(
        [np.maximum.reduceat(overlap, starts, axis=1).sum(axis=0) for overlap in overlaps]
    )
    shifts = asked[:, None] - frames
    lowest = int(shifts.min())
    return int(np.bincount((shifts - lowest).ravel(), votes.ravel()).argmax()) + lowest


def _mean_iou(
    frames: IntArray, truth: tuple[IntArray, FloatArray], others: tuple[IntArray, FloatArray]
) -> float:
    """Mean of the largest IoU of each truth box that overlaps a box of the other set in its frame;
    0 = too few.
    """
    best = [np.zeros(0)]
    for number in frames:
        overlap = iou(truth[1][truth[0] == number], others[1][others[0] == number]).max(
            axis=1, initial=0.0
        )
        best.append(overlap[overlap > 0])
    values = np.concatenate(best)
    return float(values.mean()) if len(values) >= _MIN_BOXES else 0.0


def frame_shift_note(
    name: str, truth_frame: IntArray, truth_px: FloatArray, frame: IntArray, xyxy_px: FloatArray
) -> tuple[str, ...]:
    """A note if boxes share no frame with the truth, or match it much better after a shift:
    `frame_shift`.
    """
    is_common = np.isin(frame, truth_frame).any()
    shift = frame_shift(truth_frame, truth_px, frame, xyxy_px)
    change = f"{'decreased' if shift < 0 else 'increased'} by {abs(shift)}"
    if not len(frame) or not len(truth_frame) or (is_common and not shift):
        return ()
    if is_common:
        return (
            f"{name}: the tracks match the ground truth much better if their frame numbers are "
            f"{change}; check that the frame numbers of both start at 0.",
        )
    advice = (
        f"they match if the frame numbers of the tracks are {change}"
        if shift
        else "check that both are of one video"
    )
    return (
        f"{name}: no frame has both ground truth, in frames {truth_frame.min()} to "
        f"{truth_frame.max()}, and tracks, in frames {frame.min()} to {frame.max()}; {advice}.",
    )
