"""Fit of size priors to labels with 3-D boxes, with standard sizes for classes without labels.

The samples of a size distribution are objects, not boxes: an object that is labelled in n frames
has the weight n^0.8, not 1, since objects that are visible for long are also more frequent in other
drives. The covariance over all drives covers the variation between objects and between drives; the
part between drives is estimated from the mean log heights of the drives by the method of moments
(DerSimonian and Laird 1986), and averaged with a standard value. The standard size of a class
counts as one more object.

Body types are the components of a mixture of Gaussians over the sizes of a class. Few objects of a
type are labelled, so that they are fitted by maximum a posteriori expectation maximisation
(Dempster, Laird and Rubin 1977). The sizes of production models are the prior: they count as n_0
objects of each type. With the weights w_i of the labelled objects:

    r_ib        ~  fraction_b N(x_i; mean_b, cov_b)                                  sum_b r_ib = 1
    fraction_b  =  (n_0 fraction_b0 + sum_i w_i r_ib) / (n_0 + sum_i w_i)
    mean_b      =  (n_0 mean_b0 + sum_i w_i r_ib x_i) / (n_0 + sum_i w_i r_ib)
    cov_b       =  weighted scatter about mean_b, of the objects and of the standard objects

x = log (height, width, length).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import multivariate_normal

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.size_models.cuboid import box_of_cuboid
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.curve import CurveError
from track_range.ranging.size_models.prior import NODE_CAMERA_HEIGHT_M, YAW_DEG, BodyType, SizePrior
from track_range.ranging.size_models.size_model import BORDER_PX
from track_range.ranging.truth.labelled_boxes import BoxSet

MIN_OBJECTS, MIN_BOXES = 3, 100  # of a class for a fit; classes with fewer have their standard size
# exponents of an object's number of boxes in the weights of object and box
_OBJECT_POWER, _BOX_POWER = 0.8, -0.5
_STANDARD_OBJECTS = 1.0  # weight of the standard size of a class, as a number of objects
# weight in drives, and value, of the sigma of mean log heights
_STANDARD_DRIVES, _STANDARD_DRIVE_SIGMA = 6.0, 0.03
# fraction of objects with a uniformly distributed yaw, so that no yaw is impossible
_UNIFORM_YAW_FRACTION = 0.1
_MIN_SCATTER = (0.01, 0.02)  # of log height and log width of boxes about those of the cuboid
# mean and standard deviation: 25 m with a factor of 3.3, wide enough for any road
_LOG_DISTANCE = (3.2, 1.2)
# of log height and width, height and length, width and length of standard sizes
_CORRELATION = (0.3, 0.2, 0.2)

STANDARD_SIZES: Mapping[str, tuple[tuple[float, float, float], tuple[float, float, float], str]] = {
    "person": ((1.70, 0.55, 0.55), (0.08, 0.25, 0.35), "adults 1.55-1.90 m, and some children"),
    "bicycle": ((1.73, 0.60, 1.75), (0.06, 0.25, 0.10), "a rider on a bicycle"),
    "car": ((1.52, 1.75, 4.20), (0.08, 0.08, 0.13), "passenger cars, sizes of production models"),
    "van": ((2.05, 1.92, 4.90), (0.14, 0.08, 0.15), "delivery vans and minibuses"),
    "truck": ((3.35, 2.50, 8.50), (0.14, 0.07, 0.30), "lorries of 7-40 t"),
    "bus": (
        (3.10, 2.50, 11.5),
        (0.12, 0.07, 0.20),
        "city buses 2.9-3.3 m high, coaches up to 3.8 m, minibuses 2.5 m",
    ),
    "motorcycle": (
        (1.55, 0.80, 2.10),
        (0.12, 0.20, 0.12),
        "a motorcycle with its rider, 1.3-1.8 m",
    ),
    "traffic light": (
        (0.95, 0.35, 0.35),
        (0.35, 0.35, 0.35),
        "three lamps of 200 or 300 mm; some have one, two or four lamps",
    ),
    "traffic sign": (
        (0.70, 0.70, 0.05),
        (0.30, 0.30, 0.30),
        "round and octagonal signs of 600-900 mm",
    ),
}
"""Height, width and length in m, their relative standard deviations, and the source, by class."""

_OFF_GROUND = ("traffic light", "traffic sign")  # classes of objects that are not on the road


_STANDARD_BODY_OBJECTS = 4.0  # weight of the standard sizes of a body type, as a number of objects
# iterations of expectation maximisation; a dozen suffice for some tens of objects
_N_ITERATIONS = 30
_BODY_CORRELATION = 0.3  # correlation between any two log sizes of the objects of one body type
_MAX_CORRELATION = 0.95  # largest absolute correlation in a curve file


@dataclass(frozen=True, slots=True)
class StandardBody:
    """Sizes of production models of one body type."""

    fraction: float  # probability of the type within its class
    hwl_m: tuple[float, float, float]  # height, width (without mirrors) and length in metres
    log_sigma: tuple[float, float, float]  # relative standard deviations of the sizes
    source: str  # models with these sizes

    @property
    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Mean (3,) and covariance (3, 3) of the log sizes."""
        correlation = np.full((3, 3), _BODY_CORRELATION) + (1 - _BODY_CORRELATION) * np.identity(3)
        return np.log(self.hwl_m), correlation * np.outer(self.log_sigma, self.log_sigma)


