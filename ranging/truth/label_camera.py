r"""The camera of labels with 2-D and 3-D boxes, from the labels alone.

A 2-D box is the outline of the projected 3-D box, so that its left and right sides are u of two of the
corners (X, Y, Z) of the 3-D box, and its upper and lower sides are v of two:

    u = fx X / Z + cx + fx tx / Z          t: shift from the frame of the 3-D boxes to the camera's
    v = fy Y / Z + cy + fy ty / Z          (of KITTI: from the reference camera to the left colour camera)

These are linear in fx, cx, fx tx and in fy, cy, fy ty. The true distances then do not depend on what a
run believes about its camera. tz is not determined; it is 3 mm in KITTI.
"""

import numpy as np

from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.cauchy_fit import cauchy_fit

_MIN_LABELS = 20  # each has two sides per axis; three unknowns per axis
# largest relative sigma of the focal lengths, and largest scatter of the sides of a box in px:
# boxes that were drawn around the visible object are no outlines of 3-D boxes
_MAX_FOCAL_SIGMA, _MAX_SCATTER_PX = 0.005, 5.0
_MIN_DEPTH_M = 1.0  # of the nearest corner; nearer ones are far outside of the image
_LEAST_SCALE_PX = 0.05  # rounding of labels


def camera_of_labels(
    labels: KittiLabels, size_px: tuple[int, int]
) -> tuple[PinholeCamera, FloatArray] | None:
    """The camera and the shift (3,) from the frame of the 3-D boxes to its frame, in m; None = the
    labels do not determine them.

    Labels that are truncated or not fully visible are not used.
    """
    labels = labels.select(labels.has_3d_box & (labels.truncated == 0) & (labels.occluded == 0))
    corners = _corners(labels)
    is_ahead = corners[:, :, 2].min(axis=1, initial=np.inf) > _MIN_DEPTH_M
    if is_ahead.sum() < _MIN_LABELS:
        return None
    corners, xyxy_px = corners[is_ahead], labels.xyxy_px[is_ahead]
    parameters = []
    for axis in (0, 1):
        fitted = _fit(corners[:, :, axis], corners[:, :, 2], xyxy_px[:, [axis, axis + 2]])
        if fitted is None:
            return None
        parameters.append(fitted)
    (fx, cx, fx_tx), (fy, cy, fy_ty) = parameters
    camera = PinholeCamera(fx, fy, cx, cy, *size_px)
    return camera, np.array([fx_tx / fx, fy_ty / fy, 0.0])


def _fit(x: FloatArray, z: FloatArray, sides_px: FloatArray) -> tuple[float, float, float] | None:
    """f, c and f t of one axis from corners (N, 8) and the lower and upper sides (N, 2) of boxes."""
    ratio, row = x / z, np.arange(len(x))
    at = [ratio.argmin(axis=1), ratio.argmax(axis=1)]
    chosen = np.concatenate([ratio[row, index] for index in at])
    inverse = np.concatenate([1 / z[row, index] for index in at])
    design = np.stack([chosen, np.ones_like(chosen), inverse], axis=1)
    fit = cauchy_fit(design, sides_px.T.ravel(), least_scale=_LEAST_SCALE_PX, n_rounds=20)
    focal, centre, shift = fit.solution.tolist()
    is_exact = np.median(np.abs(fit.residual)) <= _MAX_SCATTER_PX
    is_known = focal > 0 and np.sqrt(fit.covariance[0, 0]) <= _MAX_FOCAL_SIGMA * focal
    return (focal, centre, shift) if is_exact and is_known else None


def _corners(labels: KittiLabels) -> FloatArray:
    """(N, 8, 3) corners of the 3-D boxes."""
    height, width, length = labels.size_hwl_m.T[:, :, None]
    along = length / 2 * np.array([1, 1, -1, -1, 1, 1, -1, -1])
    across = width / 2 * np.array([1, -1, -1, 1, 1, -1, -1, 1])
    up = height * np.array([0, 0, 0, 0, -1, -1, -1, -1])
    cos, sin = np.cos(labels.rotation_y_rad)[:, None], np.sin(labels.rotation_y_rad)[:, None]
    offsets = np.stack([cos * along + sin * across, up, cos * across - sin * along], axis=2)
    return np.asarray(labels.location_m[:, None] + offsets)
