"""Camera motion: the image motion of the background between two frames, which also moves predicted
boxes.

    now = [[a, -b], [b, a]] before + t       a = s cos r, b = s sin r: scale s, roll r, and t for yaw and pitch

Corners of the frame before, outside its boxes, are tracked by pyramidal Lucas-Kanade (Bouguet,
2000) on a small grey image. If nearly all are inliers of one similarity, it is the motion. On a
road they are not: driving makes near points flow away from the vanishing point v, by their inverse
depth z (scaled by the speed),

    flow = t + b [-y, x] + z ([x, y] - v)

which a similarity mistakes for zoom and shift, although the image of a car ahead does neither. So t
and b are fitted to the component of the flow perpendicular to the direction from the image centre,
where z has an effect only as z v, and v is fitted too: the result is yaw, pitch and roll. On a
KITTI odometry drive with known poses, the horizon is predicted to 0.7 px rms; by robust
similarities to 13-23 px, and without compensation to 1.1 px.
"""

import cmath
import math
from dataclasses import dataclass

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image, check_shape
from track_range.foundation.robust_statistics import MAD_TO_SIGMA
from track_range.foundation.sparse_flow import BackgroundFlow

# of reweighting; one more changes real drives by 0.02 px
_N_SIMILARITY_ROUNDS, _N_ROTATION_ROUNDS = 4, 5
_SMALL_STEP_PX = 0.005  # change of t in a round after which there is no other one
_MIN_HOPEFUL = 0.5  # fraction of inliers after two rounds below which nothing becomes a similarity
# residual, in standard deviations, above which the weight is 0 (95 % efficiency with normal noise)
_TUKEY = 4.685
_NEAR_CENTRE = 0.01  # distance / long side below which the direction from the centre means nothing
# pulls v to the centre where there is no parallax to fit it
_RIDGE = np.diag([1e-9, 1e-9, 1e-9, 0.01, 0.01])


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraMotionSettings:
    """Numbers of features, and limits of plausible motions, in pixels of the small image."""

    n_features: int = 100  # largest number of tracked features
    min_quality: float = 0.01  # minimum quality of a corner, as a fraction of the best corner's
    noise_px: float = 0.1  # standard deviation of a tracked feature, small pixels
    max_residual_px: float = 0.5  # largest residual of an inlier, small pixels
    min_inliers: int = 12  # minimum number of inliers of a motion
    min_inlier_fraction: float = 0.4  # minimum fraction of inliers among the tracked features
    similarity_fraction: float = 0.8  # minimum fraction of inliers for a similarity, with its zoom
    # minimum rms spread of the features / long side; below it, only t is fitted
    min_spread: float = 0.1
    max_scale: float = 1.25  # largest plausible scale; its inverse is the smallest
    max_roll_rad: float = 0.2  # largest plausible roll
    # largest plausible shift of the image centre, as a fraction of width and of height
    max_shift: float = 0.25


class CameraMotion:
    """Estimator of the background motion between frames of one stream; `flow` may be shared, None =
    a new flow.
    """

    def __init__(
        self, settings: CameraMotionSettings | None = None, *, flow: BackgroundFlow | None = None
    ) -> None:
        self._settings = settings or CameraMotionSettings()
        self._flow = flow or BackgroundFlow()

    def update(self, image: Image, xyxy_px: FloatArray, time_s: float = math.nan) -> FloatArray:
        """(2, 3) `now_from_before`, which maps pixels of the previous frame to pixels of this one;
        deterministic.

        The identity for the first frame, after a change of size, with too few inliers, and for an
        implausible motion. Valid boxes of road users (N, 4) in the image (H, W, 3) are not
        background. Estimators with one flow identify a frame by its `time_s`; NaN = a new frame.
        Raises ValueError: an argument has another shape.
        """
        check_shape("image", image, (None, None, 3))
        check_shape("xyxy_px", xyxy_px, (None, 4))
        self._flow.add(image, xyxy_px, time_s)
        frame = self._flow.now
        if frame is None or self._flow.before is None:
            return np.eye(2, 3)
        pair = self._flow.tracked(self._settings.n_features, self._settings.min_quality)
        before_px, now_px = np.asarray(pair, np.float64)
        small = _motion(before_px, now_px, frame.small.shape, self._settings)
        factor = 1 << frame.n_halved
        offset = np.full(2, (factor - 1) / 2)  # full pixels = factor * small pixels + offset
        return np.column_stack(
            [small[:, :2], factor * small[:, 2] + offset - small[:, :2] @ offset]
        )


def _motion(
    before_px: FloatArray,
    now_px: FloatArray,
    grey_hw: tuple[int, ...],
    settings: CameraMotionSettings,
) -> FloatArray:
    """(2, 3) motion in small pixels: a similarity if nearly all agree, else yaw, pitch and roll,
    else the identity.
    """
    n_points = len(before_px)
    if n_points < settings.min_inliers:
        return np.eye(2, 3)
    long_side_px, centre = max(grey_hw), complex(grey_hw[1] - 1, grey_hw[0] - 1) / 2
    points = (before_px - [centre.real, centre.imag]).T.copy()
    flow = (now_px - before_px).T.copy()
    c, t, n_inliers = _similarity(
        points, flow, settings, min_spread_px=settings.min_spread * long_side_px
    )
    if n_inliers < settings.similarity_fraction * n_points:
        c, t, n_inliers = _rotation(
            points, flow, settings, min_radius_px=_NEAR_CENTRE * long_side_px
        )
    has_enough = n_inliers >= max(settings.min_inliers, settings.min_inlier_fraction * n_points)
    is_near = (
        abs(t.real) <= settings.max_shift * grey_hw[1]
        and abs(t.imag) <= settings.max_shift * grey_hw[0]
    )
    is_level = abs(cmath.phase(c)) <= settings.max_roll_rad
    if not (
        has_enough
        and is_near
        and is_level
        and 1 / settings.max_scale <= abs(c) <= settings.max_scale
    ):
        return np.eye(2, 3)
    origin = t + centre - c * centre
    return np.array([[c.real, -c.imag, origin.real], [c.imag, c.real, origin.imag]])