# sizes of production models by class and body type
STANDARD_BODIES: Mapping[str, Mapping[str, StandardBody]] = {
    "van": {
        "small": StandardBody(
            0.5,
            (1.85, 1.78, 4.35),
            (0.05, 0.05, 0.08),
            "VW Caddy, Renault Kangoo, Citroen Berlingo",
        ),
        "flat roof": StandardBody(
            0.25, (1.97, 1.92, 4.90), (0.05, 0.04, 0.07), "VW T5, Mercedes Vito, Renault Trafic"
        ),
        "high roof": StandardBody(
            0.2, (2.50, 2.02, 5.75), (0.08, 0.05, 0.10), "Mercedes Sprinter, Ford Transit"
        ),
        "box body": StandardBody(
            0.05, (3.00, 2.20, 6.50), (0.10, 0.08, 0.15), "lorries of 3.5 t with a box"
        ),
    },
    "truck": {
        "light": StandardBody(
            0.15, (2.70, 2.15, 6.00), (0.10, 0.08, 0.15), "lorries of 3.5 t with a box or platform"
        ),
        "heavy": StandardBody(
            0.85, (3.50, 2.50, 9.50), (0.12, 0.06, 0.30), "lorries of 7.5-40 t, at most 4 m high"
        ),
    },
}


def fit_size_priors(labels: BoxSet, *, source: str) -> CuboidSizes:
    """Priors of all classes with a standard size, fitted to the labels of classes with enough
    labels.

    CurveError: no class has `MIN_OBJECTS` objects and `MIN_BOXES` boxes with 3-D boxes.
    """
    labels = labels.select((labels.size_hwl_m > 0).all(axis=1) & np.isfinite(labels.distance_m))
    fitted = {}
    for name in STANDARD_SIZES:
        samples = labels.select(labels.class_name == name)
        if len(np.unique(_object(samples), axis=1).T) >= MIN_OBJECTS and len(samples) >= MIN_BOXES:
            fitted[name] = _fitted(name, samples, source)
    if not fitted:
        names, counts = np.unique(labels.class_name, return_counts=True)
        available = ", ".join(f"{n} {c}" for n, c in zip(names, counts, strict=True)) or "none"
        raise CurveError(
            f"expected at least {MIN_BOXES} labels with 3-D boxes of at least {MIN_OBJECTS} "
            f"objects of one class, got {available}."
        )
    return CuboidSizes({name: fitted.get(name) or _standard(name) for name in STANDARD_SIZES})


def _object(labels: BoxSet) -> IntArray:
    """(2, N) identity of the objects: drive and track."""
    return np.stack([labels.sequence, labels.track_id])


def _yaw_rad(labels: BoxSet) -> FloatArray:
    """(N,) angle of the long side to the camera's axis, -pi/2 to pi/2: front and rear are not
    distinguished.
    """
    return np.asarray(np.mod(labels.rotation_y_rad, np.pi) - np.pi / 2)


def _standard(name: str) -> SizePrior:
    hwl_m, sigma, source = STANDARD_SIZES[name]
    return SizePrior(
        hwl_m=hwl_m,
        log_sigma=sigma,
        correlation=_CORRELATION,
        turn_weights=tuple(np.full(len(YAW_DEG), round(1 / len(YAW_DEG), 4)).tolist()),
        log_distance=_LOG_DISTANCE,
        offset=(0.0, 0.0),
        scatter=(0.02, 0.05),
        stands=name not in _OFF_GROUND,
        n_boxes=0,
        n_tracks=0,
        source=f"standard size, not fitted: {source}",
        bodies=fit_body_types(name, np.zeros((0, 3)), np.zeros(0)),
    )


