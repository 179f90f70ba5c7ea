"""KnownPlaneRanger: distance by the contact point on the known plane of the road, before a camera that
stands still.
"""

import numpy as np

from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import Ranger
from track_range.ranging.size_models.size_model import BORDER_PX, BoxNoise, surface_offset_m
from track_range.ranging.world.road_plane import RoadPlane
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

_NOISE = BoxNoise(px=1.0)
_FOOT_M = 0.3  # of a contact point, by kerbs and by wheels behind a bumper


class KnownPlaneRanger(Ranger):
    """Measures each observed box whose lower edge is inside the image."""

    def __init__(self, plane: RoadPlane) -> None:
        self._plane = plane

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances along the axis of the camera to the surfaces of N tracks, NaN = not measured."""
        plane, boxes = self._plane, tracks.xyxy_px
        size_px = boxes[:, 2:] - boxes[:, :2]
        edge_px = _NOISE.sigma_px(size_px, tracks.class_id)[:, 1]
        feet = np.stack([(boxes[:, 0] + boxes[:, 2]) / 2, boxes[:, 3]], axis=1)
        lower = feet + np.stack([np.zeros(len(feet)), edge_px], axis=1)
        view, axis = plane.view, plane.view.rotation[0, :2, 2]
        # along the axis: the part on the road, and that of the height
        height = view.height_m[0] * view.rotation[0, 2, 2]
        depth_m, lower_m = (
            (plane.on_road_m(at_px) - view.theta[0, 7:9]) @ axis - height for at_px in (feet, lower)
        )
        members_m = (
            plane.family.on_road_m(feet) - plane.family.theta[:, None, 7:9]
        ) @ axis - height
        shared = np.nan_to_num(members_m - depth_m)
        sigma_m = np.sqrt((depth_m - lower_m) ** 2 + (shared**2).sum(axis=0) + _FOOT_M**2)
        is_whole = tracks.observed & (boxes[:, 3] < plane.size_px[1] - 1 - BORDER_PX)
        offset_m = surface_offset_m(boxes, tracks.class_id, has_visible_boxes=True)
        unknown = np.where(is_whole & (sigma_m < depth_m / 2), 0.0, np.nan)
        return Ranges(tracks.track_id, depth_m + offset_m + unknown, sigma_m + unknown)