def _median(values: FloatArray) -> float:
    """The upper median; numpy's median takes ten times as long for so few values."""
    return float(np.sort(values)[len(values) // 2])


def _weights(residual2_px2: FloatArray, noise_px: float) -> FloatArray:
    """(N,) Tukey weights of squared residuals (N,), scaled by their standard deviation, at least
    `noise_px`.
    """
    scale_px = max(MAD_TO_SIGMA * math.sqrt(_median(residual2_px2)), noise_px)
    return np.asarray((1 - np.minimum(residual2_px2 / (_TUKEY * scale_px) ** 2, 1)) ** 2)


def _similarity(
    points: FloatArray, flow: FloatArray, settings: CameraMotionSettings, *, min_spread_px: float
) -> tuple[complex, complex, int]:
    """A robust similarity c = a + ib and t of points (2, N) from the image centre, by least squares
    in closed form, and the number of inliers.

    With the sums of weight w = 1, the growth g = c - 1 = sum w conj(p - mean) flow / sum w |p - mean|^2.
    """
    x, y = points
    # rows 1, p, its square, its flow, and conj(p) flow, whose weighted sums determine the motion
    terms = np.array(
        [
            np.ones_like(x),
            x,
            y,
            x * x + y * y,
            *flow,
            x * flow[0] + y * flow[1],
            x * flow[1] - y * flow[0],
        ]
    )
    growth, t = 0j, complex(_median(flow[0]), _median(flow[1]))
    for k in range(_N_SIMILARITY_ROUNDS + 1):
        off2 = _off_similarity2(points, flow, growth, t)
        n_inliers = int(np.count_nonzero(off2 <= settings.max_residual_px**2))
        if k == _N_SIMILARITY_ROUNDS or (k > 1 and n_inliers < _MIN_HOPEFUL * len(off2)):
            break
        weight = _weights(off2, settings.noise_px)
        total, *sums = (terms @ weight).tolist()
        mean_x, mean_y, mean_square, flow_x, flow_y, along, across = (v / total for v in sums)
        mean, mean_flow = complex(mean_x, mean_y), complex(flow_x, flow_y)
        spread_px2 = mean_square - abs(mean) ** 2
        growth = 0j
        if spread_px2 >= min_spread_px**2:
            growth = (complex(along, across) - mean.conjugate() * mean_flow) / spread_px2
        t = mean_flow - growth * mean
    return 1 + growth, t, n_inliers


def _off_similarity2(
    points: FloatArray, flow: FloatArray, growth: complex, t: complex
) -> FloatArray:
    """(N,) squared residuals of the flow (2, N) by a similarity."""
    turn = np.array([[growth.real, -growth.imag], [growth.imag, growth.real]])
    off = turn @ points - flow + np.array([[t.real], [t.imag]])
    off *= off
    return np.asarray(off[0] + off[1])


def _rotation(
    points: FloatArray, flow: FloatArray, settings: CameraMotionSettings, *, min_radius_px: float
) -> tuple[complex, complex, int]:
    """Yaw, pitch and roll as c = a + ib (of size 1) and t, and the number of inliers: none if t is
    not determined.

    Perpendicular to the direction from the centre, at distance r, the flow is t + b r - z v: linear
    in t, b and v for a given z, which is the flow along that direction, less t, over r. Features on
    one line from the centre do not determine t along it.
    """
    r = np.maximum(np.sqrt((points * points).sum(axis=0)), min_radius_px)
    along = points / r
    along_per_r = along / r
    z_of_flow = (flow * along_per_r).sum(axis=0)
    terms = np.empty((5, points.shape[1]))  # of t, b and v
    terms[0], terms[1], terms[2] = -along[1], along[0], r
    perpendicular = terms[:2]
    across = (flow * perpendicular).sum(axis=0)
    t = np.array([_median(flow[0]), _median(flow[1])])
    solution = np.array([*t, 0.0, 0.0, 0.0])
    for _ in range(_N_ROTATION_ROUNDS):
        np.multiply(perpendicular, t @ along_per_r - z_of_flow, out=terms[3:])
        residual = across - solution @ terms
        weighted = terms * _weights(residual * residual, settings.noise_px)
        information = weighted @ terms.T + _RIDGE
        solution = cv2.solve(information, (weighted @ across)[:, None])[1][:, 0]
        step, t = solution[:2] - t, solution[:2]
        if step @ step < _SMALL_STEP_PX**2:
            break
    covariance = np.linalg.inv(information)
    t_sigma_px = settings.noise_px * math.sqrt(covariance[0, 0] + covariance[1, 1])
    n_inliers = 0
    if t_sigma_px <= settings.max_residual_px:
        off = np.abs(across - solution @ terms)
        n_inliers = int(np.count_nonzero(off <= settings.max_residual_px))
    c = complex(1.0, solution[2])
    return c / abs(c), complex(*t.tolist()), n_inliers