def _fitted(name: str, labels: BoxSet, source: str) -> SizePrior:
    _, first, row, counts = np.unique(
        _object(labels), axis=1, return_index=True, return_inverse=True, return_counts=True
    )
    mean, covariance = _sizes(name, labels.size_hwl_m[first], counts)
    sigma, correlation = _sigma_and_correlation(covariance)
    weight = counts.astype(np.float64)[row.reshape(-1)] ** _BOX_POWER
    offset, scatter = _offset_and_scatter(labels, weight)
    return SizePrior(
        hwl_m=_rounded(np.exp(mean), 3),
        log_sigma=_rounded(sigma, 4),
        correlation=correlation,
        turn_weights=tuple(
            _yaw_weights(np.abs(np.degrees(_yaw_rad(labels))), weight).round(4).tolist()
        ),
        log_distance=_LOG_DISTANCE,
        offset=offset,
        scatter=scatter,
        stands=name not in _OFF_GROUND,
        n_boxes=len(labels),
        n_tracks=len(counts),
        source=source,
        drive_sigma=_drive_sigma(np.log(labels.size_hwl_m[first, 0]), labels.sequence[first]),
        bodies=fit_body_types(name, np.log(labels.size_hwl_m[first]), _object_weights(counts)),
    )


def fit_body_types(name: str, log_size: FloatArray, weight: FloatArray) -> tuple[BodyType, ...]:
    """Body types of a class, fitted to M objects; empty for a class without body types.

    `log_size` (M, 3) is log height, width and length, `weight` (M,) the number of objects that each
    counts as.
    """
    standard = STANDARD_BODIES.get(name)
    if standard is None:
        return ()
    n_0 = _STANDARD_BODY_OBJECTS
    prior_fraction = np.array([body.fraction for body in standard.values()])
    moments = [body.moments for body in standard.values()]
    prior_mean, prior_covariance = (np.array(part) for part in zip(*moments, strict=True))
    fraction, mean, covariance = prior_fraction, prior_mean, prior_covariance
    for _ in range(_N_ITERATIONS):
        log_density = [
            multivariate_normal(mean[b], covariance[b]).logpdf(log_size)
            for b in range(len(fraction))
        ]
        log_r = np.log(fraction)[:, None] + np.reshape(log_density, (len(fraction), -1))
        r = np.exp(log_r - log_r.max(axis=0))
        r *= weight / r.sum(axis=0)
        n = r.sum(axis=1)[:, None]
        fraction = (n_0 * prior_fraction + n[:, 0]) / (n_0 + n.sum())
        mean = (n_0 * prior_mean + r @ log_size) / (n_0 + n)
        shift = prior_mean - mean
        residual = log_size - mean[:, None]  # (B, M, 3)
        covariance = np.stack(
            [(residual[b] * r[b][:, None]).T @ residual[b] for b in range(len(fraction))]
        )
        covariance += n_0 * (prior_covariance + shift[:, :, None] * shift[:, None, :])
        covariance /= (n_0 + n)[:, :, None]
    bodies = []
    for body, body_fraction, body_mean, body_covariance in zip(
        standard, fraction, mean, covariance, strict=True
    ):
        sigma, body_correlation = _sigma_and_correlation(body_covariance)
        bodies.append(
            BodyType(
                name=body,
                share=round(float(body_fraction), 4),
                hwl_m=_rounded(np.exp(body_mean), 3),
                log_sigma=_rounded(sigma, 4),
                correlation=body_correlation,
            )
        )
    return tuple(bodies)


def _sigma_and_correlation(covariance: FloatArray) -> tuple[FloatArray, tuple[float, float, float]]:
    """(3,) standard deviations and the three correlations of log height, width and length."""
    sigma = np.sqrt(np.diag(covariance))
    correlation = np.clip(covariance / np.outer(sigma, sigma), -_MAX_CORRELATION, _MAX_CORRELATION)
    return sigma, _rounded(correlation[[0, 0, 1], [1, 2, 2]], 3)


