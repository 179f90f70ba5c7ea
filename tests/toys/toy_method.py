"""A ranging method of another package: distance from the width of the box, as if everything were
1.8 m wide."""

import numpy as np

from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import ErrorSource, Ranger, RangingMethod


class BoxWidthRanger(Ranger):
    def __init__(self, camera):
        self._fx_px = camera.fx_px
        self._n = 0

    def measure(self, tracks, frame):
        width_px = tracks.xyxy_px[:, 2] - tracks.xyxy_px[:, 0]
        distance_m = np.where(tracks.observed, self._fx_px * 1.8 / width_px, np.nan)
        self._n += len(tracks)
        return Ranges(tracks.track_id, distance_m, 0.1 * distance_m)

    @property
    def notes(self):
        return (f"toy: {self._n} boxes.",)

    def summary(self):
        return {"toy_boxes": self._n}


TOY = RangingMethod(
    name="toy",
    title="box width",
    letter="W",
    colour="#a04040",
    create=lambda context: BoxWidthRanger(context.camera),
    error_sources=(ErrorSource("size", systematic=0.75), ErrorSource("own", independent=0.25)),
    is_filtered=True,
)
