r"""Focal length from the shapes of boxes, on a grid of its logarithm.

One image of objects of known size does not give the focal length f: with f and all distances twice as large, the image
is the same, as long as the objects are flat. But a car beside the camera's path also shows its side. The part of its
box that is the side is as wide as the car is long in units of its distance:

      |  far end           u (Z + L) = f X           u: column of the inner side at its far end, from the image centre
     /   u                 w / h = (W + |u| L / f) / S
    /____|  near end       W, S, L: width, height and length, w, h: box in px

so that the ratio of width to height, against the column, measures f / L. `CuboidSizes.log_evidence` is the likelihood
of a box over sizes, yaws and distances; the curve is

    log p(f) = sum_tracks n_eff / n_views sum_views log p(w, h | u / f)

Views of one object share its size and count as `_VIEWS_PER_TRACK` at most. Cars that are parked
askew, and shapes that are not cuboids, affect all boxes of a drive alike: the likelihood is smoothed with
`_SHAPE_SIGMA`.
"""

import math
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import counted
from track_range.ranging.cameras.measurements import SceneBoxes
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.size_model import (
    SIZE_CLASSES,
    BoxNoise,
    SizeModel,
    measured_boxes,
)
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.focal_curve import FocalCurve, log_focal_grid

_N_GRID = 97  # number of points of the grid
_VIEWS_PER_TRACK = 2.0  # number of independent views that the views of one object count as at most
# of log f that all boxes of a drive share; that of KITTI's labels, see docs/concepts/accuracy.md
_SHAPE_SIGMA = 0.12
# candidates of the noise of box edges / box size
_RELATIVE_NOISE = (0.01, 0.03, 0.06, 0.1, 0.15, 0.2)

_ATTENUATION, _UNATTENUATED = 2.9, 0.02
"""Increase of log f with the estimated noise, and the noise from which it is counted.

Noise hides that wide boxes are beside the path (attenuation of a regression with errors in its
variables), which looks like a long focal length. Fitted on simulated drives, seeds 0-9, with exact
boxes, added noise and detector boxes.
"""

_ROUNDED = 0.05
"""Increase of log f from bodies that are narrower at their corners than a cuboid: about half of the
mean error on KITTI's labels (+0.09) and on rendered drives with the packaged detector, seeds
200-202 (+0.11); exact cuboids have -0.05."""

# of boxes that are hidden or of another class; sigma of their edges
_OUTLIER_FRACTION, _OUTLIER_NOISE = 0.1, 0.4
# (size classes,) whether lengths are known well enough
_SHAPE_CLASSES = np.isin(SIZE_CLASSES, ("car", "van"))
_MIN_HEIGHT_PX = 30.0  # height of a box below which its shape is mostly noise
_FLAT_LOG_SIGMA = 30.0  # standard deviation of the log distance without a prior of the distance


@dataclass(frozen=True, slots=True)
class VehicleShapes:
    """What the shapes of vehicles show of the focal length."""

    curve: FocalCurve
    n_tracks: int = 0  # number of objects whose shapes contribute
    relative_noise: float = BoxNoise().relative  # standard deviation of box edges / box size

    @property
    def name(self) -> str:
        """Name of the evidence, for messages."""
        return f"the shapes of {counted(self.n_tracks, 'vehicle')}"


def vehicle_shapes(boxes: SceneBoxes, size_px: tuple[int, int], sizes: SizeModel) -> VehicleShapes:
    """Focal length from the shapes of boxes of a video with images of `size_px` (width, height);
    unknown with sizes that have no shapes.
    """
    log_f = log_focal_grid(size_px, _N_GRID)
    usable = boxes.select(
        boxes.are_whole(size_px, min_height_px=_MIN_HEIGHT_PX) & _SHAPE_CLASSES[boxes.size_class]
    )
    if not isinstance(sizes, CuboidSizes) or not len(usable):
        return VehicleShapes(FocalCurve(log_f, np.zeros(_N_GRID)))
    likelihood, noise = _shape_likelihood(log_f, usable, size_px, sizes)
    curve = FocalCurve(log_f, np.log(np.maximum(likelihood, 1e-300)))
    return VehicleShapes(curve, len(np.unique(usable.track_id)), noise)


def _shape_likelihood(
    log_f: FloatArray, boxes: SceneBoxes, size_px: tuple[int, int], sizes: CuboidSizes
) -> tuple[FloatArray, float]:
    """Likelihood (G,) of the shapes of all boxes, and the estimated noise of their edges.

    The likelihood has the maximum 1 and is smoothed with `_SHAPE_SIGMA`; the noise is the mean of
    `_RELATIVE_NOISE` weighted by likelihood.
    """
    flat = sizes.with_flat_distance(_FLAT_LOG_SIGMA)
    weight = np.minimum(1.0, _VIEWS_PER_TRACK / boxes.views)

    def log_p(log_focal: float, noise: float) -> FloatArray:
        camera = PinholeCamera.of_focal_length(math.exp(log_focal), size_px)
        edges = BoxNoise(relative=noise)
        return flat.log_evidence(
            measured_boxes(boxes.xyxy_px, boxes.size_class, camera=camera, noise=edges)
        )

    log_likelihood = np.zeros((len(_RELATIVE_NOISE), len(log_f)))
    for k, value in enumerate(log_f):
        outlier = math.log(_OUTLIER_FRACTION) + log_p(value, _OUTLIER_NOISE)
        for j, noise in enumerate(_RELATIVE_NOISE):
            log_likelihood[j, k] = weight @ np.logaddexp(
                math.log(1 - _OUTLIER_FRACTION) + log_p(value, noise), outlier
            )
    likelihood = np.exp(log_likelihood - log_likelihood.max())
    noise_weight = likelihood.sum(axis=1) / likelihood.sum()
    kernel = np.exp(-0.5 * ((log_f[:, None] - log_f) / _SHAPE_SIGMA) ** 2)
    smooth = kernel @ likelihood.sum(axis=0) / kernel.sum(axis=1)
    estimated_noise = float(noise_weight @ _RELATIVE_NOISE)
    bias = _ROUNDED + _ATTENUATION * max(estimated_noise - _UNATTENUATED, 0.0)
    corrected = np.interp(log_f + bias, log_f, smooth)
    return corrected / corrected.max(), estimated_noise
