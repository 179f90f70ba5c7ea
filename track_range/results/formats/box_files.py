"""mot.txt, kitti.txt and recorded_boxes.csv: the boxes of a run as text, and as `BoxTable` for
label formats.

mot.txt is in MOTChallenge's format, frames and pixels counted from 1. The lines of kitti.txt are
KITTI's tracking results, frames and pixels counted from 0:

    frame id TYPE -1 -1 -10 x1 y1 x2 y2 -1 -1 -1 X Y Z -10 score

TYPE is Car, Truck, Pedestrian or Cyclist, or the name of a class that KITTI's evaluation skips
(Bus, Traffic_light). Truncation, occlusion, angles and sizes are unknown. Predicted boxes are
written like observed ones: the format cannot distinguish them. X Y Z, -1000 = unknown, is the
bottom centre of the object, the point that KITTI describes: the ray through the middle of the lower
edge of the box, at the fused distance,

    Z = fused_m    X = (u - cx) / fx Z    Y = (v - cy) / fy Z    u = (x1 + x2) / 2    v = y2

in the left camera's frame (x right, y down, z forward). Z belongs to the visible surface, not to
the body's middle.
"""

from __future__ import annotations

import math

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.tables.box_table import NO_FACTS, BoxTable, VideoFacts
from track_range.detection.formats.video_labels.mot import mot_lines
from track_range.detection.formats.video_labels.text_tables import kitti_lines
from track_range.foundation.arrays import FloatArray
from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.row_file import RowWriter
from track_range.results.rows.rows import Rows
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.virtual_pinhole import view_from_camera

RECORDED_BOXES_FILE = "recorded_boxes.csv"

RECORDED_BOXES_COLUMNS = (
    *("frame", "time_s", "track_id", "class"),
    *("x1_px", "y1_px", "x2_px", "y2_px", "azimuth_deg", "x_m", "y_m", "z_m"),
)


class MotWriter(RowWriter):
    """Writer of mot.txt, frame by frame."""

    files = ("mot.txt",)

    def rows(self, result: FrameResult) -> str:
        """The tracks of a frame."""
        tracks = result.tracks
        return "".join(mot_lines(result.index, tracks.track_id, tracks.xyxy_px, tracks.score))


class KittiWriter(RowWriter):
    """Writer of kitti.txt, frame by frame."""

    files = ("kitti.txt",)

    def rows(self, result: FrameResult) -> str:
        """The tracks of a frame."""
        tracks, fused = result.tracks, result.ranges["fused"]
        table = BoxTable.of(
            np.full(len(tracks), result.index),
            tracks.track_id,
            [ROAD_CLASSES[class_id] for class_id in tracks.class_id.tolist()],
            tracks.xyxy_px,
            score=tracks.score,
            observed=tracks.observed,
            distance_m=fused.distance_m,
            sigma_m=fused.sigma_m,
            location_m=_bottom_centres_m(tracks.xyxy_px, fused.distance_m, self.info.camera),
        )
        return "".join(kitti_lines(table, result.index))


class RecordedBoxesWriter(RowWriter):
    """Writer of recorded_boxes.csv: the tracks in the recorded video and in the camera's frame, for
    wide lenses.

    All other files are about the undistorted, rectified images. Boxes are in pixels of the recorded
    video: each edge is moved like its midpoint. The azimuth of the box centre, positive = to the
    right, and the ranged point, from the fused distance, are in the frame of the camera (x right, y
    down, z along its axis), also in a run with --yaw-deg. An empty cell = unknown.
    """

    files = (RECORDED_BOXES_FILE,)

    def header(self) -> str:
        """Names of the columns."""
        return ",".join(RECORDED_BOXES_COLUMNS) + "\n"

    def rows(self, result: FrameResult) -> str:
        """The boxes of a frame."""
        tracks, info = result.tracks, self.info
        view = view_from_camera(float(info.settings.get("yaw_deg", 0.0)))
        rays = info.camera.rays((tracks.xyxy_px[:, :2] + tracks.xyxy_px[:, 2:]) / 2) @ view
        azimuth_deg = np.degrees(np.arctan2(rays[:, 0], rays[:, 2]))
        numbers = np.column_stack(
            [info.recorded_boxes(tracks.xyxy_px), azimuth_deg, result.xyz_m @ view]
        )
        start, lines = f"{result.index},{result.time_s:.6f}", []
        for track_id, class_id, row in zip(
            tracks.track_id.tolist(), tracks.class_id.tolist(), numbers.tolist(), strict=True
        ):
            cells = ",".join(f"{number:.3f}" if math.isfinite(number) else "" for number in row)
            lines.append(f"{start},{track_id},{ROAD_CLASSES[class_id]},{cells}\n")
        return "".join(lines)


def table_of_rows(
    rows: Rows, camera: PinholeCamera | None, video: VideoFacts = NO_FACTS
) -> BoxTable:
    """All boxes of a run from its rows; locations are unknown without a camera."""
    boxes, distance_m = rows.boxes_px, rows["fused_m"]
    return BoxTable.of(
        rows["frame"],
        rows["track_id"],
        [str(name) for name in rows["class"]],
        boxes,
        score=rows["score"],
        observed=rows["observed"],
        distance_m=distance_m,
        sigma_m=rows["fused_sigma_m"],
        location_m=np.nan if camera is None else _bottom_centres_m(boxes, distance_m, camera),
        video=video,
    )


def _bottom_centres_m(
    xyxy_px: FloatArray, distance_m: FloatArray, camera: PinholeCamera
) -> FloatArray:
    """(N, 3) bottom centre of objects with boxes (N, 4) at distances (N,), in the camera's frame;
    NaN = unknown.
    """
    u = (xyxy_px[:, 0] + xyxy_px[:, 2]) / 2
    x, y = (u - camera.cx_px) / camera.fx_px, (xyxy_px[:, 3] - camera.cy_px) / camera.fy_px
    return np.stack([x, y, np.ones_like(x)], axis=1) * distance_m[:, None]
