"""Expected disparities of the labelled objects of a stereo pair, from the sizes of their classes, as in a run."""

from __future__ import annotations

import numpy as np

from track_range.ranging.methods.size_regression import SizeRanger
from track_range.ranging.methods.triangulation import disparities_by_size
from track_range.ranging.size_models.size_model import SIZE_CLASSES
from track_range.stereo.evaluation.kitti_2015 import StereoPair
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.matching.patch_matches import ExpectedDisparity
from track_range.tracking.tracks import Tracks


def expected_disparities(pair: StereoPair) -> ExpectedDisparity:
    """Disparities by size of the objects of a pair; NaN for objects of unknown class."""
    n = len(pair.xyxy_px)
    ids = [SIZE_CLASSES.index(name) if name in SIZE_CLASSES else -1 for name in pair.class_names]
    class_id = np.array(ids, np.int64)
    if len(class_id) != n:
        return ExpectedDisparity.unknown(n)
    tracks = Tracks(np.arange(n), pair.xyxy_px, np.maximum(class_id, 0), np.ones(n), class_id >= 0)
    by_size = SizeRanger(pair.rig.left).measure(tracks, Frame(0, 0.0, pair.left, None))
    return disparities_by_size(by_size, pair.xyxy_px, pair.rig, (pair.left.shape[0], pair.left.shape[1]))
