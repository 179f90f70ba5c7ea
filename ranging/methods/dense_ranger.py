"""DenseMapRanger: a ranger that computes a dense map of each frame in a background thread, and
DisparityMapRanger: one whose maps are disparities of the pair.
"""

import time
from abc import abstractmethod
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.measurement.dense_map import DenseMap, MapPair
from track_range.ranging.measurement.dense_surfaces import box_surfaces
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import Ranger
from track_range.ranging.methods.triangulation import Triangulation
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame, ImageView
from track_range.stereo.geometry.rig import StereoRig
from track_range.tracking.tracks import Tracks

_Images = tuple[ImageView, ImageView | None]


class DenseMapRanger(Ranger):
    """Computes one dense map per frame, in a thread of its own, before the tracks are known.

    A subclass implements `map_of`, and its `measure` begins with `dense_map`.
    """

    uses_right_image = False  # whether another right image of a frame needs another map

    def __init__(self, name: str) -> None:
        """Create a ranger of the method `name`, which names its thread."""
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=name)
        # by number of the frame: its images, and its map
        self._pending: dict[int, tuple[_Images, Future[DenseMap | None]]] = {}

    @abstractmethod
    def map_of(self, frame: Frame) -> DenseMap | None:
        """The dense map of a frame; None = it has none. Called in the background."""

    def start(self, frame: Frame) -> None:
        """Compute the map of a frame in the background; `dense_map` waits for it."""
        self._pending[frame.index] = self._images(frame), self._thread.submit(self._timed, frame)

    def skip(self, frame: Frame) -> None:
        """Drop the map of a frame."""
        self.dense = None
        pending = self._pending.pop(frame.index, None)
        if pending is not None:
            pending[1].cancel()

    def dense_map(self, frame: Frame) -> DenseMap | None:
        """The map of a frame, computed now if it was not started, or with other images."""
        pending = self._pending.get(frame.index)
        images = self._images(frame)
        if pending is None or any(
            one is not other for one, other in zip(pending[0], images, strict=True)
        ):
            self.skip(frame)
            self.start(frame)
        self.dense = self._pending.pop(frame.index)[1].result()
        return self.dense

    def close(self) -> None:
        """Drop pending frames and end the thread."""
        self._thread.shutdown(wait=True, cancel_futures=True)

    def _images(self, frame: Frame) -> _Images:
        return frame.left, frame.right if self.uses_right_image else None

    def _timed(self, frame: Frame) -> DenseMap | None:
        start_s = time.perf_counter()
        dense = self.map_of(frame)
        self.background_s += time.perf_counter() - start_s
        return dense


class DisparityMapRanger(DenseMapRanger):
    """Ranges each box by the disparity of the object's surface at its centre in a dense map."""

    uses_right_image = True

    def __init__(self, name: str, rig: StereoRig, *, alignment: Alignment | None = None) -> None:
        """Create a ranger for a rectified rig; `alignment` corrects its disparities, None = that of
        each frame, or of the rig.
        """
        super().__init__(name)
        self._rig, self._given = rig, alignment
        self._triangulate = Triangulation(rig)

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of observed boxes with a surface; NaN for other boxes."""
        dense = self.dense_map(frame)
        if dense is None:
            return Ranges.unmeasured(tracks.track_id)
        alignment = self._given or self._rig.alignment_of(frame)
        self.dense = replace(dense, pair=MapPair(self._rig, alignment))
        disparity_px, sigma_px = self.surfaces(dense, tracks.xyxy_px)
        disparity_px = np.where(tracks.observed, disparity_px, np.nan)
        return self._triangulate.ranges(tracks, disparity_px, sigma_px, alignment)

    def surfaces(self, dense: DenseMap, xyxy_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Disparities of boxes (N, 4) and their standard deviations without that of the alignment,
        (N,) px each.
        """
        return box_surfaces(dense, xyxy_px)
