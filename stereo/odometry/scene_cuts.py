r"""SceneCuts: where a recording cuts to another scene, such as another camera, another drive, or a
later part of the same one.

    c(i, j) = sum(h_i h_j) / sqrt(sum(h_i^2) sum(h_j^2))      h: high-passed image of 32 columns

An image starts another scene if it does not correlate with the one before it, although that one
correlates with its own predecessor, and the next one with it. A camera that turns fast changes for
several images; a flash, a black or a broken image is followed by the old scene. So a cut is known
one image late. There is no cut after a gap, with another size of the images, or from an image that
a near road user fills.
"""

import math
from collections import deque

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray32, Image

_N_COLUMNS, _MIN_ROWS = 32, 8
_LOW_PASS = 4.0  # sigma of what is removed, columns: exposure, and the sky above the road
# Largest correlation of two scenes, and smallest one of successive images of one: they are 0.09 and
# 0.83 in a dashcam video; scenes of two dashcam clips have 0.15 or less in 70 % of pairs. With one
# to eight frames between images no drive that is not cut fulfils both (12,000 pairs).
_MAX_OTHER, _MIN_SAME = 0.15, 0.6
_MIN_GREY = 3.0  # smallest contrast of an image that shows a scene, standard deviation
_MAX_GAP_S = 0.15  # longest time between two images, in which no car turns away from its view
# largest part of the last image of a scene that a road user may hide: at contact, it fills all
_MAX_HIDDEN = 0.25


class SceneCuts:
    """Finds the cuts of one stream, image after image; the state belongs to the instance."""

    def __init__(self) -> None:
        # high-passed images, and the part of each that a road user hides
        self._latest: deque[tuple[FloatArray32, float]] = deque(maxlen=4)
        self._last_s = -math.inf

    def update(self, small: Image, time_s: float, hidden: float = 0.0) -> bool:
        """Whether the image before this one (H, W) was the first one of another scene; a road user
        hides the part `hidden` of it.
        """
        height, width = small.shape
        size = _N_COLUMNS, max(round(_N_COLUMNS * height / width), _MIN_ROWS)
        if time_s - self._last_s > _MAX_GAP_S or any(
            one.shape != size[::-1] for one, _ in self._latest
        ):
            self._latest.clear()
        self._last_s = time_s
        grey = cv2.resize(small, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        self._latest.append((grey - cv2.GaussianBlur(grey, (0, 0), _LOW_PASS), hidden))
        if len(self._latest) < 4:
            return False
        (first, _), (last, last_hidden), (other, _), (now, _) = self._latest
        if (
            last_hidden > _MAX_HIDDEN
            or max(_correlation(last, other), _correlation(last, now)) > _MAX_OTHER
        ):
            return False
        is_same = min(_correlation(first, last), _correlation(other, now)) >= _MIN_SAME
        return bool(is_same and min(last.std(), other.std()) >= _MIN_GREY)


def _correlation(a: FloatArray32, b: FloatArray32) -> float:
    """Correlation of two high-passed images of one size."""
    return float(np.vdot(a, b) / max(cv2.norm(a) * cv2.norm(b), 1e-6))
