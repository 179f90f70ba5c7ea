r"""PatchScales: growth of the image of each track since a key frame, by registration of patches
with scale.

A patch is the inner part of a box, sampled on a grid of fixed size from the level of the image
pyramid whose pixels are as far apart as the grid's points. The template T of a track, from its key
frame, is aligned with the current image I by the inverse compositional algorithm (Baker and
Matthews, Lucas-Kanade 20 years on, IJCV 2004), with gain and offset:

    I(c + t + s x) = g T((1 + ds) x + dt) + b       minimised over dt, ds, g, b with Cauchy weights of the residuals
    s <- s / (1 + ds),   t <- t - s dt              s: width and height now / those in the key frame

First only t is estimated, on the next coarser level. Points that a nearer box covers, in the key
frame or now, and points outside the image have no weight. The covariance of log s follows from
least squares, with floors for other errors:

    cov log s = (_FIT r)^2 (A^T W A)^-1 / g^2 + diag(_FLOOR_PX / half extent)^2 + (_DEPTH log s)^2

r is the residual; _DEPTH is the relative difference of the growth at other depths of the object.
The growth is the weighted mean of both estimates. The side of a vehicle beside the camera's axis
grows up to twice as fast in width, since the bearing of its ends differs: its fraction of the
width, for traffic along the road, is the sigma of that growth.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, Image, IntArray
from track_range.foundation.sparse_flow import halved, small_grey
from track_range.foundation.track_state import TrackState
from track_range.ranging.filtering.lateral_motion import LENGTH_M
from track_range.ranging.measurement.growth import Growth
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.tracking.tracks import Tracks

_GRID = 20  # points of a patch along each side
# fraction of the width and height of a box that is its patch, so that little background is in it
_INNER = 0.8
_MIN_SIDE_PX, _N_LEVELS = 8.0, 5  # smallest side of a box, and levels of the image pyramid
_N_COARSE, _N_FINE = 2, 4  # iterations on the coarser level, and on that of the patch
_SCALES = (0.3, 3.0)  # limits of s
# typical width by road class, seen from behind
WIDTH_M = np.array([0.5, 0.5, 1.7, 0.7, 2.5, 2.4, 0.3, 0.6])
_GAIT = np.array([0.1, 0.1, 0.0, 0.05, 0.0, 0.0, 0.0, 0.0])  # sigma of the log width: limbs
# largest step of t in an iteration, as a fraction of the patch's half extent; that of s is a third
_MAX_STEP = 0.3
_CAUCHY = 2.0  # residual with half the weight, in robust standard deviations
_NOISE_GREY = 0.5  # smallest standard deviation of residuals, of the camera's noise and rounding
# of accepted alignments; mean weight of the points
_MIN_CORRELATION, _MIN_WEIGHT, _MAX_SIGMA = 0.8, 0.3, 0.1
# largest distance of the patch from the middle of its box, as a fraction of the box
_MAX_SHIFT = 0.25
_MARGIN = 0.5  # of the box around it in which the search samples the image, as a fraction of it
_CONVERGED = 0.01, 0.5  # largest last step of s: absolute, or in standard deviations
_FIT, _FLOOR_PX, _DEPTH = 2.0, 0.05, 0.05  # see above
# longest time since the key frame, and largest growth since then
_MAX_AGE_S, _MAX_LOG_RATIO = 1.0, 0.25
_SMALL = 0.01  # steps of all patches, in points of the grid, that end the iterations
# between two measurements of a track, after its key frame and later: their errors are alike
_INTERVALS_S = 0.09, 0.19
_MAX_GAP_S = 0.5  # longest time without a measurement

_LINE = np.linspace(-1.0, 1.0, _GRID, dtype=np.float32)
_X, _Y = np.tile(_LINE, _GRID), np.repeat(_LINE, _GRID)  # (P,) points, in half extents
_POINTS = np.stack([_X, _Y])[:, None]  # (2, 1, P)
# every second point, for the coarser level
_COARSE = np.arange(_GRID**2).reshape(_GRID, _GRID)[::2, ::2].ravel()
_COARSE_POINTS = np.ascontiguousarray(_POINTS[..., _COARSE])


class _Key(NamedTuple):
    """Key frames of N tracks and the alignment of the last frame: the rows of `TrackState`, in this
    order.
    """

    template: FloatArray  # (P, N)
    weight: FloatArray  # (P, N) 1 = in the image and not covered by a nearer box
    centre_px: FloatArray  # (2, N) c
    half_px: FloatArray  # (2, N) half extents of the patch
    level: FloatArray  # (N,)
    shift_px: FloatArray  # (2, N) t
    scale: FloatArray  # (2, N) s
    box_px: FloatArray  # (2, N) middle of the box
    key_s: FloatArray  # (N,) time of the key frame
    time_s: FloatArray  # (N,) time of the last measurement

    @classmethod
    def of(cls, state: FloatArray) -> _Key:
        P = _GRID**2
        template, weight, rest = state[:P], state[P : 2 * P], state[2 * P :]
        return cls(
            template, weight, rest[:2], rest[2:4], rest[4], rest[5:7], rest[7:9], rest[9:11],
            rest[11], rest[12],
        )  # fmt: skip


_N_ROWS = 2 * _GRID**2 + 13


class _Pyramid:
    """A part of an image and of its halved copies side by side, so that patches of all levels are
    sampled at once; the rest of them is 0.
    """

    def __init__(self, image: Image, part_px: tuple[int, int, int, int]) -> None:
        """`part_px` are left, top, right and bottom as of `_part_px`."""
        left, top, right, bottom = part_px
        part = small_grey(image[top:bottom, left:right], 0)
        height, width = image.shape[:2]
        self._pixels = np.zeros((height, width + width // 2), np.uint8)
        places: list[tuple[int, int, int, int]] = []
        x, y = 0, 0
        while len(places) < _N_LEVELS and min(height, width) >= _GRID:
            (n_rows, n_columns), row, column = part.shape, y + top, x + left
            self._pixels[row : row + n_rows, column : column + n_columns] = part
            places.append((x, y, width - 1, height - 1))
            if min(part.shape) < 2:
                break
            x, y = (
                self._pixels.shape[1] - self._pixels.shape[1] // 3,
                0 if len(places) == 1 else y + height,
            )
            part = halved(part)
            left, top, width, height = left // 2, top // 2, width // 2, height // 2
        self._places = np.array(places, np.float32).reshape(-1, 4)

    @property
    def n_levels(self) -> int:
        """Number of levels; 0 = the image is smaller than a patch."""
        return len(self._places)

    def sampled(
        self, centre_px: FloatArray, extent_px: FloatArray, level: IntArray, points: FloatArray32
    ) -> tuple[FloatArray32, BoolArray]:
        """(N, P) values of patches (N, 2) with half extents (N, 2) in px of the image, and which
        points are inside.

        `points` (2, 1, P) are x and y of the points in half extents.
        """
        level = np.minimum(level, len(self._places) - 1)
        factor = 0.5**level
        # (4, N, 1) first column and row of the level among the pixels, and the last ones in it
        place = self._places[level].T[:, :, None]
        centre = ((centre_px.T + 0.5) * factor - 0.5).astype(np.float32, order="C")[:, :, None]
        extent = (extent_px.T * factor).astype(np.float32, order="C")[:, :, None]
        xy = centre + extent * points
        nearest = np.minimum(np.maximum(xy, 0), place[2:])
        is_x_inside, is_y_inside = nearest == xy
        x, y = nearest + place[:2]
        values = np.asarray(cv2.remap(self._pixels, x, y, cv2.INTER_LINEAR), np.float32)
        return values, is_x_inside & is_y_inside


_NO_PYRAMID = _Pyramid(np.zeros((1, 1), np.uint8), (0, 0, 1, 1))


def _part_px(xyxy_px: FloatArray, image_hw: tuple[int, int]) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of the part of an image in which patches of boxes (N, 4) are
    sought; those within the image are multiples of the pixels of the coarsest level.
    """
    pixel, last_px = 1 << (_N_LEVELS - 1), np.array([image_hw[1] - 1, image_hw[0] - 1])
    low_px, high_px = xyxy_px[:, :2], xyxy_px[:, 2:]
    margin_px = _MARGIN * (high_px - low_px)
    first_px = np.clip((low_px - margin_px).min(axis=0), 0, last_px)
    end_px = np.clip((high_px + margin_px).max(axis=0) + pixel, 0, last_px)
    left, top = (first_px // pixel * pixel).astype(int).tolist()
    right, bottom = ((end_px // pixel + 1) * pixel).astype(int).tolist()
    return left, top, right, bottom


def side_fraction(camera: PinholeCamera, middle_px: FloatArray, class_id: IntArray) -> FloatArray:
    """(N,) fraction of the width of objects along the road that is their side, by the middle
    columns of their boxes.
    """
    side_m = np.abs(middle_px - camera.cx_px) / camera.fx_px * LENGTH_M[class_id]
    return np.asarray(side_m / (side_m + WIDTH_M[class_id]))


class PatchScales:
    """Measures the growth of tracks in the images of one camera."""

    def __init__(self, camera: PinholeCamera) -> None:
        """Start without key frames; boxes and images belong to `camera` (undistorted)."""
        self._camera = camera
        self._tracks = TrackState(np.full(_N_ROWS, np.nan))

    def measure(self, tracks: Tracks, image: Image, time_s: float) -> Growth:
        """Growth of N tracks since their key frames, in the image at `time_s`, BGR or grey; NaN for
        predicted boxes.
        """
        log_ratio, sigma = np.full((2, len(tracks)), np.nan)
        sides_px = tracks.xyxy_px[:, 2:] - tracks.xyxy_px[:, :2]
        middle_px = (tracks.xyxy_px[:, 2:] + tracks.xyxy_px[:, :2]) / 2
        is_usable = tracks.observed & (np.minimum.reduce(sides_px, axis=1) >= _MIN_SIDE_PX)
        state = self._tracks.get(tracks.track_id)
        last = _Key.of(state)
        is_usable &= ~(time_s - last.time_s < np.where(last.time_s == last.key_s, *_INTERVALS_S))
        # without a track that is due, the image is not needed
        pyramid = _NO_PYRAMID
        if is_usable.any():
            part_px = _part_px(tracks.xyxy_px[is_usable], image.shape[:2])
            pyramid = _Pyramid(image, part_px)
        is_usable &= pyramid.n_levels > 0
        rows = (is_usable & (time_s - last.time_s <= _MAX_GAP_S)).nonzero()[0]
        if len(rows):
            key = _Key.of(state[:, rows])
            start_px = key.shift_px.T + middle_px[rows] - key.box_px.T
            shift_px, scale, covariance, is_good = _aligned(
                pyramid, key, start_px, tracks.xyxy_px, rows
            )
            is_good &= (
                np.abs(key.centre_px.T + shift_px - middle_px[rows]) < _MAX_SHIFT * sides_px[rows]
            ).all(axis=1)
            growth = self._growth(
                np.log(scale), covariance, key, middle_px[rows], tracks.class_id[rows]
            )
            is_good &= growth[1] < _MAX_SIGMA
            log_ratio[rows], sigma[rows] = np.where(is_good, growth, np.nan)
            state[-8:-2, rows] = np.concatenate([shift_px.T, scale.T, middle_px[rows].T])
            state[-1, rows] = time_s
        is_old = (time_s - last.key_s >= _MAX_AGE_S - 1e-6) | (np.abs(log_ratio) > _MAX_LOG_RATIO)
        is_key = is_usable & (np.isnan(log_ratio) | is_old)
        new = is_key.nonzero()[0]
        if len(new):
            centre_px, half_px = middle_px[new], _INNER / 2 * sides_px[new]
            spacing_px = 2 * half_px.max(axis=1) / (_GRID - 1)
            nearest = np.maximum(np.rint(np.log2(spacing_px)), 0)
            level = np.minimum(nearest, pyramid.n_levels - 1).astype(np.int64)
            template, is_inside = pyramid.sampled(centre_px, half_px, level, _POINTS)
            weight = is_inside & ~covered_points(centre_px, half_px, tracks.xyxy_px, new)
            start = np.array([[0.0, 0.0, 1.0, 1.0]] * len(new))
            times = np.full((len(new), 2), time_s)
            columns = [
                template,
                weight,
                centre_px,
                half_px,
                level[:, None],
                start,
                centre_px,
                times,
            ]
            state[:, new] = np.concatenate(columns, axis=1).T
        self._tracks.put(
            tracks.track_id, state, keep_known=time_s - self._tracks.known[-1] <= _MAX_GAP_S
        )
        return Growth(log_ratio, sigma, is_key)

    def _growth(
        self,
        log_s: FloatArray,
        covariance: FloatArray,
        key: _Key,
        middle_px: FloatArray,
        class_id: IntArray,
    ) -> tuple[FloatArray, FloatArray]:
        """(N,) growth and standard deviation from log s (N, 2) and its covariance (N, 2, 2)."""
        grown, side = log_s[:, 1], side_fraction(self._camera, middle_px[:, 0], class_id)
        C = covariance + ((_DEPTH * grown) ** 2)[:, None, None]
        C[:, 0, 0] += (side * grown) ** 2 + _GAIT[class_id] ** 2
        C[:, [0, 1], [0, 1]] += (_FLOOR_PX / key.half_px.T) ** 2
        weight = np.linalg.inv(C).sum(axis=1)
        total = weight.sum(axis=1)
        return (weight * log_s).sum(axis=1) / total, 1 / np.sqrt(total)


def _aligned(
    pyramid: _Pyramid, key: _Key, shift_px: FloatArray, xyxy_px: FloatArray, rows: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Shift t (N, 2) and scales s (N, 2), covariance of log s (N, 2, 2), and whether the alignment
    is accepted.

    The N patches belong to the boxes `rows` (N,) of `xyxy_px`; the search starts from the shift
    `shift_px` (N, 2).
    """
    n, P = len(rows), _GRID**2
    half_px, centre_px, s, t = key.half_px.T, key.centre_px.T, key.scale.T, shift_px
    T, step_px = key.template.T.astype(np.float32), 2 * half_px / (_GRID - 1)
    T_x, T_y = template_slopes(T)
    contrast = T - np.add.reduce(T, axis=1, keepdims=True) / P
    # t in points, s in half extents
    A = np.empty((n, 6, P), np.float32)
    A[:, 0], A[:, 1], A[:, 2], A[:, 3], A[:, 4], A[:, 5] = T_x, T_y, T_x * _X, T_y * _Y, contrast, 1
    unit = np.concatenate([step_px, step_px / half_px], axis=1)
    limit = np.concatenate([_MAX_STEP * half_px, np.full((n, 2), _MAX_STEP / 3)], axis=1)
    level = key.level.astype(np.int64)
    weight = np.asarray(
        key.weight.T * ~covered_points(centre_px + t, s * half_px, xyxy_px, rows), np.float32
    )
    for is_coarse, n_steps in ((True, _N_COARSE), (False, _N_FINE)):
        A_now, w_now, points = A, weight, _POINTS
        if is_coarse:  # only of t
            A_now = np.ascontiguousarray(A[:, [0, 1, 4, 5]][:, :, _COARSE])
            w_now, points = np.ascontiguousarray(weight[:, _COARSE]), _COARSE_POINTS
        n_terms = A_now.shape[1]
        k, damping = n_terms - 2, 1e-3 * np.eye(n_terms)
        unit_now, limit_now = unit[:, :k], limit[:, :k]
        w = w_now
        for _ in range(n_steps):
            now, is_inside = pyramid.sampled(centre_px + t, s * half_px, level + is_coarse, points)
            W = w * is_inside
            AW = A_now * W[:, None]
            total = np.add.reduce(W, axis=1) + 1.0
            H = (AW @ A_now.transpose(0, 2, 1)).astype(np.float64) + damping
            x = np.linalg.solve(H, (AW @ now[..., None]).astype(np.float64))[..., 0]
            r = now - (x[:, None].astype(np.float32) @ A_now)[:, 0]
            noise = _NOISE_GREY + 1.25 * np.add.reduce(W * np.abs(r), axis=1) / total
            w = w_now / (1 + (r / (_CAUCHY * noise[:, None])) ** 2)
            g = np.maximum(x[:, -2:-1], 0.1)
            change = np.minimum(np.maximum(x[:, :k] * unit_now / g, -limit_now), limit_now)
            if not is_coarse:
                s = np.minimum(np.maximum(s / (1 + change[:, 2:]), _SCALES[0]), _SCALES[1])
            t = t - s * change[:, :2]
            if (np.abs(change) < _SMALL * unit_now).all():
                break
    residual = (W * r * r).sum(axis=1) / total
    signal = g[:, 0] ** 2 * (W * contrast * contrast).sum(axis=1) / total
    # Points that are closer than the pixels of the level share their noise.
    per_pixel = np.maximum(2.0 ** level[:, None] / step_px, 1.0).prod(axis=1)
    unit = unit[:, 2:] / g
    covariance = np.linalg.inv(H)[:, 2:4, 2:4] * unit[:, :, None] * unit[:, None]
    covariance *= (_FIT**2 * residual * per_pixel)[:, None, None]
    sigma = np.sqrt(covariance[:, [0, 1], [0, 1]])
    is_good = (np.abs(change[:, 2:]) < np.maximum(_CONVERGED[0], _CONVERGED[1] * sigma)).all(axis=1)
    is_good &= (signal > _MIN_CORRELATION**2 * (signal + residual)) & (
        np.add.reduce(W, axis=1) > _MIN_WEIGHT * P
    )
    return t, s, covariance, is_good


def template_slopes(template: FloatArray32) -> tuple[FloatArray32, FloatArray32]:
    """(N, P) slopes of templates (N, P) per point to the right and down: central differences, and
    one-sided ones at the edges.
    """
    T = template.reshape(-1, _GRID, _GRID)
    across, down = np.empty_like(T), np.empty_like(T)
    for slope, axis in ((across, 2), (down, 1)):
        values, slope = T.swapaxes(axis, 2), slope.swapaxes(axis, 2)
        slope[..., 1:-1] = (values[..., 2:] - values[..., :-2]) / 2
        slope[..., 0] = values[..., 1] - values[..., 0]
        slope[..., -1] = values[..., -1] - values[..., -2]
    return across.reshape(template.shape), down.reshape(template.shape)


def covered_points(
    centre_px: FloatArray, extent_px: FloatArray, xyxy_px: FloatArray, rows: IntArray
) -> BoolArray:
    """(N, P) whether points of patches (N, 2) of the boxes `rows` (N,) are in a nearer box, which
    ends lower.
    """
    is_covered = np.zeros((len(rows), _GRID**2), np.bool_)
    left, top, right, bottom = xyxy_px.T
    low_px, high_px = (centre_px - extent_px).T[:, :, None], (centre_px + extent_px).T[:, :, None]
    meets = bottom[rows, None] < bottom
    meets &= (low_px[0] <= right) & (high_px[0] >= left)
    meets &= (low_px[1] <= bottom) & (high_px[1] >= top)
    patch, box = meets.nonzero()  # (pairs,), by patch
    if not len(patch):
        return is_covered
    centre, extent = centre_px[patch], extent_px[patch]
    # (pairs, 2, 1) edges of the boxes in half extents of the patches
    first = ((xyxy_px[box, :2] - centre) / extent)[:, :, None]
    last = ((xyxy_px[box, 2:] - centre) / extent)[:, :, None]
    in_columns, in_rows = ((first <= _LINE) & (last >= _LINE)).swapaxes(0, 1)
    by_box = (in_rows[:, :, None] & in_columns[:, None]).reshape(len(patch), -1)
    is_first = np.ones(len(patch), np.bool_)
    np.not_equal(patch[1:], patch[:-1], out=is_first[1:])
    begins = is_first.nonzero()[0]
    is_covered[patch[begins]] = np.bitwise_or.reduceat(by_box, begins, axis=0)
    return is_covered
