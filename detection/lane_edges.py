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

from detection.detections import BoolArray, FloatArray, Image, check_shape
from detection.lane_markings import Markings, run_middles
from detection.lane_model import HORIZON
from detection.lanes import LaneLines
from detection.own_lane import OwnLane

_WIDTH_PX = 640  # images are looked at in this width
_EVERY_ROW = 2
_FARTHEST = 0.05  # image heights below the horizon where looking begins: farther up, paint is one pixel among houses
_BANDS = 5  # of rows, each with one width of paint
_PAINT = 0.13  # s per row below the horizon: 0.2 m seen from 1.5 m
_MIN_CONTRAST = 14.0  # grey levels
_DEVIATIONS = 5.0  # of a row's own texture
_SIGMA_PX = 1.0


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
        scale = min(_WIDTH_PX / image_hw[1], 1.0)
        horizon_px = HORIZON * image_hw[0] if self._lane.state is None else self._lane.state.horizon_px
        xy = paint_points(_resized(image, scale), horizon_px * scale)
        xy_px = (xy + 0.5) / scale - 0.5
        return self._lane.update(Markings.unnumbered(xy_px, _SIGMA_PX / scale), time_s, image_hw)


def paint_points(image: Image, horizon_px: float) -> FloatArray:
    """(N, 2) middles of bright bars in every other row of an image, (H, W, 3) BGR, below the horizon."""
    first = int(np.clip(horizon_px + _FARTHEST * len(image), 0, len(image) - _BANDS))
    found = []
    for rows in np.array_split(np.arange(first, len(image), _EVERY_ROW), _BANDS):
        if not len(rows):
            continue
        reach = max(round(_PAINT * float(rows.mean() - horizon_px)), 3)
        response = np.maximum.reduce([_bars(channel, reach) for channel in _channels(image[rows])])
        row, x = run_middles(_peaks(response, reach))
        found.append(np.stack([x, rows[row]], axis=1))
    return np.concatenate(found) if found else np.zeros((0, 2))


def _resized(image: Image, scale: float) -> Image:
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _channels(bgr: Image) -> tuple[FloatArray, FloatArray]:
    """Grey and yellow, a little smoothed along the rows."""
    blue, green, red = (np.asarray(bgr[..., i], np.float64) for i in range(3))
    grey, yellow = (blue + green + red) / 3, (red + green) / 2 - blue
    return _smooth(grey), _smooth(yellow)


def _smooth(channel: FloatArray) -> FloatArray:
    return np.asarray(cv2.blur(channel, (3, 1)), np.float64)


def _bars(channel: FloatArray, reach: int) -> FloatArray:
    """How much each pixel is brighter than both neighbours `reach` away; 0 at the image's sides."""
    response = np.zeros_like(channel)
    middle = channel[:, reach:-reach]
    response[:, reach:-reach] = np.minimum(middle - channel[:, : -2 * reach], middle - channel[:, 2 * reach :])
    # Texture sets the bar: asphalt in broken shade has no paint that could be told from it.
    noise = 1.48 * np.median(np.abs(np.diff(channel, axis=1)), axis=1, keepdims=True)
    return np.where(response > np.maximum(_MIN_CONTRAST, _DEVIATIONS * noise), response, 0.0)


def _peaks(response: FloatArray, reach: int) -> BoolArray:
    """Where a row's response is the largest within `reach`: the middle of the bar's top."""
    smooth = cv2.blur(response, (max(reach | 1, 3), 1))
    highest = cv2.dilate(smooth, np.ones((1, 2 * reach + 1), np.uint8))
    return np.asarray((smooth == highest) & (response > 0))
