"""Appearance embeddings of boxes: vectors of length 1, or zeros where the appearance is unknown.

`ColourLayout` needs no network: histograms of colour in horizontal bands, as square roots, so that

    cos(a, b) = sum sqrt(a_i b_i)

is Bhattacharyya's coefficient of the histograms (as in RootSIFT, Arandjelovic and Zisserman, 2012).
The embeddings of tracks are kept in `track_range.tracking.appearance.gallery`.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from track_range.detection.boxes import are_valid_boxes, fraction_inside
from track_range.detection.detections import Descriptors
from track_range.foundation.arrays import BoolArray, FloatArray, Image, check_shape
from track_range.tracking.appearance.gallery import unit_rows

MIN_SIDE_PX = 4.0  # minimum width and height of a box with an embedding
MIN_FRACTION_INSIDE = 0.3  # minimum fraction of a box inside the image, for an embedding
_FAR_PX = 1e6  # box edges are clipped here, so that areas stay finite
_BOX_BLOCK = 64  # boxes embedded at once: their data stays in the processor's cache
# levels in which values 0..255 are counted before they are distributed over soft bins
_N_LEVELS = 64
# largest difference, in grey levels, between the colour channels of a grey image after video
# compression
_NEUTRAL = 8
_STEP_PX = 16  # distance between the pixels that decide whether an image is grey


def has_appearance(image: Image, xyxy_px: FloatArray) -> BoolArray:
    """(N,) which boxes are large enough, and lie far enough inside the image, for an embedding."""
    height, width = image.shape[:2]
    boxes = np.clip(np.where(are_valid_boxes(xyxy_px)[:, None], xyxy_px, 0.0), -_FAR_PX, _FAR_PX)
    inside = fraction_inside(boxes, np.array([[-0.5, -0.5, width - 0.5, height - 0.5]]))[:, 0]
    large = (boxes[:, 2:] - boxes[:, :2]).min(axis=1, initial=np.inf) >= MIN_SIDE_PX
    return np.asarray(large & (inside >= MIN_FRACTION_INSIDE))


@dataclass(frozen=True, slots=True, kw_only=True)
class ColourLayoutSettings:
    """Sampling grid, histogram bins and gate of the built-in embedding."""

    n_columns: int = 16  # columns and rows of points at which a box's colour is taken
    n_rows: int = 24
    n_bands: int = 6  # horizontal bands of the box, each with separate histograms; divides `n_rows`
    n_bins: int = 8  # soft bins per histogram
    chroma_span: float = 40.0  # largest distinguished distance of a* and b* from grey, CIELAB units
    # spread_x, spread_y: standard deviations, in widths and heights of the box, of the Gaussian
    # weight of a point about the box's centre: corners show background
    spread_x: float = 0.4
    spread_y: float = 0.35
    max_cosine_distance: float = 0.08  # see `AppearanceModel`

    def __post_init__(self) -> None:
        if self.n_rows % self.n_bands:
            raise ValueError(
                f"n_rows: expected a multiple of n_bands = {self.n_bands}, got {self.n_rows}"
            )


class ColourLayout:
    """The built-in appearance model: lightness, a* and b* of CIELAB in bands from top to bottom.

    In grey images only lightness is used: their a* and b* are equal everywhere and would make all
    boxes similar.

    Bands, bins and weights were tuned on KITTI tracking 0003 and three simulated drives; 0005, with
    only three cars, was not used for that, but `max_cosine_distance` was chosen on all drives.
    Single embeddings are compared, within a class, at least half visible, with boxes jittered by 4
    %. (OSNet x0.25 takes a hundred times as long and was tuned on none of these drives.)

        frames apart (0.1, 0.125 s)       1      5     10     OSNet:    1      5     10
        0005   area under the curve   1.000  0.995  0.967             0.981  0.985  0.967
               same object, 95 % below 0.036  0.050  0.069             0.250  0.286  0.317
        drives area under the curve   0.989  0.975  0.981             0.991  0.976  0.962
               same object, 95 % below 0.059  0.103  0.100             0.236  0.367  0.379

    At `max_cosine_distance`, with a track's gallery, 0 to 9 % of the same objects are rejected and
    11 to 25 % of other objects accepted. Dimming an image to 0.8 stays below it (0.075 for 95 of
    100 boxes), dimming to 0.6 does not.
    """

    def __init__(self, settings: ColourLayoutSettings | None = None) -> None:
        self._settings = settings = settings or ColourLayoutSettings()
        self.max_cosine_distance = settings.max_cosine_distance
        self.notes: tuple[str, ...] = ()
        self._u = (np.arange(settings.n_columns) + 0.5) / settings.n_columns
        self._v = (np.arange(settings.n_rows) + 0.5) / settings.n_rows
        x, y = (self._u - 0.5) / settings.spread_x, (self._v - 0.5) / settings.spread_y
        self._weight = np.exp(-0.5 * (x**2 + y[:, None] ** 2))
        level = (np.arange(_N_LEVELS) + 0.5) * (256 / _N_LEVELS) - 0.5
        chroma = (level - 128.0) / settings.chroma_span / 2 + 0.5
        self._soft_bins = np.stack(
            [_soft_bins(value, settings.n_bins) for value in (level / 255, chroma, chroma)]
        )

    @property
    def n_values(self) -> int:
        """Length D of an embedding."""
        return 3 * self._settings.n_bands * self._settings.n_bins

    def embed(self, image: Image, xyxy_px: FloatArray) -> Descriptors:
        """See `AppearanceModel.embed`; parts outside the image do not count. ValueError: the image
        is not (H, W, 3).
        """
        check_shape("image", image, (None, None, 3))
        embedding = np.zeros((len(xyxy_px), self.n_values), np.float32)
        usable = np.flatnonzero(has_appearance(image, xyxy_px))
        # The largest difference between the colour channels on a coarse grid of pixels.
        blue, green, red = image[::_STEP_PX, ::_STEP_PX].astype(np.int16).reshape(-1, 3).T
        difference = max(np.abs(blue - green).max(initial=0), np.abs(green - red).max(initial=0))
        has_colour = bool(difference > _NEUTRAL)
        for start in range(0, len(usable), _BOX_BLOCK):
            rows = usable[start : start + _BOX_BLOCK]
            embedding[rows] = self._embed(
                image, np.clip(xyxy_px[rows], -_FAR_PX, _FAR_PX), has_colour
            )
        return embedding

    def _embed(self, image: Image, xyxy_px: FloatArray, has_colour: bool) -> Descriptors:
        n, settings = len(xyxy_px), self._settings
        bgr, weight = self._sampled(image, xyxy_px)
        lab = cv2.cvtColor(
            bgr.reshape(n * settings.n_rows, settings.n_columns, 3), cv2.COLOR_BGR2LAB
        )
        # one histogram of all boxes and bands for each channel, whose rows are consecutive
        band = np.arange(n * settings.n_rows) // (settings.n_rows // settings.n_bands)
        first, n_cells = _N_LEVELS * band[:, None], n * settings.n_bands * _N_LEVELS
        parts = []
        for plane, soft_bins in zip(cv2.split(lab), self._soft_bins, strict=True):
            cell = first + plane // (256 // _N_LEVELS)
            counts = np.bincount(cell.ravel(), weight.ravel(), minlength=n_cells)
            parts.append((counts.reshape(-1, _N_LEVELS) @ soft_bins).reshape(n, -1))
        histograms = np.concatenate(parts, axis=1)
        if not has_colour:
            histograms[:, parts[0].shape[1] :] = 0.0
        return unit_rows(np.sqrt(histograms))

    def _sampled(self, image: Image, xyxy_px: FloatArray) -> tuple[Image, FloatArray]:
        """(N, rows, columns, 3) colours at the points of the grid, and their weights, 0 outside the
        image.
        """
        height, width = image.shape[:2]
        left, top, right, bottom = xyxy_px.T[:, :, None]
        x = np.rint(left + (right - left) * self._u).astype(np.int64)
        y = np.rint(top + (bottom - top) * self._v).astype(np.int64)
        inside = ((y >= 0) & (y < height))[:, :, None] & ((x >= 0) & (x < width))[:, None, :]
        bgr = image[y.clip(0, height - 1)[:, :, None], x.clip(0, width - 1)[:, None, :]]
        return bgr, inside * self._weight


def _soft_bins(value: FloatArray, n_bins: int) -> FloatArray:
    """(L, bins) fraction of each value (L,), clipped to 0..1, in each bin, linear between the two
    nearest bins.
    """
    position = np.clip(value, 0.0, 1.0) * (n_bins - 1)
    return np.maximum(1.0 - np.abs(position[:, None] - np.arange(n_bins)), 0.0)
