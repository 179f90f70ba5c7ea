"""Labelled boxes from sizes divided by the focal length, bearings and distances."""

import numpy as np

from track_range.ranging.truth.labelled_boxes import BoxSet

F_PX, WIDTH_PX = 1000.0, 4001


def made_up_boxes(name, wh_over_f, bearing, distance_m, *, sequence, track_id=None, **columns):
    """A BoxSet of one class, seen by a camera with a focal length of 1000 px; `columns` replace
    others."""
    n = len(distance_m)
    centre = np.stack([bearing, np.zeros(n)], axis=1) * F_PX + WIDTH_PX / 2
    nan = np.full(n, np.nan)
    known = {
        "sequence_names": tuple(str(k) for k in range(int(sequence.max()) + 1)),
        "sequence": sequence,
        "frame": np.arange(n),
        "time_s": np.arange(n) * 0.1,
        "track_id": np.arange(n) if track_id is None else track_id,
        "kitti_type": np.full(n, name),
        "class_name": np.full(n, name),
        "xyxy_px": np.concatenate(
            [centre - F_PX * wh_over_f / 2, centre + F_PX * wh_over_f / 2], axis=1
        ),
        "fxycxy_px": np.tile([F_PX, F_PX, WIDTH_PX / 2, WIDTH_PX / 2], (n, 1)),
        "size_px": np.full((n, 2), WIDTH_PX),
        "distance_m": distance_m,
        "alpha_rad": nan,
        "x_m": nan,
        "location_m": np.full((n, 3), np.nan),
        "size_hwl_m": np.full((n, 3), np.nan),
        "rotation_y_rad": nan,
        "occluded": np.zeros(n, np.int64),
    }
    return BoxSet(**{**known, **columns})
