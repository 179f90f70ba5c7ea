"""FarPass: a second look of a network at the band around the horizon, in which road users are far.

A network sees images of 1920x1080 px at 0.3 of their resolution, so that a person at 60 m is 17 px
high. In the band, which is a third of the image, it sees them at 0.75.
"""

import math
from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np

from track_range.detection.boxes import fraction_inside, iou
from track_range.detection.classes import ROAD_CLASSES, SAME_OBJECT_GROUP, STATIC_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.detector import MAX_IOU
from track_range.detection.yolo.detector import YoloDetector
from track_range.foundation.arrays import Image

# Height and largest width of the network's input for the band, multiples of 32. With 1920x1080 px
# and a field of view of 55 degrees, a person at 80 m is then 30 px high, and the band holds people
# from 20 m.
_HEIGHT_PX, _MAX_WIDTH_PX, _STRIDE_PX = 256, 1440, 32
# resolution relative to that of the whole image from which a pass pays without being asked for
_MIN_GAIN = 2.0
_INTERVAL_S = 0.09  # between two passes without being asked for: at most ten per second
_CUT_PX = 3.0  # of the input: a box that ends so near to a border of the band is cut
# of the input: higher boxes are left to the whole image, in which road users are then high enough;
# in the band they are often a part of a near road user
_MAX_BOX_PX = 64.0
# a box that only the band has needs this score, and is a part of a road user if this fraction of it
# is inside a better box of the whole image
_MIN_NEW_SCORE, _PART = 0.15, 0.9
_N_ROWS = 40  # of low boxes, of the whole image and of the band, that show the horizon
_IS_ROAD_USER = ~np.isin(ROAD_CLASSES, STATIC_CLASSES)


class FarPass:
    """Adds the far road users of a video to those that a network finds in its whole images.

    `every`: a pass in every n-th frame; 0 = none; None = at most ten per second, in images that the
    network sees at less than half of the resolution of the band. The band is around the median row
    of the low boxes so far, at first around the middle of the image; the horizon that later stages
    measure is not used, since it would depend on how far their threads are.
    """

    def __init__(self, network: YoloDetector, every: int | None = None) -> None:
        self._network, self._every = network, every
        self.restart()

    def restart(self) -> None:
        """Forget what the images so far showed."""
        self.n_frames, self.n_passes = 0, 0
        self._input_hw = _HEIGHT_PX, _MAX_WIDTH_PX
        self._last_s = -math.inf  # time of the last pass
        self._rows_px: deque[float] = deque(maxlen=_N_ROWS)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_network"}

    def completed(self, near: Detections, image: Image, time_s: float) -> Detections:
        """The boxes `near` of an image, (H, W, 3) uint8 BGR, with those of the band if a pass is
        due; frames must be passed in order.
        """
        width_px = min(image.shape[1], _MAX_WIDTH_PX) // _STRIDE_PX * _STRIDE_PX
        scale = width_px / image.shape[1]
        near_scale = min(np.divide(self._network.input_hw, image.shape[:2]))
        if self._is_left_out(scale / near_scale):
            return near
        self._input_hw = _HEIGHT_PX, width_px
        self.n_frames += 1
        max_box_px = _MAX_BOX_PX / scale
        self._learn_row(near, max_box_px)
        if not self._is_due(time_s):
            return replace(near, is_complete=False)
        self.n_passes, self._last_s = self.n_passes + 1, time_s
        far = self._far(image, scale)
        self._learn_row(far, max_box_px)
        return merged(near, far)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the passes so far were, and their cost; or why there are none."""
        network = self._network
        if self._every != 0 and not network.takes_parts:
            name, option = network.session.path.name, "--far-pass" if self._every else "--size auto"
            return (f"{option} is not used: {name} has no colour input of variable size.",)
        if not self.n_passes:
            return ()
        height, width = self._input_hw
        share = self.n_passes / self.n_frames
        work = 1 + share * height * width / math.prod(network.input_hw)
        return (
            f"Far road users were sought in a second pass ({width}x{height} px around the horizon) "
            f"in {self.n_passes} of {self.n_frames} frames, which made the detector's work "
            f"{work:.1f} times as large; --far-pass 0 leaves it out.",
        )

    def _is_left_out(self, gain: float) -> bool:
        """Whether the passes are off, or show road users hardly larger than the whole image."""
        is_off = self._every == 0 or not self._network.takes_parts
        return is_off or (self._every is None and gain < _MIN_GAIN)

    def _is_due(self, time_s: float) -> bool:
        if self._every is not None:
            return (self.n_frames - 1) % self._every == 0
        # frames that are read before a run may be later ones
        return not self._last_s <= time_s < self._last_s + _INTERVAL_S

    def _learn_row(self, detections: Detections, max_box_px: float) -> None:
        height_px = detections.xyxy_px[:, 3] - detections.xyxy_px[:, 1]
        is_low = (height_px < max_box_px) & _IS_ROAD_USER[detections.class_id]
        if is_low.any():
            self._rows_px.append(float(np.median(detections.xyxy_px[is_low][:, 1::2])))

    def _far(self, image: Image, scale: float) -> Detections:
        """The low boxes in the band that no border inside the image cuts, by `scale` pixels of the
        input per pixel of the image.
        """
        height = image.shape[0]
        band_px = min(round(_HEIGHT_PX / scale), height)
        row_px = float(np.median(self._rows_px)) if self._rows_px else height / 2
        top = round(min(max(row_px - band_px / 2, 0.0), height - band_px))
        bottom = top + band_px
        boxes = self._network.detect_part(image[top:bottom], self._input_hw)
        xyxy_px = boxes.xyxy_px + np.array([0, top, 0, top])
        margin_px = _CUT_PX / scale
        least_px = top + margin_px if top > 0 else -math.inf
        most_px = bottom - margin_px if bottom < height else math.inf
        is_whole = (xyxy_px[:, 1] > least_px) & (xyxy_px[:, 3] < most_px)
        is_whole &= xyxy_px[:, 3] - xyxy_px[:, 1] < _MAX_BOX_PX / scale
        return replace(boxes, xyxy_px=xyxy_px).select(is_whole)


def merged(near: Detections, far: Detections) -> Detections:
    """The boxes of a whole image and those of its band, in order of decreasing score.

    Of two boxes of one object, that of the band remains, since its edges are more exact, with the
    higher score of both. Boxes of the band without another are left out if they have a low score or
    are a part of a better box.
    """
    is_group = SAME_OBJECT_GROUP[near.class_id][:, None] == SAME_OBJECT_GROUP[far.class_id]
    is_same = is_group & (iou(near.xyxy_px, far.xyxy_px) > MAX_IOU)
    is_part = is_group & (near.score[:, None] > far.score)
    is_part &= fraction_inside(far.xyxy_px, near.xyxy_px).T > _PART
    is_new = (far.score >= _MIN_NEW_SCORE) & ~is_part.any(axis=0)
    near_score = (is_same * near.score[:, None]).max(axis=0, initial=0.0)
    far = replace(far, score=np.maximum(far.score, near_score))
    parts = near.select(~is_same.any(axis=1)), far.select(is_same.any(axis=0) | is_new)
    both = Detections.of(
        np.concatenate([part.xyxy_px for part in parts]),
        np.concatenate([part.score for part in parts]),
        np.concatenate([part.class_id for part in parts]),
    )
    return both.select(np.argsort(-both.score, kind="stable"))
