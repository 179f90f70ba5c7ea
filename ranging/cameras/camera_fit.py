r"""CameraFit: focal length, camera height, pitch and roll from known metres, by Bayesian non-linear least squares.

    theta = (log f, log H, y0, r, b)     f: focal length in px, H: height of the camera above the road in m,
                                         y0: row of the horizon below the image centre in px, pitch = atan(y0 / f) down,
                                         r: slope of the horizon (tangent of the roll), b: log ratio of the sizes of
                                         this drive's road users to the size model

Residuals, each divided by its standard deviation (u, v: column and row from the image centre, box w x h px):

    known distance Z, by size         log D(f) - log Z + b             D(f): distance by the size model, ~ f S / h
    known distance Z, on the road     v - y0 - r u - f H / Z'          Z' = Z - offset of the contact point
    known height or width S           v - y0 - r u - H s / S           s = h or w
    the same with a known distance    log(s Z / (f S))
    lane of width W in a row          v - y0 - r u - H w / W
    horizon in a row                  v - y0                           lane lines, direction of travel; Cauchy loss
    other road users                  v - y0 - r u - H e^-b f / D'     Cauchy loss; D' = D(f) - offset with the last f
    priors                            f, H, b (`unknowns`), y0, r

Sizes with contact points give H and y0, but not f: scaling f and all distances alike leaves all images of flat objects
unchanged. Known distances and the prior of f separate the two. The covariance is (J'J)^-1 at the solution (Laplace's
approximation). Standard deviations are computed at the parameters of the previous fit, so that they do not attract the
fit. f, H and b are unknowns of the cameras' posterior (b = -a), in which the fit without their priors is evidence.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from scipy.optimize import least_squares

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.cameras.evidence import Evidence
from track_range.ranging.cameras.measurements import (
    CameraMeasurements,
    KnownLane,
    KnownObject,
)
from track_range.ranging.cameras.unknowns import CameraPriors, Unknown
from track_range.ranging.size_models.shared_sizes import shared_variance
from track_range.ranging.size_models.size_model import (
    BORDER_PX,
    SIZE_CLASSES,
    BoxNoise,
    SizeModel,
    measured_boxes,
    surface_offset_m,
)
from track_range.stereo.geometry.camera import PinholeCamera

_Real = TypeVar("_Real", float, FloatArray)
# theta, in this order
PARAMETERS = ("focal length", "camera height", "horizon", "roll", "size ratio")
_LOG_F, _LOG_H, _Y0, _ROLL, _SIZE = range(len(PARAMETERS))
# parameters that are unknowns of the cameras' posterior, and their signs in it
_SHARED, _SIGNS = (_LOG_F, _LOG_H, _SIZE), np.array([-1.0, 1.0, -1.0])
_UNKNOWNS = Unknown.FOCAL, Unknown.HEIGHT, Unknown.SIZES
_LEAST_INFORMATION = 1e-4  # of a sum of unknowns about which the measurements say anything
PITCH_SIGMA_RAD = 0.07  # prior standard deviation of the pitch of the camera, 4 degrees
_ROLL_SIGMA = 0.02  # prior standard deviation of the tangent of the roll
_PICKED_EDGE_PX = 1.5  # standard deviation of an edge of a box drawn by hand
_SHAPE_SIGMA = 0.015  # of the ratio of a box to a known height or width: objects are not flat
# standard deviation of pitch and slope of the road at one time about those of the drive
_PITCHING_RAD = 0.004
_KERB_M = 0.1  # standard deviation of the height of contact points above the road
_VIEWS_PER_TRACK = 1.5  # number of independent views that the views of one object count as at most
# scale of the Cauchy loss of other road users and horizon rows (kerbs taken for lane lines), in
# sigmas
_CAUCHY = 2.0
_STANDS = np.isin(SIZE_CLASSES, ("person", "bicycle", "car", "motorcycle", "bus", "truck", "van"))
"""(size classes,) whether objects of the class are on the road."""

_MIN_HEIGHT_PX = 12.0  # height of a box of the scene below which it is not used
# rms of the deviations in sigmas, above which measurements and priors contradict each other
_MAX_DEVIATION = 2.0
# the same for one measurement: none of 120 fits to boxes with these errors reached 2.6
_MAX_RESIDUAL = 3.5
_N_REWEIGHTS = 2  # number of fits with updated standard deviations of the scene
# largest factor between the inverse depth by size and by the fitted road in these sigmas
_MAX_SLOPE_RATIO = 2.0
_N_GRID = 13  # number of focal lengths at which distances by size are computed, for interpolation
_GRID_LOG_SPAN = 0.7  # half width of the grid of log f


@dataclass(frozen=True, slots=True)
class Residual:
    """Difference of one measurement from the fitted camera."""

    name: str  # the measurement
    kind: str  # the equation, in words
    value: float  # measured minus fitted, in `unit`
    sigma: float  # its standard deviation
    unit: str  # "%" or "px"


@dataclass(frozen=True, slots=True)
class CameraFit:
    """A fitted camera."""

    camera: PinholeCamera  # its model, without distortion
    theta: FloatArray  # (5,) parameters
    # (5, 5) their covariance; larger if measurements and priors contradict each other
    covariance: FloatArray
    prior_sigma: FloatArray  # (5,) standard deviations of the priors
    # residuals of the user's measurements and the horizon rows
    residuals: tuple[Residual, ...] = field(default=())
    # factor of all sigmas by contradictions (Birge's ratio, or larger by one residual); 1 = none
    contradiction: float = 1.0
    largest_deviation: tuple[str, float] = ("", 0.0)  # measurement or prior, and its sigmas
    # what the measurements say without the priors of focal length, height and sizes
    evidence: tuple[Evidence, ...] = ()

    @property
    def focal_sigma(self) -> float:
        """Relative standard deviation of the focal length."""
        return self._sigma(_LOG_F)

    @property
    def height_m(self) -> float:
        """Height of the camera above the road."""
        return math.exp(self.theta[_LOG_H])

    @property
    def height_sigma_m(self) -> float:
        """Standard deviation of `height_m`."""
        return self.height_m * self._sigma(_LOG_H)

    def pitch_rad(self, camera: PinholeCamera) -> float:
        """Angle of the axis of `camera`, this one with its principal point, below the horizon:
        positive = the horizon is above the principal point.
        """
        return math.atan((camera.cy_px - self.camera.cy_px - self.theta[_Y0]) / camera.fy_px)

    @property
    def pitch_sigma_rad(self) -> float:
        """Standard deviation of the pitch."""
        return self._sigma(_Y0) / self.camera.fy_px

    @property
    def roll_rad(self) -> float:
        """Slope of the horizon, positive = falling to the right."""
        return math.atan(self.theta[_ROLL])

    def correlation(self, one: str, other: str) -> float:
        """Correlation of two parameters by their names in `PARAMETERS`."""
        i, j = PARAMETERS.index(one), PARAMETERS.index(other)
        return float(
            self.covariance[i, j] / math.sqrt(self.covariance[i, i] * self.covariance[j, j])
        )

    def gain(self, name: str) -> float:
        """Ratio of a parameter's standard deviation to its prior's: 1 = the measurements do not
        determine it.
        """
        i = PARAMETERS.index(name)
        return self._sigma(i) / float(self.prior_sigma[i])

    @property
    def product_sigma(self) -> float:
        """Relative standard deviation of the product of focal length and camera height."""
        return float(np.sqrt(self.covariance[:2, :2].sum()))

    def _sigma(self, index: int) -> float:
        return math.sqrt(self.covariance[index, index])


@dataclass(frozen=True, slots=True)
class _BySize:
    """Log distance of N boxes by size as a function of log f."""

    log_f: FloatArray  # (G,) grid
    log_m: FloatArray  # (G, N) log distance
    sigma: FloatArray  # (N,) standard deviation of log distance

    def at(self, log_f: float) -> FloatArray:
        """(N,) log distance with the focal length exp(log_f), extrapolated in proportion to f."""
        inside = min(max(log_f, self.log_f[0]), self.log_f[-1])
        position = (inside - self.log_f[0]) / (self.log_f[1] - self.log_f[0])
        k = min(int(position), len(self.log_f) - 2)
        fraction = position - k
        return np.asarray(
            (1 - fraction) * self.log_m[k] + fraction * self.log_m[k + 1] + (log_f - inside)
        )


def fit_camera(
    size_px: tuple[int, int],
    priors: CameraPriors,
    sizes: SizeModel,
    measured: CameraMeasurements,
) -> CameraFit:
    """The camera that agrees best with all measurements and the priors of its focal length, height
    and sizes, for images of `size_px` (width, height).
    """
    terms = _Terms(size_px, priors, sizes, measured)
    fit = least_squares(terms.residuals, terms.prior_mean, x_scale=terms.prior_sigma)
    for _ in range(_N_REWEIGHTS):
        terms.reweight(fit.x)
        fit = least_squares(terms.residuals, fit.x, x_scale=terms.prior_sigma)
    deviations = terms.deviations(fit.x)
    contradiction = _contradiction([value for _, value in deviations])
    jacobian = np.asarray(fit.jac, np.float64)
    precision = jacobian.T @ jacobian
    covariance = np.asarray(np.linalg.inv(precision), np.float64) * contradiction**2
    return CameraFit(
        camera=PinholeCamera.of_focal_length(math.exp(fit.x[_LOG_F]), size_px),
        theta=fit.x,
        covariance=covariance,
        prior_sigma=terms.prior_sigma,
        residuals=terms.table(fit.x),
        contradiction=contradiction,
        largest_deviation=max(deviations, key=lambda deviation: abs(deviation[1])),
        evidence=_evidence(fit.x - terms.prior_mean, precision, terms.prior_sigma, contradiction),
    )


def _evidence(
    change: FloatArray, precision: FloatArray, prior_sigma: FloatArray, sigma: float
) -> tuple[Evidence, ...]:
    """Equations of what moved theta by `change` (5,) to the precision (5, 5), with the standard
    deviation `sigma`: independent sums of unknowns, with any pitch and roll.
    """
    k, angles = list(_SHARED), [_Y0, _ROLL]
    vector = precision @ change
    gain = precision[np.ix_(k, angles)] @ np.linalg.inv(precision[np.ix_(angles, angles)])
    information = precision[np.ix_(k, k)] - gain @ precision[np.ix_(angles, k)]
    information = information - np.diag(prior_sigma[k] ** -2)
    of_unknowns = vector[k] - gain @ vector[angles]
    values, directions = np.linalg.eigh(information)
    evidence = []
    for value, direction in zip(values, directions.T, strict=True):
        if value > _LEAST_INFORMATION:
            root = math.sqrt(value)
            of = dict(zip(_UNKNOWNS, (root * _SIGNS * direction).tolist(), strict=True))
            shown = float(direction @ of_unknowns) / root
            evidence.append(Evidence("the known metres", of, shown, sigma))
    return tuple(evidence)


def _contradiction(deviations: Sequence[float]) -> float:
    """Factor of all sigmas, from the residuals of the priors and of the measurements in standard
    deviations; 1 = they agree.
    """
    measured = deviations[len(PARAMETERS) :]
    rms = math.sqrt(sum(value**2 for value in deviations) / max(len(measured), 1))
    largest = max((abs(value) for value in measured), default=0.0)
    factor = max(rms, largest * _MAX_DEVIATION / _MAX_RESIDUAL)
    return factor if factor > _MAX_DEVIATION else 1.0


class _Terms:
    """All residuals as functions of theta."""

    def __init__(
        self,
        size_px: tuple[int, int],
        priors: CameraPriors,
        sizes: SizeModel,
        measured: CameraMeasurements,
    ) -> None:
        self._size_px, self._centre_px = size_px, ((size_px[0] - 1) / 2, (size_px[1] - 1) / 2)
        self._objects, self._lanes = tuple(measured.objects), tuple(measured.lanes)
        self._horizon = tuple(measured.horizon)
        focal, height, of_sizes = (priors[unknown] for unknown in _UNKNOWNS)
        log_f = math.log(focal.value)
        self.prior_mean = np.array([log_f, math.log(height.value), 0.0, 0.0, 0.0])
        pitch_sigma_px = PITCH_SIGMA_RAD * focal.value
        self.prior_sigma = np.array(
            [focal.sigma, height.sigma, pitch_sigma_px, _ROLL_SIGMA, of_sizes.sigma]
        )
        grid = log_f + np.linspace(-_GRID_LOG_SPAN, _GRID_LOG_SPAN, _N_GRID)
        boxes = np.array([known.xyxy_px for known in self._objects]).reshape(-1, 4)
        classes = np.array([known.size_class for known in self._objects], np.int64)
        noise = BoxNoise(_PICKED_EDGE_PX, 0.0, 0.0)
        self._known_by_size = _by_size(boxes, classes, grid, size_px, sizes, noise)
        self._offset_m = surface_offset_m(boxes, classes)

        # Other road users: whole boxes of objects that stand on the road, with a distance by size.
        noise = BoxNoise(relative=measured.scene_noise)
        is_whole = measured.scene.are_whole(size_px, min_height_px=_MIN_HEIGHT_PX)
        whole = measured.scene.select(is_whole & _STANDS[measured.scene.size_class])
        by_size = _by_size(whole.xyxy_px, whole.size_class, grid, size_px, sizes, noise)
        rows = np.flatnonzero(np.isfinite(by_size.log_m).all(axis=0))
        self._scene = scene = whole.select(rows)
        self._scene_by_size = _BySize(by_size.log_f, by_size.log_m[:, rows], by_size.sigma[rows])
        self._scene_offset_m = surface_offset_m(scene.xyxy_px, scene.size_class)
        wh_px = scene.xyxy_px[:, 2:] - scene.xyxy_px[:, :2]
        self._scene_edge_px = noise.sigma_px(wh_px, scene.size_class)[:, 1]
        self._scene_weight = np.sqrt(np.minimum(1.0, _VIEWS_PER_TRACK / scene.views))

        self._start_from(self.prior_mean)
        self._scene_sigma_px = self._sigma_of_scene(self._scene_slope)

    def residuals(self, theta: FloatArray) -> FloatArray:
        """(M,) all residuals in standard deviations."""
        priors = (theta - self.prior_mean) / self.prior_sigma
        known = np.array([residual.value / residual.sigma for residual in self.table(theta)])
        n_known = len(known) - len(self._horizon)
        # Bottom edges of other road users.
        x1, _, x2, y2 = self._scene.xyxy_px.T
        drop_px = math.exp(theta[_LOG_H] - theta[_SIZE]) * self._scene_slope
        scene = (self._below_horizon(theta, (x1 + x2) / 2, y2) - drop_px) / self._scene_sigma_px
        return np.concatenate(
            [priors, known[:n_known], _robust(known[n_known:]), self._scene_weight * _robust(scene)]
        )

    def deviations(self, theta: FloatArray) -> list[tuple[str, float]]:
        """The priors and the user's measurements with their residuals in standard deviations."""
        priors = (theta - self.prior_mean) / self.prior_sigma
        known = self.table(theta)[: -len(self._horizon) or None]
        named = [
            (f"the {name} before the measurements", value)
            for name, value in zip(PARAMETERS, priors, strict=True)
        ]
        return [
            *named,
            *(
                (f"{residual.name}, {residual.kind}", residual.value / residual.sigma)
                for residual in known
            ),
        ]

    def table(self, theta: FloatArray) -> tuple[Residual, ...]:
        """Residuals of the user's measurements and the horizon rows."""
        rows = [
            row for k, known in enumerate(self._objects) for row in self._of_object(theta, k, known)
        ]
        rows += [self._of_lane(theta, lane) for lane in self._lanes]
        for row in self._horizon:
            fitted_px = self._centre_px[1] + theta[_Y0]
            rows.append(
                Residual(row.source, "row of the horizon", row.y_px - fitted_px, row.sigma_px, "px")
            )
        return tuple(rows)

    def _of_object(self, theta: FloatArray, k: int, known: KnownObject) -> list[Residual]:
        log_f, log_h, *_, size_ratio = theta.tolist()
        x1, _, x2, y2 = known.xyxy_px
        w, h = x2 - x1, y2 - known.xyxy_px[1]
        below_px = self._below_horizon(theta, (x1 + x2) / 2, y2)
        is_standing = bool(_STANDS[known.size_class]) and y2 < self._size_px[1] - 1 - BORDER_PX
        rows = []
        if math.isfinite(known.distance_m):
            log_m, sigma = (
                float(self._known_by_size.at(log_f)[k]),
                float(self._known_by_size.sigma[k]),
            )
            if math.isfinite(log_m) and not (
                math.isfinite(known.height_m) or math.isfinite(known.width_m)
            ):
                value = log_m - math.log(known.distance_m) + size_ratio
                sigma = math.hypot(sigma, known.relative_sigma)
                rows.append(
                    Residual(
                        known.name,
                        f"size of a {SIZE_CLASSES[known.size_class]}",
                        100 * value,
                        100 * sigma,
                        "%",
                    )
                )
            if is_standing and known.distance_m > 2 * self._offset_m[k]:
                slope = math.exp(log_f) / (known.distance_m - float(self._offset_m[k]))
                value = below_px - math.exp(log_h) * slope
                rows.append(
                    Residual(
                        known.name,
                        "bottom edge on the road",
                        value,
                        self._row_sigma(slope, known),
                        "px",
                    )
                )
        for side_px, side_m, name in ((h, known.height_m, "height"), (w, known.width_m, "width")):
            if not math.isfinite(side_m):
                continue
            side_sigma = math.hypot(
                _SHAPE_SIGMA, known.relative_sigma, math.sqrt(2) * _PICKED_EDGE_PX / side_px
            )
            if math.isfinite(known.distance_m):
                value = math.log(side_px * known.distance_m / (math.exp(log_f) * side_m))
                rows.append(
                    Residual(known.name, f"known {name}", 100 * value, 100 * side_sigma, "%")
                )
            if is_standing:
                slope = side_px / side_m
                value = below_px - math.exp(log_h) * slope
                sigma = math.hypot(
                    self._row_sigma(slope, known),
                    math.exp(self._fixed[_LOG_H]) * slope * side_sigma,
                )
                rows.append(
                    Residual(known.name, f"bottom edge, given the {name}", value, sigma, "px")
                )
        return rows

    def _of_lane(self, theta: FloatArray, lane: KnownLane) -> Residual:
        w = abs(lane.x2_px - lane.x1_px)
        slope = w / lane.width_m
        drop_px = math.exp(theta[_LOG_H]) * slope
        value = self._below_horizon(theta, (lane.x1_px + lane.x2_px) / 2, lane.y_px) - drop_px
        fraction = math.hypot(lane.relative_sigma, math.sqrt(2) * _PICKED_EDGE_PX / w)
        fixed_drop_px = math.exp(self._fixed[_LOG_H]) * slope
        sigma = math.hypot(
            _PITCHING_RAD * math.exp(self._fixed[_LOG_F]), _PICKED_EDGE_PX, fixed_drop_px * fraction
        )
        return Residual(lane.name, "width of the lane", value, sigma, "px")

    def reweight(self, theta: FloatArray) -> None:
        """Compute the standard deviations of the residuals, and the scene's distances by size, from
        a first fit.

        The standard deviations of the scene follow from the fitted distances: distances by size are
        noisy, and weights that depend on the noise would prefer boxes that are too small.
        """
        self._start_from(theta)
        x1, _, x2, y2 = self._scene.xyxy_px.T
        observed = self._scene_slope * math.exp(-theta[_SIZE])
        fitted = self._below_horizon(theta, (x1 + x2) / 2, y2) / math.exp(theta[_LOG_H])
        self._scene_sigma_px = self._sigma_of_scene(
            np.clip(fitted, observed / _MAX_SLOPE_RATIO, observed * _MAX_SLOPE_RATIO)
        )

    def _start_from(self, theta: FloatArray) -> None:
        """Fix the quantities that must not depend on the parameters during a fit.

        These are the standard deviations, and f / Z' in px/m of other road users with Z' by size,
        which would repeat what the shapes of their boxes contribute to the prior of f.
        """
        self._fixed = theta
        distance_m = np.exp(self._scene_by_size.at(theta[_LOG_F])) - self._scene_offset_m
        self._scene_slope = math.exp(theta[_LOG_F]) / np.maximum(distance_m, 1.0)

    def _sigma_of_scene(self, slope: FloatArray) -> FloatArray:
        """(N,) standard deviations in px of the bottom edges of other road users about the road."""
        by_size_px = math.exp(self._fixed[_LOG_H]) * slope * self._scene_by_size.sigma
        pitching_px = _PITCHING_RAD * math.exp(self._fixed[_LOG_F])
        return np.asarray(
            np.sqrt(
                by_size_px**2 + pitching_px**2 + (_KERB_M * slope) ** 2 + self._scene_edge_px**2
            )
        )

    def _below_horizon(self, theta: FloatArray, x_px: _Real, y_px: _Real) -> _Real:
        """Rows below the horizon, of columns and rows of the image."""
        y0, roll = float(theta[_Y0]), float(theta[_ROLL])
        return y_px - (self._centre_px[1] + y0) - (x_px - self._centre_px[0]) * roll

    def _row_sigma(self, slope: float, known: KnownObject) -> float:
        """Standard deviation in px of a bottom edge about the road, for `slope` = f / Z in px/m."""
        pitching_px = _PITCHING_RAD * math.exp(self._fixed[_LOG_F])
        tape_px = known.relative_sigma * math.exp(self._fixed[_LOG_H]) * slope
        return math.hypot(pitching_px, _PICKED_EDGE_PX, _KERB_M * slope, tape_px)


