r"""EdgeLaneFinder: the own lane's lines without a network, from pairs of edges.

    grey          ____         paint is a bar between two edges, darker on both sides: the response at its middle is
             ____|    |____    min(I(x) - I(x - s), I(x) - I(x + s)), s a little more than the bar's width, which grows
                 <-- s -->     with the rows below the horizon; the brightest bars of each row are taken as markings

Then as for networks: Hough, least squares. Yellow paint on pale concrete is seen in yellow, (R + G) / 2 - B, not in
grey. Where there is no paint, or shadows are stronger than it, nothing is found: a network is the better choice.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from track_range.detection.lanes.lines import LaneLines
from track_range.detection.lanes.markings import Markings, run_middles
from track_range.detection.lanes.model import HORIZON
from track_range.detection.lanes.own_lane import OwnLane
from track_range.foundation.arrays import BoolArray, FloatArray, Image, check_shape

Float32Array = npt.NDArray[np.float32]

_WIDTH_PX = 640  # images are shrunk by a whole number, to about this width: other factors take ten times as long
_EVERY_ROW = 2
_FARTHEST = 0.05  # image heights below the horizon where looking begins: farther up, paint is one pixel among houses
_BANDS = 5  # of rows, each with one width of paint
_PAINT = 0.13  # s per row below the horizon: 0.2 m seen from 1.5 m
_MIN_CONTRAST = 14.0  # grey levels
_DEVIATIONS = 4.0  # of the steps, as long as s, that a row's own texture makes
_SIGMA_PX = 1.0
_GREY_AND_YELLOW = np.array([[1 / 3, 1 / 3, 1 / 3], [-1.0, 0.5, 0.5]], np.float32)  # of blue, green, red


class EdgeLaneFinder:
    """Finds lanes by their paint."""

    def __init__(self) -> None:
        """Know nothing yet."""
        self.notes: tuple[str, ...] = ()
        self._lane = OwnLane()

    def find(self, image: Image, time_s: float) -> LaneLines:
        """The lines in `image`, (H, W, 3) uint8 BGR, taken at `time_s`.

        Raises:
            ValueError: the image is not (H, W, 3).
        """
        check_shape("image", image, (None, None, 3))
        image_hw = (image.shape[0], image.shape[1])
        shrink = max(min(round(image_hw[1] / _WIDTH_PX), image_hw[0]), 1)
        horizon_px = HORIZON * image_hw[0] if self._lane.state is None else self._lane.state.horizon_px
        top = shrink * _first_row(horizon_px / shrink, image_hw[0] // shrink)
        xy_px = paint_points(_shrunk(image[top:], shrink), (horizon_px - top + 0.5) / shrink - 0.5)
        xy_px = (xy_px + 0.5) * shrink - 0.5 + np.array([0.0, top])
        return self._lane.update(Markings.unnumbered(xy_px, _SIGMA_PX * shrink), time_s, image_hw)


def paint_points(image: Image, horizon_px: float) -> FloatArray:
    """(N, 2) middles of bright bars in every other row of an image, (H, W, 3) BGR, below the horizon.

    The horizon, in the image's rows, may lie above the image.
    """
    first = _first_row(horizon_px, len(image))
    channels = _channels(image[first::_EVERY_ROW])
    found = []
    for rows in np.array_split(np.arange(len(channels[0])), _BANDS):
        if not len(rows):
            continue
        band = slice(rows[0], rows[-1] + 1)
        reach = max(round(_PAINT * (first + _EVERY_ROW * float(rows.mean()) - horizon_px)), 3)
        bars = [_bars(channel[band], reach) for channel in channels]
        row, x = run_middles(_peaks(np.maximum(*bars), reach))
        found.append(np.stack([x, first + _EVERY_ROW * rows[row]], axis=1))
    return np.concatenate(found) if found else np.zeros((0, 2))


def _first_row(horizon_px: float, height_px: int) -> int:
    """Where looking begins, for an image that has the horizon in that row."""
    return int(np.clip(horizon_px + _FARTHEST * height_px, 0, max(height_px - _BANDS, 0)))


def _shrunk(image: Image, shrink: int) -> Image:
    """An image a whole number of times smaller; what is left over at the right and below is cut off."""
    if shrink == 1:
        return image
    height, width = (side // shrink for side in image.shape[:2])
    whole = image[: height * shrink, : width * shrink]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _channels(bgr: Image) -> tuple[Float32Array, Float32Array]:
    """Grey and yellow, a little smoothed along the rows."""
    both = cv2.transform(np.asarray(bgr, np.float32), _GREY_AND_YELLOW)
    grey, yellow = cv2.split(cv2.blur(both, (3, 1)))
    return np.asarray(grey, np.float32), np.asarray(yellow, np.float32)


def _bars(channel: Float32Array, reach: int) -> Float32Array:
    """How much each pixel is brighter than both neighbours `reach` away; 0 at the image's sides."""
    response = np.zeros_like(channel)
    if channel.shape[1] <= 2 * reach:
        return response
    step = channel[:, reach:] - channel[:, :-reach]
    # Texture sets the bar: asphalt in broken shade has no paint that could be told from it.
    texture = 1.48 * np.median(np.abs(step[:, ::3]), axis=1, keepdims=True)
    inner = np.minimum(step[:, :-reach], -step[:, reach:])
    response[:, reach:-reach] = inner * (inner > np.maximum(_MIN_CONTRAST, _DEVIATIONS * texture))
    return response


def _peaks(response: Float32Array, reach: int) -> BoolArray:
    """Where a row's response is the largest within `reach`: the middle of the bar's top."""
    smooth = cv2.blur(response, (max(reach | 1, 3), 1))
    highest = cv2.dilate(smooth, np.ones((1, 2 * reach + 1), np.uint8))
    return np.asarray((smooth == highest) & (response > 0))
