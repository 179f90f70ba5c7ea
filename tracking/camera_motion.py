"""Camera motion: how far background moves from one frame to the next, so that predicted boxes can move with it.

    now = [[a, -b], [b, a]] before + t       a = s cos r, b = s sin r: scale s, roll r, and t for yaw and pitch

Corners of the frame before, outside its boxes, are tracked by pyramidal Lucas-Kanade (Bouguet, 2000) on a small grey
image. Where nearly all are inliers of one similarity, that is the motion. On a road they are not: driving makes near
objects flow away from the vanishing point v, each by its own nearness z,

    flow = t + b [-y, x] + z ([x, y] - v)

which a similarity takes for zoom and shift, though a car ahead does neither. So t and b are fitted to the flow across
the direction from the image's centre, where z matters only as z v, and v is fitted along: what is left is yaw, pitch
and roll. On a KITTI odometry drive (poses known) the horizon is met to 0.7 px rms; by robust similarities to 13-23 px,
and by no motion at all to 1.1 px.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import are_valid_boxes
from track_range.foundation.arrays import BoolArray, FloatArray, Image, check_shape
from track_range.foundation.robust_statistics import MAD_TO_SIGMA

FeatureArray = npt.NDArray[np.float32]
ComplexArray = npt.NDArray[np.complex128]

_CELL_PX = 8
"""Side of the cells, small pixels, in which boxes are marked: boxes grow by up to one, so that few windows overlap."""
_GRID_PX = 8
"""Side of the squares of the half-size image that give one feature each, so 16 small pixels: two cells."""
_FLAT = 1e-5
"""Least corner quality (OpenCV's smaller eigenvalue), above the noise of a textureless area."""
_MIN_SIDE_PX = 32
"""Least side of a small image, which has room for windows."""
_N_SIMILARITY, _N_TURN = 4, 5
"""Rounds of reweighting; one more moves the result by 0.02 px at most in the median of real drives."""
_TUKEY = 4.685
"""Standard deviations from which on a residual has no weight (95 % efficiency on normal noise)."""
_NEAR_CENTRE = 0.01
"""Share of the long side; features nearer to the centre have no direction from it to speak of."""
_RIDGE = np.diag([1e-9, 1e-9, 1e-9, 0.01, 0.01])
"""Pulls v to the centre; small beside the sum of z^2 wherever there is parallax to fit v with."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraMotionSettings:
    """How features are detected and tracked, and which motions are plausible; "small pixels" are the small image's.

    Attributes:
        long_side_px: the image is halved until neither side is longer.
        n_features: tracked at most.
        min_quality: of a corner, as a share of the best corner's.
        window_px: side of the tracked window, small pixels.
        n_halvings: of the small image, for motions larger than the window.
        noise_px: standard deviation of a tracked feature, small pixels.
        max_residual_px: of an inlier, small pixels.
        min_inliers: of a motion.
        min_inlier_share: of a motion, as a share of the tracked features.
        similarity_share: inlier share from which on the similarity is the motion, zoom included.
        min_spread: of the features around their mean, rms, as a share of the long side; below, only t is fitted.
        max_scale: largest plausible scale; its inverse is the smallest.
        max_roll_rad: largest plausible roll.
        max_shift: largest plausible shift of the image's centre, as a share of width and of height.
    """

    long_side_px: int = 640
    n_features: int = 100
    min_quality: float = 0.01
    window_px: int = 9
    n_halvings: int = 4
    noise_px: float = 0.1
    max_residual_px: float = 0.5
    min_inliers: int = 12
    min_inlier_share: float = 0.4
    similarity_share: float = 0.8
    min_spread: float = 0.1
    max_scale: float = 1.25
    max_roll_rad: float = 0.2
    max_shift: float = 0.25


@dataclass(frozen=True, slots=True)
class _View:
    """One frame: its size, its small grey image, and (N, 2) float32 features in small pixels."""

    image_hw: tuple[int, int]
    grey: Image
    features: FeatureArray


class CameraMotion:
    """Background motion from frame to frame of one stream; the state belongs to the instance."""

    def __init__(self, settings: CameraMotionSettings | None = None) -> None:
        self._settings = settings or CameraMotionSettings()
        self._before: _View | None = None

    def update(self, image: Image, xyxy_px: FloatArray) -> FloatArray:
        """(2, 3) `now_from_before`: maps pixels of the frame before to this frame's; the same input, the same output.

        The identity for the first frame, after a change of size, and where there are too few inliers or the motion is
        not plausible.

        Args:
            image: (H, W, 3) BGR, only read.
            xyxy_px: (N, 4) boxes of road users in this frame, which are not background; invalid ones are ignored.

        Raises:
            ValueError: another shape.
        """
        check_shape("image", image, (None, None, 3))
        check_shape("xyxy_px", xyxy_px, (None, 4))
        before, self._before = self._before, None
        image_hw = (image.shape[0], image.shape[1])
        n_halved = (max(image_hw) // (self._settings.long_side_px + 1)).bit_length()
        if min(image_hw) >> n_halved < _MIN_SIDE_PX:
            return np.eye(2, 3)
        grey = _small_grey(image, n_halved)
        masked = _masked_cells(xyxy_px, grey.shape, _CELL_PX << n_halved)
        self._before = _View(image_hw, grey, _features(grey, masked, self._settings))
        if before is None or before.image_hw != image_hw:
            return np.eye(2, 3)
        was, now = _tracked(before, grey, masked, self._settings)
        return _in_full_pixels(_motion(was, now, grey.shape, self._settings), 1 << n_halved)


def _small_grey(image: Image, n_halved: int) -> Image:
    """The green channel halved so many times: means of 2x2 pixels do not alias, green costs less than a mix."""
    grey = np.asarray(cv2.extractChannel(image, 1), np.uint8)
    for _ in range(n_halved):
        grey = _halved(grey)
    return grey


def _halved(image: Image) -> Image:
    height, width = image.shape[0] // 2, image.shape[1] // 2
    even = image[: 2 * height, : 2 * width]
    return np.asarray(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _masked_cells(xyxy_px: FloatArray, grey_hw: tuple[int, ...], cell_px: int) -> BoolArray:
    """(rows, columns) cells of the small image, `cell_px` full pixels wide, that a box touches; no loop over boxes."""
    n_rows, n_columns = (-(-side // _CELL_PX) for side in grey_hw)
    cells = (xyxy_px[are_valid_boxes(xyxy_px)] + 0.5) / cell_px
    cells = np.clip(cells, 0, [n_columns, n_rows, n_columns, n_rows])
    left, top = np.floor(cells[:, :2]).astype(np.int64).T
    right, bottom = np.ceil(cells[:, 2:]).astype(np.int64).T
    steps = np.zeros((n_rows + 1, n_columns + 1), np.int64)
    for row, column, step in ((top, left, 1), (top, right, -1), (bottom, left, -1), (bottom, right, 1)):
        np.add.at(steps, (row, column), step)
    return np.asarray(steps.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0)


def _features(grey: Image, masked: BoolArray, settings: CameraMotionSettings) -> FeatureArray:
    """(N, 2) the best corners, one per square, outside masked cells.

    Detected at half size, since windows of twice the size track them; a grid is faster than OpenCV's sorted choice.
    """
    quality = cv2.cornerMinEigenVal(_halved(grey), 3)
    n_rows, n_columns = (side // _GRID_PX for side in quality.shape)
    whole = quality[: n_rows * _GRID_PX, : n_columns * _GRID_PX].reshape(n_rows, _GRID_PX, n_columns, _GRID_PX)
    squares = whole.swapaxes(1, 2).reshape(-1, _GRID_PX**2)
    place = squares.argmax(axis=1)
    best = squares[np.arange(len(squares)), place]
    y, x = np.divmod(place, _GRID_PX)
    row, column = np.divmod(np.arange(len(squares)), n_columns)
    corners = 2 * np.stack([column * _GRID_PX + x, row * _GRID_PX + y], axis=1) + 0.5
    best[_are_masked(corners, masked)] = 0.0
    chosen = np.argsort(-best, kind="stable")[: settings.n_features]
    good = best[chosen] > max(settings.min_quality * float(best.max(initial=0.0)), _FLAT)
    return np.asarray(corners[chosen[good]], np.float32)


def _are_masked(points: FloatArray, masked: BoolArray) -> BoolArray:
    """(N,) which points of the small image, (N, 2), lie in a masked cell."""
    cells = (points / _CELL_PX).astype(np.int64)
    return np.asarray(masked[cells[:, 1], cells[:, 0]])


def _tracked(
    before: _View, grey: Image, masked: BoolArray, settings: CameraMotionSettings
) -> tuple[FloatArray, FloatArray]:
    """(N, 2), (N, 2) where features were and are, small pixels: those tracked, in the image and not masked."""
    if len(before.features) == 0:
        return np.zeros((0, 2)), np.zeros((0, 2))
    side, stop = settings.window_px, (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)
    start = np.empty_like(before.features)
    points, found, _ = cv2.calcOpticalFlowPyrLK(
        before.grey, grey, before.features, start, winSize=(side, side), maxLevel=settings.n_halvings, criteria=stop
    )
    was, now = before.features.astype(np.float64), np.asarray(points, np.float64).reshape(-1, 2)
    height, width = grey.shape
    inside = (now >= 0).all(axis=1) & (now[:, 0] <= width - 1) & (now[:, 1] <= height - 1)
    good = inside & (found.reshape(-1) > 0)
    good[good] = ~_are_masked(now[good], masked)
    return was[good], now[good]


def _motion(was: FloatArray, now: FloatArray, grey_hw: tuple[int, ...], settings: CameraMotionSettings) -> FloatArray:
    """(2, 3) in small pixels: the similarity of all, else yaw, pitch and roll, else the identity."""
    if len(was) < settings.min_inliers:
        return np.eye(2, 3)
    long_side_px, centre = max(grey_hw), complex(grey_hw[1] - 1, grey_hw[0] - 1) / 2
    points, flow = _complex(was) - centre, _complex(now - was)
    turn, shift, inliers = _similarity(points, flow, settings, min_spread_px=settings.min_spread * long_side_px)
    if inliers.mean() < settings.similarity_share:
        turn, shift, inliers = _turn(points, flow, settings, near_px=_NEAR_CENTRE * long_side_px)
    enough = inliers.sum() >= settings.min_inliers and inliers.mean() >= settings.min_inlier_share
    if not (enough and _is_plausible(turn, shift, grey_hw, settings)):
        return np.eye(2, 3)
    origin = shift + centre - turn * centre
    return np.array([[turn.real, -turn.imag, origin.real], [turn.imag, turn.real, origin.imag]])


def _complex(xy: FloatArray) -> ComplexArray:
    """(N, 2) -> (N,) x + iy, in which a similarity is `turn` * point + `shift`."""
    return np.asarray(xy[:, 0] + 1j * xy[:, 1])


def _median(values: FloatArray) -> float:
    """The upper median; numpy's own takes ten times as long for so few values."""
    return float(np.sort(values)[len(values) // 2])


def _weights(residual_px: FloatArray, noise_px: float) -> FloatArray:
    """(N,) Tukey's, of residuals (N,) >= 0, against their own spread, or against the noise where they are smaller."""
    limit_px = _TUKEY * max(MAD_TO_SIGMA * _median(residual_px), noise_px)
    return np.asarray((1 - np.minimum(residual_px / limit_px, 1) ** 2) ** 2)


def _similarity(
    points: ComplexArray, flow: ComplexArray, settings: CameraMotionSettings, *, min_spread_px: float
) -> tuple[complex, complex, BoolArray]:
    """Robust similarity `turn`, `shift` and (N,) which features are inliers; least squares in closed form."""
    growth, shift = 0j, complex(_median(flow.real), _median(flow.imag))
    for _ in range(_N_SIMILARITY):
        weight = _weights(np.abs(growth * points + shift - flow), settings.noise_px)
        weight /= weight.sum()
        mean, mean_flow = weight @ points, weight @ flow
        off = points - mean
        spread_px2 = float(weight @ (off.real**2 + off.imag**2))
        spread_enough = spread_px2 >= min_spread_px**2
        growth = complex((weight * off.conj()) @ (flow - mean_flow)) / spread_px2 if spread_enough else 0j
        shift = complex(mean_flow - growth * mean)
    inliers = np.abs(growth * points + shift - flow) <= settings.max_residual_px
    return 1 + growth, shift, np.asarray(inliers)


def _turn(
    points: ComplexArray, flow: ComplexArray, settings: CameraMotionSettings, *, near_px: float
) -> tuple[complex, complex, BoolArray]:
    """Yaw, pitch and roll as `turn` (of size 1) and `shift`, and (N,) which are inliers: none if t is not determined.

    Across the direction from the centre the flow is t + b r - z v: linear in t, b and v once z is known, and z is the
    flow along that direction, less t, over r. Features on one line from the centre do not determine t along it.
    """
    radius = np.maximum(np.abs(points), near_px)
    direction = points / radius
    turned = flow * direction.conj()  # real part along, imaginary part across
    across = np.stack([-direction.imag, direction.real], axis=1)
    shift = complex(_median(flow.real), _median(flow.imag))
    solution = np.array([shift.real, shift.imag, 0.0, 0.0, 0.0])
    columns = np.empty((len(points), 5))
    columns[:, :2], columns[:, 2] = across, radius
    for _ in range(_N_TURN):
        nearness = (turned - shift * direction.conj()).real / radius
        columns[:, 3:] = -nearness[:, None] * across
        weighted = columns * _weights(np.abs(turned.imag - columns @ solution), settings.noise_px)[:, None]
        covariance = np.linalg.inv(weighted.T @ columns + _RIDGE)
        solution = covariance @ (weighted.T @ turned.imag)
        shift = complex(solution[0], solution[1])
    shift_sigma_px = settings.noise_px * float(np.sqrt(covariance[0, 0] + covariance[1, 1]))
    inliers = (np.abs(turned.imag - columns @ solution) <= settings.max_residual_px) & (
        shift_sigma_px <= settings.max_residual_px
    )
    turn = complex(1.0, solution[2])
    return turn / abs(turn), shift, np.asarray(inliers)


def _is_plausible(turn: complex, shift: complex, grey_hw: tuple[int, ...], settings: CameraMotionSettings) -> bool:
    near = abs(shift.real) <= settings.max_shift * grey_hw[1] and abs(shift.imag) <= settings.max_shift * grey_hw[0]
    rolled_rad = abs(np.angle(turn))
    return bool(
        near and 1 / settings.max_scale <= abs(turn) <= settings.max_scale and rolled_rad <= settings.max_roll_rad
    )


def _in_full_pixels(small: FloatArray, factor: int) -> FloatArray:
    """A motion of small pixels as one of the image's: full = factor * small + (factor - 1) / 2."""
    offset = np.full(2, (factor - 1) / 2)
    return np.column_stack([small[:, :2], factor * small[:, 2] + offset - small[:, :2] @ offset])
