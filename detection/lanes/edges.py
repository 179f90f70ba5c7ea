r"""EdgeLaneFinder: detection of the ego lane's lines without a network, from pairs of edges.

    grey          ____         Paint is a bright bar between two edges. The response at its centre is
             ____|    |____    min(I(x) - I(x - s), I(x) - I(x + s)), with s a little more than the width of the bar,
                 <-- s -->     which grows with the row below the horizon. The strongest bars of each row are markings.

The Hough transform and the least-squares fit are the same as for networks. Yellow paint on pale
concrete is detected in the yellow channel, (R + G) / 2 - B, instead of grey. Without paint, or if
shadows have more contrast than the paint, no lines are found; use a network in such scenes.
"""

from itertools import pairwise

import cv2
import numpy as np

from track_range.detection.lanes.ego_lane import EgoLane
from track_range.detection.lanes.lines import NO_BOXES, LaneLines
from track_range.detection.lanes.markings import Markings, run_middles
from track_range.detection.lanes.model import HORIZON
from track_range.foundation.arrays import (
    BoolArray,
    FloatArray,
    FloatArray32,
    Image,
    check_shape,
)
from track_range.foundation.robust_statistics import median_of

# approximate width of the downscaled image, by an integer factor: others take ten times as long
_WIDTH_PX = 640
_ROW_STEP = 2  # every second row is searched
# first row, in image heights below the horizon; closer to it, paint is one pixel wide
_MIN_DEPTH = 0.05
_N_BANDS = 5  # number of bands of rows, each with one value of s
_PAINT_SLOPE = 0.13  # s per row below the horizon, for a line of 0.2 m seen from a height of 1.5 m
_MIN_CONTRAST = 14.0  # smallest response of a bar, in grey levels
# smallest response of a bar, in robust standard deviations of differences over s in its row
_MIN_TEXTURE_RATIO = 4.0
_SIGMA_PX = 1.0  # standard deviation of a marking's x, in pixels of the downscaled image
_THREE = np.full((1, 3), 1 / 3, np.float32)  # mean of three pixels of a row
_GREY_AND_YELLOW = np.array([[1 / 3, 1 / 3, 1 / 3], [-1.0, 0.5, 0.5]], np.float32)  # weights of BGR


class EdgeLaneFinder:
    """Detector of lane lines by their painted bars; see the module's description."""

    def __init__(self) -> None:
        self.notes: tuple[str, ...] = ()
        self._lane = EgoLane()

    def find(self, image: Image, time_s: float, boxes_px: FloatArray = NO_BOXES) -> LaneLines:
        """The lines in `image`, (H, W, 3) uint8 BGR, taken at `time_s`, outside of the boxes
        (M, 4) of objects; ValueError for another shape.
        """
        check_shape("image", image, (None, None, 3))
        image_hw = (image.shape[0], image.shape[1])
        shrink = max(min(round(image_hw[1] / _WIDTH_PX), image_hw[0]), 1)
        horizon_px = (
            HORIZON * image_hw[0] if self._lane.state is None else self._lane.state.horizon_px
        )
        top = shrink * _first_row(horizon_px / shrink, image_hw[0] // shrink)
        searched = image[top:]
        if shrink > 1:  # a remainder at the right and bottom is cropped
            height, width = len(searched) // shrink, image_hw[1] // shrink
            cropped = searched[: height * shrink, : width * shrink]
            searched = np.asarray(
                cv2.resize(cropped, (width, height), interpolation=cv2.INTER_AREA), np.uint8
            )
        xy_px = paint_points(searched, (horizon_px - top + 0.5) / shrink - 0.5)
        xy_px = (xy_px + 0.5) * shrink - 0.5 + np.array([0.0, top])
        markings = Markings.unnumbered(xy_px, _SIGMA_PX * shrink).outside(boxes_px)
        return self._lane.update(markings, time_s, image_hw)


def paint_points(image: Image, horizon_px: float) -> FloatArray:
    """(N, 2) centres of bright bars in every second row below the horizon, which may be above the
    image.
    """
    first = _first_row(horizon_px, len(image))
    rows = np.asarray(image[first::_ROW_STEP], np.float32)
    n_rows, width = rows.shape[:2]
    both = _GREY_AND_YELLOW @ rows.reshape(-1, 3).T
    # a tenth of the time of cv2.blur for so few pixels
    smooth = np.asarray(cv2.filter2D(both.reshape(-1, width), -1, _THREE), np.float32)
    channels = smooth.reshape(2, n_rows, width)
    is_peak = np.zeros(channels.shape[1:], np.bool_)
    size, n_larger = divmod(n_rows, _N_BANDS)
    edges = [number * size + min(number, n_larger) for number in range(_N_BANDS + 1)]
    for top, bottom in pairwise(edges):
        if top == bottom:
            continue
        row_px = first + _ROW_STEP * (top + bottom - 1) / 2
        reach = max(round(_PAINT_SLOPE * (row_px - horizon_px)), 3)
        is_peak[top:bottom] = _peaks(_bars(channels[:, top:bottom], reach), reach)
    row, x = run_middles(is_peak)
    return np.stack([x, first + _ROW_STEP * row], axis=1)


def _first_row(horizon_px: float, height_px: int) -> int:
    return int(np.clip(horizon_px + _MIN_DEPTH * height_px, 0, max(height_px - _N_BANDS, 0)))


def _bars(channels: FloatArray32, reach: int) -> FloatArray32:
    """(H, W) largest difference of each pixel in channels (2, H, W) from the brighter of its
    neighbours at `reach` pixels; 0 below a threshold.
    """
    response: FloatArray32 = np.zeros(channels.shape[1:], np.float32)
    if channels.shape[2] <= 2 * reach:
        return response
    step = channels[..., reach:] - channels[..., :-reach]
    # Paint must exceed the texture of its row, for example the pattern of shade on asphalt.
    texture = 1.48 * median_of(np.abs(step[..., ::3]))[..., None]
    inner = np.minimum(step[..., :-reach], -step[..., reach:])
    inner *= inner > np.maximum(_MIN_CONTRAST, _MIN_TEXTURE_RATIO * texture)
    np.maximum(inner[0], inner[1], out=response[:, reach:-reach])
    return response


def _peaks(response: FloatArray32, reach: int) -> BoolArray:
    """(H, W) mask of the largest responses within `reach` in each row, the centres of bars."""
    smooth = cv2.blur(response, (max(reach | 1, 3), 1))
    highest = cv2.dilate(smooth, np.ones((1, 2 * reach + 1), np.uint8))
    return np.asarray((smooth == highest) & (response > 0))