def _sizes(name: str, size_hwl_m: FloatArray, counts: IntArray) -> tuple[FloatArray, FloatArray]:
    """Mean (3,) and covariance (3, 3) of log sizes (M, 3) over M objects with `counts` boxes and
    the standard size.
    """
    standard_m, sigma, _ = STANDARD_SIZES[name]
    log_size, weight = np.log(size_hwl_m), _object_weights(counts)
    total = weight.sum() + _STANDARD_OBJECTS
    mean = (weight @ log_size + _STANDARD_OBJECTS * np.log(standard_m)) / total
    residual, standard_residual = log_size - mean, np.log(standard_m) - mean
    scatter = (residual * weight[:, None]).T @ residual
    scatter += _STANDARD_OBJECTS * (
        np.diag(np.square(sigma)) + np.outer(standard_residual, standard_residual)
    )
    return mean, scatter / (total - 1.0)


def _object_weights(counts: IntArray) -> FloatArray:
    """(M,) weights of objects with the given numbers of boxes, which sum to the effective number of
    objects.
    """
    weight = counts.astype(np.float64) ** _OBJECT_POWER
    return np.asarray(weight * weight.sum() / (weight**2).sum())


def _drive_sigma(log_height: FloatArray, drive: IntArray) -> float:
    """Standard deviation of the mean log height of a drive, from (M,) objects and the standard
    value.

    The weighted variance Q of the drives' means has the expected value (D - 1) s^2 + tau^2 (M - sum
    n_k^2 / M), for D drives with n_k objects each, the variance s^2 of the objects of a drive, and
    the variance tau^2 of drives.
    """
    _, index, n = np.unique(drive, return_inverse=True, return_counts=True)
    m, n_drives = len(log_height), len(n)
    tau2 = 0.0
    if 1 < n_drives < m:
        means = np.bincount(index, log_height) / n
        within = ((log_height - means[index]) ** 2).sum() / (m - n_drives)
        Q = (n * (means - log_height.mean()) ** 2).sum()
        tau2 = max((Q - (n_drives - 1) * within) / (m - (n**2).sum() / m), 0.0)
    total = n_drives + _STANDARD_DRIVES
    return round(
        float(np.sqrt((n_drives * tau2 + _STANDARD_DRIVES * _STANDARD_DRIVE_SIGMA**2) / total)), 4
    )


def _yaw_weights(yaw_deg: FloatArray, weight: FloatArray) -> FloatArray:
    """Weights of `YAW_DEG` from (N,) yaws with (N,) weights, each divided linearly between its two
    neighbours.
    """
    before = np.clip(np.searchsorted(YAW_DEG, yaw_deg, side="right") - 1, 0, len(YAW_DEG) - 2)
    fraction = (yaw_deg - YAW_DEG[before]) / np.diff(YAW_DEG)[before]
    histogram = np.bincount(before, weight * (1 - fraction), len(YAW_DEG))
    histogram += np.bincount(before + 1, weight * fraction, len(YAW_DEG))
    width = np.gradient(YAW_DEG)
    return np.asarray(
        (1 - _UNIFORM_YAW_FRACTION) * histogram / histogram.sum()
        + _UNIFORM_YAW_FRACTION * width / width.sum()
    )


def _offset_and_scatter(
    labels: BoxSet, weight: FloatArray
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Offset and scatter of log height and log width of the boxes relative to their cuboids, robust
    to outliers.
    """
    box = box_of_cuboid(
        np.log(labels.size_hwl_m).T,
        yaw_rad=_yaw_rad(labels),
        bearing=labels.bearing,
        distance_m=labels.distance_m,
        camera_height_m=NODE_CAMERA_HEIGHT_M,
    )
    left_px, right_px, width_px = labels.xyxy_px[:, 0], labels.xyxy_px[:, 2], labels.size_px[:, 0]
    weight = weight * ((left_px > BORDER_PX) & (right_px < width_px - 1 - BORDER_PX))
    offsets, scatters = [], []
    for size, log_expected, mean_limit, limit in (
        (labels.wh_over_f[:, 1], box.log_height, 0.1, 0.06),
        (labels.wh_over_f[:, 0], box.log_width, 0.7, 0.3),
    ):
        residual = np.log(size) - log_expected
        offset = float(np.average(np.clip(residual, -mean_limit, mean_limit), weights=weight))
        offsets.append(offset)
        scatters.append(
            float(
                np.sqrt(np.average(np.clip(residual - offset, -limit, limit) ** 2, weights=weight))
            )
        )
    return _pair(np.array(offsets), 4), _pair(np.maximum(scatters, _MIN_SCATTER), 4)


def _rounded(values: FloatArray, digits: int) -> tuple[float, float, float]:
    first, second, third = values.round(digits).tolist()
    return first, second, third


def _pair(values: FloatArray, digits: int) -> tuple[float, float]:
    first, second = values.round(digits).tolist()
    return first, second
