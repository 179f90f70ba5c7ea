r"""The loop: frames in, what is known about each frame out, with reading, inference and writing overlapped.

reading thread      detection thread           caller's thread                     (the writer's thread: results)
frame ------------> detect ------------------> track, measure, fuse, filter -----> FrameResult
              \---> dense disparity (a thread of its own) ---/
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from threading import Lock

import numpy as np

from detection.detections import Detections, FloatArray
from ranging.fusion import contributors, fuse
from ranging.ranger import Ranger
from ranging.ranges import Ranges
from ranging.smoothing import DistanceFilter, FilterSettings
from ranging.triangulation import DenseRanger
from stereo.camera import PinholeCamera
from stereo.frames import Frame
from track_range.overlap import prefetch
from track_range.results import FrameResult
from tracking.tracker import Tracker
from tracking.tracks import Tracks

STAGES = ("read", "detect", "track", "mono", "lane", "stereo", "sgbm", "fuse", "write")

NOISE_SHARES: Mapping[str, float] = {"mono": 0.4, "stereo": 0.3, "fused": 0.35}
"""Methods with a distance filter, and the part of their sigma that is independent from frame to frame.

From repeatability, without any truth, on a drive that no error is quoted for (KITTI odometry, 51 grey pairs): scatter
about a parabola over five frames, divided by sigma, median 0.31, 0.17 and 0.28; a little more for outliers.
"""

_MIN_CLOSING_MPS = 0.3  # slower than this is "not closing": the time to collision would be minutes of noise
_READ_AHEAD = 4
_DETECT_AHEAD = 2
_BY_THE_WALL = ("detect",)  # stages whose time is the wall's, since they have threads of their own


class StageClock:
    """Seconds of work in each stage, counted from whichever thread does it.

    Inference has threads of its own and is timed by the wall's clock; the other stages work in one thread, and their
    processor time is counted: waiting for a core, since they give way to inference, is no cost of theirs.
    """

    def __init__(self) -> None:
        """Start at zero."""
        self.busy_s = dict.fromkeys(STAGES, 0.0)
        self._lock = Lock()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the with-block to a stage."""
        now_s = time.perf_counter if name in _BY_THE_WALL else time.thread_time
        began_s = now_s()
        try:
            yield
        finally:
            with self._lock:
                self.busy_s[name] += now_s() - began_s


@dataclass(slots=True, kw_only=True)
class Pipeline:
    """The stages of one run; what they remember belongs to the instance.

    Attributes:
        camera: the left camera that the frames seem to come from.
        detect: boxes of a frame.
        tracker: gives them identities.
        rangers: methods by name ("mono", "stereo"), measured side by side.
        dense: dense matching in its own thread ("sgbm"); None = not wanted.
        shared_sigma: relative error that all methods share, from a focal length that nobody has calibrated.
        clock: where the time goes.
    """

    camera: PinholeCamera
    detect: Callable[[Frame], Detections]
    tracker: Tracker
    rangers: Mapping[str, Ranger]
    dense: DenseRanger | None = None
    shared_sigma: float = 0.0
    clock: StageClock = field(default_factory=StageClock)
    _filters: dict[str, DistanceFilter] = field(default_factory=dict)

    def run(self, frames: Iterable[Frame]) -> Generator[FrameResult, None, None]:
        """The results of each frame in order; closing the generator ends the threads."""
        detected = prefetch(self._detected(prefetch(frames, depth=_READ_AHEAD, gives_way=True)), depth=_DETECT_AHEAD)
        try:
            for frame, detections in detected:
                yield self._result(frame, detections)
        finally:
            detected.close()
            if self.dense is not None:
                self.dense.close()
                self.clock.busy_s["sgbm"] = self.dense.busy_s

    def _detected(self, frames: Iterable[Frame]) -> Iterator[tuple[Frame, Detections]]:
        for frame in frames:
            if self.dense is not None:
                self.dense.start(frame)
            with self.clock.stage("detect"):
                detections = self.detect(frame)
            yield frame, detections

    def _result(self, frame: Frame, detections: Detections) -> FrameResult:
        with self.clock.stage("track"):
            tracks = self.tracker.update(detections, frame.time_s, frame.left)
        ranges: dict[str, Ranges] = {}
        for name, ranger in self.rangers.items():
            with self.clock.stage(name):
                ranges[name] = ranger.measure(tracks, frame)
        if self.dense is not None:
            ranges["sgbm"] = self.dense.measure(tracks, frame)
        with self.clock.stage("fuse"):
            return self._fused(frame, tracks, ranges)

    def _fused(self, frame: Frame, tracks: Tracks, ranges: dict[str, Ranges]) -> FrameResult:
        way = contributors(ranges, tracks.track_id)
        ranges["fused"] = fuse(ranges, tracks.track_id)
        rate_mps = np.full(len(tracks), np.nan)
        for name in NOISE_SHARES.keys() & ranges.keys():
            filtered = self._filter(name).update(ranges[name], frame.time_s, way=way if name == "fused" else None)
            ranges[f"{name}_kf"] = filtered.ranges
            rate_mps = filtered.rate_mps if name == "fused" else rate_mps
        closing_mps = -rate_mps
        closes = np.where(closing_mps > _MIN_CLOSING_MPS, closing_mps, np.nan)
        return FrameResult(
            frame=frame,
            tracks=tracks,
            ranges=self._with_shared_error(ranges),
            closing_mps=closing_mps,
            ttc_s=ranges["fused_kf"].distance_m / closes,
            xyz_m=self._points_m(tracks, ranges["fused"].distance_m),
            disparity=None if self.dense is None else self.dense.disparity,
        )

    def _with_shared_error(self, ranges: Mapping[str, Ranges]) -> Mapping[str, Ranges]:
        """With wider sigmas: neither fusing nor filtering makes an error smaller that all methods share."""
        if not self.shared_sigma:
            return ranges
        return {
            name: replace(found, sigma_m=np.hypot(found.sigma_m, self.shared_sigma * found.distance_m))
            for name, found in ranges.items()
        }

    def _filter(self, name: str) -> DistanceFilter:
        if name not in self._filters:
            self._filters[name] = DistanceFilter(FilterSettings(noise_share=NOISE_SHARES[name]))
        return self._filters[name]

    def _points_m(self, tracks: Tracks, distance_m: FloatArray) -> FloatArray:
        """(N, 3) points at these depths on the rays through the boxes' centres."""
        centre_px = (tracks.xyxy_px[:, :2] + tracks.xyxy_px[:, 2:]) / 2
        return self.camera.rays(centre_px) * distance_m[:, None]
