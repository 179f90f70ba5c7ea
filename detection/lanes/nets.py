"""NetLaneFinder: detection of the ego lane's lines with an ONNX network.

Supported are segmentation (TwinLiteNet), curves (LSTR) and row anchors (Ultra Fast Lane Detection, CULane and TuSimple
heads), which are recognised by the shapes of their outputs (see below). The network's input is the
part of the image that is most similar to its training images. Otherwise LSTR, which was trained with one camera, draws
lines towards the horizon of that camera, with errors of 10 % of the lane width, and TwinLiteNet misses thin lines in
images wider than 16:9.

Decoders of lane networks' outputs into pixels on lines.

    segmentation  [1, 2, h, w] or [1, 1, h, w]      a pixel is on a line if the score of the last channel is the larger
    curves        [1, K, 2] scores, [1, K, 8] rows  LSTR (Liu et al., WACV 2021): y0, y1, k, f, m, n, b, b' with
                                                    x = k / (y - f)^2 + m / (y - f) + n + b y - b', all in 0..1
    row anchors   [1, cells + 1, rows, 4]           Ultra Fast Lane Detection (Qin et al., ECCV 2020): in each of a few
                                                    fixed rows, scores of the cells of four lines; the last = no line

Decoders return pixels of the network's input, with pixel centres at integers, and the line number of each pixel.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.special import softmax

from track_range.detection.lanes.edges import EdgeLaneFinder
from track_range.detection.lanes.ego_lane import EgoLane
from track_range.detection.lanes.lines import NO_BOXES, LaneFinder, LaneLines
from track_range.detection.lanes.markings import Markings, run_middles
from track_range.detection.models.onnx_session import BoundNetwork, ModelError, OnnxSession, Runtime
from track_range.foundation.arrays import FloatArray, FloatArray32, Image, IntArray, check_shape

# (N, 2) pixels on lines and (N,) their line numbers, -1 = unknown
Points = tuple[FloatArray, IntArray]
# of CULane and TuSimple heads in 288 rows, as in the official implementation
ROW_ANCHORS: Mapping[int, FloatArray] = {
    18: np.array(
        [121, 131, 141, 150, 160, 170, 180, 189, 199, 209, 219, 228, 238, 248, 258, 267, 277, 287],
        np.float64,
    ),
    56: np.arange(64.0, 285.0, 4.0),
}
ROW_ANCHOR_LINES = 4
_ANCHOR_IMAGE_ROWS = 288.0  # height of the input that `ROW_ANCHORS` refers to
_N_CURVE_SAMPLES = 40  # pixels per curve
_MIN_CURVE_SCORE = 0.5  # probability of a curve
_ROW_STEP = 2  # neighbouring rows of a mask are redundant
# largest width of a run of line pixels, of the mask's width; stop lines and merging lines are wider
_MAX_RUN = 0.08
_MIN_MASK = 32  # height and width of a mask; smaller outputs are features
_NAME_OF_LINES = re.compile("lane|line|ll")  # in names of outputs


def mask_points(scores: FloatArray32, input_hw: tuple[int, int] | None = None) -> Points:
    """Centres of the runs of line pixels in every second row of scores (channels, h, w), in pixels
    of the input.

    `input_hw` is the size of the network's input, by default the size of the mask.
    """
    if len(scores) == 2:
        on_line = scores[1] > scores[0]
    else:
        is_probability = scores.min() >= 0.0 and scores.max() <= 1.0  # else a logit
        on_line = scores[0] > (0.5 if is_probability else 0.0)
    rows = np.arange(0, on_line.shape[0], _ROW_STEP)
    row, x = run_middles(on_line[rows], widest_px=_MAX_RUN * on_line.shape[1])
    height, width = input_hw or on_line.shape
    scale: FloatArray = np.array([width / on_line.shape[1], height / on_line.shape[0]])
    xy = (np.stack([x, rows[row]], axis=1).astype(np.float64) + 0.5) * scale - 0.5
    return xy, np.full(len(xy), -1, np.int64)


def curve_points(logits: FloatArray32, curves: FloatArray32, input_hw: tuple[int, int]) -> Points:
    """Pixels of the curves (K, 8) whose probability, from logits (K, 2), exceeds
    `_MIN_CURVE_SCORE`.

    x = k / (y - f)^2 + m / (y - f) + n + b y - b'        x, y as fractions of the input size `input_hw`
    """
    good = np.flatnonzero(softmax(logits.astype(np.float64), axis=1)[:, 1] > _MIN_CURVE_SCORE)
    first, last, k, f, m, n, b, b_end = curves[good].astype(np.float64).T[:, :, None]
    # The far 15 % are left out: the curve is least accurate there, and its equation has a pole at y
    # = f.
    fraction = np.linspace(0.0, 0.85, _N_CURVE_SAMPLES)
    y = np.maximum(first, last) - fraction * np.abs(last - first)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = k / (y - f) ** 2 + m / (y - f) + n + b * y - b_end
    inside = np.isfinite(x) & (x >= 0.0) & (x <= 1.0) & (y > f) & (y <= 1.0)
    xy = np.stack([x, y], axis=2)[inside] * np.array([input_hw[1], input_hw[0]]) - 0.5
    return xy, np.broadcast_to(good[:, None], inside.shape)[inside].astype(np.int64)


def row_anchor_points(scores: FloatArray32, input_hw: tuple[int, int]) -> Points:
    """Pixels of lines from scores (cells + 1, rows, lines).

        x = sum over cells c of p(c) (c + 0.5) * cell width,        p = softmax of the scores without the last cell

    Cell c covers x from c to c + 1 cell widths. The official demonstration draws c + 1, which is
    half a cell to the right of the labels.
    """
    n_cells = len(scores) - 1
    cell_px = (input_hw[1] - 1) / (n_cells - 1)
    probability = softmax(scores[:-1].astype(np.float64), axis=0)
    x = (np.einsum("c,crl->rl", np.arange(n_cells) + 0.5, probability)) * cell_px
    is_visible = scores.argmax(axis=0) < n_cells
    y = ROW_ANCHORS[scores.shape[1]] / _ANCHOR_IMAGE_ROWS * input_hw[0]
    row, line = np.nonzero(is_visible)
    return np.stack([x[row, line], y[row]], axis=1), line.astype(np.int64)


def is_row_anchor_shape(shape: tuple[int, ...]) -> bool:
    """Whether an output of this shape belongs to a row-anchor head."""
    return (
        len(shape) == 4
        and shape[1] > 2
        and shape[2] in ROW_ANCHORS
        and shape[3] == ROW_ANCHOR_LINES
    )


# mean and sigma of red, green and blue / 255
_IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
# BGR in LSTR's training
_LSTR = ((0.40789654, 0.44719302, 0.47026115), (0.28863828, 0.27408164, 0.27809835))

_UNSCALED = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
_MAX_VIEWS = 5  # of one image while the row of the horizon is unknown


@dataclass(frozen=True, slots=True, kw_only=True)
class _Family:
    """A family of lane networks."""

    is_rgb: bool  # the channel order is RGB, otherwise BGR
    # mean and sigma of pixels / 255
    scale: tuple[tuple[float, float, float], tuple[float, float, float]]
    sigma_px: float  # standard deviation of a pixel's x in the network's input
    # row in training images, in image heights; None = varied: the whole image is input
    horizon: float | None = None
    # largest distance of the horizon from that row, in image heights, before the view is changed
    aim: float = 0.02
    aspect: float = 16 / 9  # width / height of the view
    input_hw: tuple[int, int] = (360, 640)  # (height, width) of an input of variable size


_SEGMENTATION = _Family(is_rgb=True, scale=_UNSCALED, sigma_px=1.0, horizon=0.47, aim=0.08)
_CURVES = _Family(is_rgb=False, scale=_LSTR, sigma_px=2.0, horizon=0.35)
_ROW_ANCHORS = _Family(is_rgb=True, scale=_IMAGENET, sigma_px=2.0, input_hw=(288, 800))


CLASSICAL = "classical"  # name of the lane finder without a network, `EdgeLaneFinder`


class NetLaneFinder:
    """Detector of lane lines with a network; ModelError if it cannot be read, or is not a known
    lane network.
    """

    def __init__(self, model: Path, runtime: Runtime | None = None) -> None:
        session = OnnxSession(model, runtime)
        self.notes = session.notes
        self._family, self._network, self._decode = _opened(session)
        self._input_hw: tuple[int, int] = self._network.blob.shape[2:]
        self._lane = EgoLane()

    def find(self, image: Image, time_s: float, boxes_px: FloatArray = NO_BOXES) -> LaneLines:
        """The lines in `image`, (H, W, 3) uint8 BGR, taken at `time_s`, outside of the boxes
        (M, 4) of objects; ValueError for another shape.
        """
        check_shape("image", image, (None, None, 3))
        image_hw = (image.shape[0], image.shape[1])
        is_new = self._lane.state is None
        view = self._view(image_hw)
        lines = LaneLines()
        for _ in range(_MAX_VIEWS):
            markings = self._markings(image, view).outside(boxes_px)
            lines = self._lane.update(markings, time_s, image_hw)
            previous, view = view, self._view(image_hw)
            is_aimed = abs(view[0].start - previous[0].start) < self._family.aim * image_hw[0]
            if not is_new or is_aimed or self._lane.state is None:
                break
            self._lane.reset()  # the same image is not independent evidence
        return lines

    def _view(self, image_hw: tuple[int, int]) -> tuple[slice, slice]:
        """Rows and columns of the largest crop with the tracked or typical horizon in the family's
        row, else of all.
        """
        height, width = image_hw
        horizon, aspect = self._family.horizon, self._family.aspect
        if horizon is None:
            return slice(0, height), slice(0, width)
        state = self._lane.state
        x_px, y_px = width / 2, horizon * height
        if state is not None:
            x_px, y_px = state.vanishing_x_px, state.horizon_px
        tallest = min((height - y_px) / (1 - horizon), width / aspect)
        rows = round(float(np.clip(tallest, height / 3, height)))
        columns = min(round(rows * aspect), width)
        top = round(float(np.clip(y_px - horizon * rows, 0, height - rows)))
        left = round(float(np.clip(x_px - columns / 2, 0, width - columns)))
        return slice(top, top + rows), slice(left, left + columns)

    def _markings(self, image: Image, view: tuple[slice, slice]) -> Markings:
        part = image[view]
        pixels = cv2.resize(part, self._input_hw[::-1], interpolation=cv2.INTER_LINEAR)
        mean, deviation = self._family.scale
        for channel in range(3):
            source = pixels[..., 2 - channel if self._family.is_rgb else channel]
            factor = np.float32(1 / 255 / deviation[channel])
            shift = np.float32(mean[channel] / deviation[channel])
            self._network.blob[0, channel] = source * factor - shift
        xy, line = self._decode(self._network.run())
        scale = np.array([part.shape[1] / self._input_hw[1], part.shape[0] / self._input_hw[0]])
        xy_px = (xy + 0.5) * scale - 0.5 + np.array([view[1].start, view[0].start])
        return Markings(xy_px, line, self._family.sigma_px * float(scale[0]))


_Decode = Callable[[Sequence[FloatArray32]], Points]


def _opened(session: OnnxSession) -> tuple[_Family, BoundNetwork, _Decode]:
    _, channels, height, width = session.input_shape
    if channels != 3:
        sides = ", ".join("any" if side is None else str(side) for side in session.input_shape)
        raise ModelError(
            f"{session.path}: expected a lane network with an input [1, 3, height, "
            f"width], got [{sides}]."
        )
    if height and width:
        return _matched(session, (height, width))
    # variable size: the network fails with the size of another family
    for family in (_SEGMENTATION, _ROW_ANCHORS):
        input_hw = (height or family.input_hw[0], width or family.input_hw[1])
        try:
            return _matched(session, input_hw)
        except ModelError as error:
            last = error
    raise last


def _matched(
    session: OnnxSession, input_hw: tuple[int, int]
) -> tuple[_Family, BoundNetwork, _Decode]:
    """The network for inputs of this size, and its family and decoder, by the shapes of its
    outputs.
    """
    network = session.bound(input_hw)
    shapes = network.output_shapes
    for family, decoder_of in (
        (_CURVES, _curve_decoder),
        (_ROW_ANCHORS, _row_anchor_decoder),
        (_SEGMENTATION, _mask_decoder),
    ):
        decode = decoder_of(shapes, input_hw)
        if decode is not None:
            return family, network, decode
    outputs = ", ".join(f"{name} {list(shape)}" for name, shape in shapes.items())
    raise ModelError(
        f"{session.path}: expected a lane network with masks [1, 2, h, w], curves [1, K, 2] and "
        "[1, K, 8] (LSTR), or row anchors [1, 201, 18, 4] or [1, 101, 56, 4]; got outputs "
        f"{outputs}."
    )


_Shapes = Mapping[str, tuple[int, ...]]  # of outputs, by name, in the network's order


def _curve_decoder(shapes: _Shapes, input_hw: tuple[int, int]) -> _Decode | None:
    """Decoder of scores [1, K, 2] and curves [1, K, 8]; None without them."""
    rows = {i: shape for i, shape in enumerate(shapes.values()) if len(shape) == 3}
    scores = next((i for i, shape in rows.items() if shape[2] == 2), None)
    curves = next((i for i, shape in rows.items() if shape[2] == 8), None)
    if scores is None or curves is None or rows[scores][1] != rows[curves][1]:
        return None
    return lambda outputs: curve_points(outputs[scores][0], outputs[curves][0], input_hw)


def _row_anchor_decoder(shapes: _Shapes, input_hw: tuple[int, int]) -> _Decode | None:
    """Decoder of row anchors; None without them."""
    heads = [i for i, shape in enumerate(shapes.values()) if is_row_anchor_shape(shape)]
    if not heads:
        return None
    return lambda outputs: row_anchor_points(outputs[heads[0]][0], input_hw)


def _mask_decoder(shapes: _Shapes, input_hw: tuple[int, int]) -> _Decode | None:
    """Decoder of a mask [1, 1, h, w] or [1, 2, h, w], that of lines if there are several; None
    without one.
    """
    masks = {
        name: i
        for i, (name, shape) in enumerate(shapes.items())
        if len(shape) == 4 and shape[1] in (1, 2) and min(shape[2:]) >= _MIN_MASK
    }
    named = [i for name, i in masks.items() if _NAME_OF_LINES.search(name.lower())]
    candidates = named or list(masks.values())
    if not candidates:
        return None
    mask = candidates[-1]  # the last one is after that of the drivable area
    return lambda outputs: mask_points(outputs[mask][0], input_hw)


def open_lane_finder(name_or_path: str, runtime: Runtime | None = None) -> LaneFinder:
    """`EdgeLaneFinder` for `CLASSICAL`, otherwise a `NetLaneFinder` with the network at this
    path.
    """
    if name_or_path == CLASSICAL:
        return EdgeLaneFinder()
    return NetLaneFinder(Path(name_or_path), runtime)
