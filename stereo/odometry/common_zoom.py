"""CommonZoom: a change of the focal length of both cameras, between two frames.

    places of static points     p = p_expected + shift + z (p_expected - centre)
    their disparities           d = (1 + z) d_expected

expected by the motion of the camera in the frames before. A sudden acceleration or turn changes
only the first, a camera that moves in the rig only the second: a zoom is what both show.
"""

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.cauchy_fit import cauchy_fit

_MIN_POINTS = 30
_MIN_ZOOM = 0.006  # smallest change that is noticed
# standard deviation of the change by disparities, and largest relative difference of the two
_DISPARITY_SIGMA, _MAX_DIFFERENCE = 0.003, 0.25
_MIN_AGREEING = 0.6  # fraction of the points that agree with the change
_NEAR_PX = 0.1  # smallest scatter of points, small pixels
_AGREEING_PX = 1.0  # largest residual of one that agrees, small pixels


def common_zoom(
    expected_px: FloatArray,
    seen_px: FloatArray,
    expected_disparity_px: FloatArray,
    disparity_px: FloatArray,
) -> float:
    """The relative change z of the focal length from N static points, places (N, 2) from the centre
    of the image and disparities (N,); 0 = they show none.
    """
    if len(seen_px) < _MIN_POINTS:
        return 0.0
    moved_px = seen_px - expected_px
    design = np.concatenate(
        [
            np.stack([expected_px[:, 0], np.ones(len(seen_px)), np.zeros(len(seen_px))], axis=1),
            np.stack([expected_px[:, 1], np.zeros(len(seen_px)), np.ones(len(seen_px))], axis=1),
        ]
    )
    values = np.concatenate([moved_px[:, 0], moved_px[:, 1]])
    solution, _, residual = cauchy_fit(design, values, least_scale=_NEAR_PX, n_rounds=5)
    by_places = float(solution[0])
    by_disparity = float(np.median(disparity_px / expected_disparity_px)) - 1.0
    difference = abs(by_places - by_disparity)
    is_zoom = (
        abs(by_places) > _MIN_ZOOM
        and difference < max(3 * _DISPARITY_SIGMA, _MAX_DIFFERENCE * abs(by_places))
        and (np.abs(residual) < _AGREEING_PX).mean() > _MIN_AGREEING
    )
    return by_places if is_zoom else 0.0
