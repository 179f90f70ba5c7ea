"""RecordedDepthRanger: distance by the depth that a stereo or depth camera recorded beside its
images.

The error of a stereo camera grows with the square of the distance. Of OAK-D with a baseline of
75 mm, Luxonis states "below 2 % under 4 m, 4 % to 7 m, 6 % to 10.5 m" for a median device
(docs.luxonis.com, depth accuracy); RealSense D435 and ZED 2, of which the baselines are 50 and
120 mm, lie on both sides of it:

    sigma^2 = surface^2 + (0.5 % z)^2 + (0.0055/m z^2)^2
"""

import numpy as np

from track_range.ranging.measurement.dense_map import DenseMap
from track_range.ranging.measurement.dense_surfaces import box_surfaces
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import ErrorSource, MethodContext, Ranger, RangingMethod
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

_CALIBRATION_FRACTION, _MATCHING_PER_M = 0.005, 0.0055


class RecordedDepthRanger(Ranger):
    """Ranges each box by the recorded depth of the object's surface at its centre."""

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of observed boxes with a surface; NaN for others, and in frames without
        depth.
        """
        self.dense = None
        if frame.depth_m is None:
            return Ranges.unmeasured(tracks.track_id)
        self.dense = DenseMap(frame.depth_m, "depth", (frame.left.shape[0], frame.left.shape[1]))
        z, sigma_m = box_surfaces(self.dense, tracks.xyxy_px)
        z = np.where(tracks.observed, z, np.nan)
        shared_m = np.hypot(_CALIBRATION_FRACTION * z, _MATCHING_PER_M * z**2)
        return Ranges(tracks.track_id, z, np.hypot(sigma_m, shared_m))

    def skip(self, frame: Frame) -> None:
        """Show no depth of an image that only repeats another one."""
        self.dense = None


def _create(context: MethodContext) -> Ranger | None:
    return RecordedDepthRanger()


RECORDED = RangingMethod(
    name="recorded",
    title="recorded depth",
    letter="C",
    colour="#1f8a94",
    create=_create,
    needs=frozenset({"image", "recorded_depth"}),
    # calibration and matching of the device: of a track, most of it stays
    error_sources=(ErrorSource("own", systematic=0.6, independent=0.4),),
    is_optional=True,
)
