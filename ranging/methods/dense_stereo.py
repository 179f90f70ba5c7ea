"""DenseRanger: stereo distance from the dense disparity image of semi-global matching (SGBM)."""

import time
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from track_range.foundation.arrays import FloatArray32
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import ErrorSource, MethodContext, Ranger, RangingMethod
from track_range.ranging.methods.triangulation import Triangulation
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame, ImageView, whole_image
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.sgbm import Sgbm, SgbmSettings, inner_half_median
from track_range.tracking.tracks import Tracks


class DenseRanger(Ranger):
    """Ranges each box by the median dense disparity in its inner half; matching runs in a
    background thread.
    """

    def __init__(
        self,
        rig: StereoRig,
        settings: SgbmSettings | None = None,
        *,
        alignment: Alignment | None = None,
    ) -> None:
        """Create a ranger for a rectified rig; `alignment` corrects its disparities, None = that of
        each frame, or of the rig.
        """
        self._rig, self._given = rig, alignment
        self._triangulate = Triangulation(rig)
        self._settings = settings or SgbmSettings.for_rig(rig)
        self._sgbm = Sgbm(self._settings)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="sgbm")
        # by frame: the right image, and its disparities
        self._pending: dict[int, tuple[ImageView | None, Future[FloatArray32]]] = {}

    def start(self, frame: Frame) -> None:
        """Compute the disparity image of a frame in the background; `measure` waits for it."""
        self._pending[frame.index] = frame.right, self._thread.submit(self._disparity, frame)

    def skip(self, frame: Frame) -> None:
        """Drop the disparity image of a frame."""
        pending = self._pending.pop(frame.index, None)
        if pending is not None:
            pending[1].cancel()

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of observed boxes with enough valid disparities; NaN for other boxes."""
        pending = self._pending.get(frame.index)
        if pending is None or pending[0] is not frame.right:
            self.skip(frame)
            self.start(frame)
        self.disparity = disparity = self._pending.pop(frame.index)[1].result()
        disparity_px, sigma_px = inner_half_median(
            disparity, tracks.xyxy_px, settings=self._settings
        )
        disparity_px = np.where(tracks.observed, disparity_px, np.nan)
        alignment = self._given or self._rig.alignment_of(frame)
        return self._triangulate.ranges(tracks, disparity_px, sigma_px, alignment)

    def close(self) -> None:
        """Drop pending frames and end the thread."""
        self._thread.shutdown(wait=True, cancel_futures=True)

    def _disparity(self, frame: Frame) -> FloatArray32:
        if frame.right is None:
            return np.full(frame.left.shape[:2], np.nan, np.float32)
        start_s = time.perf_counter()
        disparity = self._sgbm.dense_disparity(frame.left, whole_image(frame.right))
        self.background_s += time.perf_counter() - start_s
        return disparity


def _create(context: MethodContext) -> Ranger | None:
    if context.rig is None:
        return None
    settings = SgbmSettings.for_rig(context.rig, chosen=context.sgbm_options)
    return DenseRanger(context.rig, settings)


SGBM = RangingMethod(
    name="sgbm",
    title="dense stereo",
    letter="G",
    colour="#7f8a95",
    create=_create,
    needs=frozenset({"rig", "right_image", "dense_disparity"}),
    error_sources=(ErrorSource("baseline", systematic=0.91), ErrorSource("own", independent=0.09)),
    fallback_for="stereo",
)
