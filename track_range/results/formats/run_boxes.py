"""The boxes of a run as `BoxTable`, for label formats: with the fused distance and its location.

The location is the point below the ranged point that KITTI's format describes, the bottom centre of the object: the ray
through the middle of the lower edge of the box, at the fused distance,

    Z = fused_m    X = (u - cx) / fx Z    Y = (v - cy) / fy Z    u = (x1 + x2) / 2    v = y2

in the left camera's frame (x right, y down, z forward). Z is that of the visible surface, not of the body's middle.
"""

from __future__ import annotations

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.box_table import NO_FACTS, BoxTable, VideoFacts
from track_range.foundation.arrays import FloatArray
from track_range.pipeline.frame_result import FrameResult
from track_range.results.columns import Columns
from track_range.results.truth import boxes_px
from track_range.stereo.geometry.camera import PinholeCamera


def table_of_rows(columns: Columns, camera: PinholeCamera | None, video: VideoFacts = NO_FACTS) -> BoxTable:
    """All boxes of a run from its rows; locations are unknown without a camera."""
    boxes, distance_m = boxes_px(columns), columns["fused_m"]
    return BoxTable.of(
        columns["frame"],
        columns["track_id"],
        [str(name) for name in columns["class"]],
        boxes,
        score=columns["score"],
        observed=columns["observed"] != 0,
        distance_m=distance_m,
        sigma_m=columns.get("fused_sigma_m", np.full(len(boxes), np.nan)),
        location_m=None if camera is None else bottom_centres_m(boxes, distance_m, camera),
        video=video,
    )


def table_of_frame(result: FrameResult, camera: PinholeCamera) -> BoxTable:
    """The boxes of one frame of a run."""
    tracks, fused = result.tracks, result.ranges["fused"]
    return BoxTable.of(
        np.full(len(tracks), result.index),
        tracks.track_id,
        [ROAD_CLASSES[class_id] for class_id in tracks.class_id.tolist()],
        tracks.xyxy_px,
        score=tracks.score,
        observed=tracks.observed,
        distance_m=fused.distance_m,
        sigma_m=fused.sigma_m,
        location_m=bottom_centres_m(tracks.xyxy_px, fused.distance_m, camera),
    )


def bottom_centres_m(xyxy_px: FloatArray, distance_m: FloatArray, camera: PinholeCamera) -> FloatArray:
    """(N, 3) bottom centre of objects with boxes (N, 4) at distances (N,), in the camera's frame; NaN = unknown."""
    u = (xyxy_px[:, 0] + xyxy_px[:, 2]) / 2
    x, y = (u - camera.cx_px) / camera.fx_px, (xyxy_px[:, 3] - camera.cy_px) / camera.fy_px
    return np.stack([x, y, np.ones_like(x)], axis=1) * distance_m[:, None]
