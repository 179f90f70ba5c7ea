"""ShapeCheck: the focal length by the shapes of vehicles (`focal_evidence`), measured at a few moments of a drive.

A measurement takes about 0.7 s, in a thread. Its result is taken at a fixed time of the drive, so that runs are
reproducible.
"""

from __future__ import annotations

import math
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from track_range.ranging.doubt.scale_doubt import Evidence
from track_range.ranging.fitting.camera.focal_evidence import FocalPosterior, focal_posterior
from track_range.ranging.fitting.camera.measurements import FocalGuess, SceneBoxes, unhidden
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.tracking.tracks import Tracks

_VIEW_INTERVAL_S = 1.5  # between two views of a vehicle: those of successive frames are alike
_TIMES_S, _DELAY_S = (8.0, 40.0), 1.5  # times of measurements after the first frame, and until their results are used
_NO_GUESS = 3.0  # standard deviation of the guess at which only the shapes count
_INFLATION = 1.15  # of sigma: the errors on 11 drives of KITTI's labels, 24 s each, are 1.09 sigma (rms)


class ShapeCheck:
    """Measures the focal length of a camera; the state belongs to the instance."""

    def __init__(self, camera: PinholeCamera, sizes: CuboidSizes) -> None:
        self._camera, self._sizes = camera, sizes
        self._views: list[SceneBoxes] = []
        self._view_due_s, self._times_s, self._first_s = -math.inf, list(_TIMES_S), math.nan
        self._future: Future[FocalPosterior] | None = None
        self.evidence: Evidence | None = None  # log of the focal length over that by shapes; None = not measured

    def add(self, tracks: Tracks, time_s: float) -> None:
        """Add a frame."""
        self._first_s = time_s if math.isnan(self._first_s) else self._first_s
        if not self._times_s:
            return
        due_s = self._first_s + self._times_s[0]
        if self._future is not None and time_s >= due_s + _DELAY_S:
            posterior, self._future = self._future.result(), None
            del self._times_s[0]
            focal_px, sigma = posterior.guess
            if posterior.n_tracks:
                name = f"the shapes of {posterior.n_tracks} vehicles"
                error = math.log(self._camera.fx_px / focal_px)
                self.evidence = Evidence(name, (0, 0, 0, 1, 0), error, _INFLATION * sigma)
            return
        if time_s >= self._view_due_s:
            self._view_due_s = time_s + _VIEW_INTERVAL_S
            rows = np.flatnonzero(tracks.observed & unhidden(tracks.xyxy_px))
            self._views.append(SceneBoxes(tracks.xyxy_px[rows], tracks.class_id[rows], tracks.track_id[rows]))
        if self._future is None and time_s >= due_s:
            boxes, guess = SceneBoxes.joined(self._views), FocalGuess(self._camera.fx_px, _NO_GUESS, "")
            thread = ThreadPoolExecutor(1, thread_name_prefix="shapes")
            self._future = thread.submit(focal_posterior, [guess], boxes, self._camera.size_px, self._sizes)
            thread.shutdown(wait=False)