def _robust(residual: FloatArray) -> FloatArray:
    """(N,) values whose squares are the Cauchy loss of the residuals (N,), in standard
    deviations.
    """
    return np.asarray(_CAUCHY * np.sqrt(np.log1p((residual / _CAUCHY) ** 2)) * np.sign(residual))


def _by_size(
    xyxy_px: FloatArray,
    size_class: IntArray,
    log_f: FloatArray,
    size_px: tuple[int, int],
    sizes: SizeModel,
    noise: BoxNoise,
) -> _BySize:
    """Distances of N boxes by size alone, without the ground, at the focal lengths of a grid; NaN
    without a model.
    """
    n = len(xyxy_px)
    if not n:
        return _BySize(log_f, np.zeros((len(log_f), 0)), np.zeros(0))
    first_px, last_px = BORDER_PX - 0.5, size_px[0] - 0.5 - BORDER_PX
    uses = (xyxy_px[:, 0] >= first_px) & (xyxy_px[:, 2] <= last_px), np.zeros(n, np.bool_)
    log_m, sigma = np.full((len(log_f), n), np.nan), np.zeros(n)
    for k, value in enumerate(log_f):
        camera = PinholeCamera.of_focal_length(math.exp(value), size_px)
        boxes = measured_boxes(
            xyxy_px, size_class, camera=camera, noise=noise, uses_width_bottom=uses
        )
        measured = sizes.measure(boxes)
        log_m[k] = np.log(measured.distance_m)
        if k == len(log_f) // 2:
            variance = (measured.sigma_m / measured.distance_m) ** 2
            sigma = np.sqrt(variance - shared_variance(variance))  # the rest is b
    return _BySize(log_f, log_m, sigma)
