"""Evidence of the focal length by the shapes of vehicles."""

import math
from concurrent.futures import Future

import numpy as np

from track_range.foundation.background import Background, InThreads
from track_range.ranging.cameras.evidence import Evidence, SeenFrame
from track_range.ranging.cameras.focal_evidence import VehicleShapes, vehicle_shapes
from track_range.ranging.cameras.measurements import SceneBoxes, unhidden
from track_range.ranging.cameras.unknowns import OF_FOCAL
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.stereo.geometry.camera import PinholeCamera

_VIEW_INTERVAL_S = 1.5  # between two views of a vehicle: those of successive frames are alike
# times of measurements after the first frame, and until their results are used
_TIMES_S, _DELAY_S = (8.0, 40.0), 1.5
# of sigma: the errors on 11 drives of KITTI's labels, 24 s each, are 1.09 sigma (rms)
_INFLATION = 1.15


class ShapeEvidence:
    """Focal length by the shapes of vehicles (`focal_evidence`), measured at a few moments of a
    drive.

    A measurement takes about 0.7 s, in the background; its result is used at a fixed time, so
    that runs are reproducible, or later.
    """

    def __init__(
        self, camera: PinholeCamera, sizes: CuboidSizes, background: Background | None = None
    ) -> None:
        self._background = background or InThreads()
        self._camera, self._sizes = camera, sizes
        self._views: list[SceneBoxes] = []
        self._view_due_s, self._times_s, self._first_s = -math.inf, list(_TIMES_S), math.nan
        self._future: Future[VehicleShapes] | None = None
        # log of the focal length over that by shapes
        self.evidence: tuple[Evidence, ...] = ()

    def add(self, seen: SeenFrame) -> None:
        """Add a frame."""
        tracks, time_s = seen.tracks, seen.time_s
        self._first_s = time_s if math.isnan(self._first_s) else self._first_s
        if not self._times_s:
            return
        due_s = self._first_s + self._times_s[0]
        if self._future is not None and time_s >= due_s + _DELAY_S:
            if not self._background.is_ready(self._future):
                return
            shapes, self._future = self._future.result(), None
            del self._times_s[0]
            focal_px, sigma = shapes.curve.estimate
            if shapes.n_tracks:
                error = math.log(self._camera.fx_px / focal_px)
                self.evidence = (Evidence(shapes.name, OF_FOCAL, error, _INFLATION * sigma),)
            return
        if time_s >= self._view_due_s:
            self._view_due_s = time_s + _VIEW_INTERVAL_S
            rows = np.flatnonzero(tracks.observed & unhidden(tracks.xyxy_px))
            self._views.append(
                SceneBoxes(tracks.xyxy_px[rows], tracks.class_id[rows], tracks.track_id[rows])
            )
        if self._future is None and time_s >= due_s:
            boxes = SceneBoxes.joined(self._views)
            self._future = self._background.submit(
                vehicle_shapes, boxes, self._camera.size_px, self._sizes
            )
