"""SimulatedDrive: images of a simulated drive in memory, and the edges of the ego lane in them.

An edge of the lane consists of points (x(z) + offset, y(z), z) at a constant lateral offset from the middle of the
road, which are projected into the image; columns between two points are interpolated, up to the first crest of the
road, behind which the road is hidden.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.settings import NO_FAULTS, Faults
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.surroundings import SURROUNDINGS
from track_range.stereo.geometry.frames import Frame

FPS = 10.0
"""Frame rate of the drives."""

NEAREST_M, FARTHEST_M, N_POINTS = 2.0, 90.0, 300
"""Range of depths ahead of the camera and number of the points of a lane edge."""


@dataclass(frozen=True, slots=True)
class SimulatedDrive:
    """A simulated drive with KITTI's field of view, rendered on demand.

    Attributes:
        renderer: renderer of the scene.
        times_s: (F,) times of the frames, from 0.
    """

    renderer: Renderer
    times_s: FloatArray

    @classmethod
    def of(cls, scenario: str, *, seed: int, seconds: float, faults: Faults = NO_FAULTS) -> SimulatedDrive:
        """A drive of a scenario at `FPS`, with `faults` of the cameras."""
        scene = make_scenario(scenario, seed=seed, seconds=seconds)
        renderer = Renderer(scene, kitti_like_rig(), faults=faults)
        return cls(renderer, np.arange(round(seconds * FPS)) / FPS)

    def left_images(self) -> list[Image]:
        """All left images, (H, W, 3) BGR."""
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            return list(threads.map(self.renderer.render, self.times_s.tolist()))

    def frames(self) -> list[Frame]:
        """All frames, with left and right images."""
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            return list(threads.map(self._frame, range(len(self.times_s))))

    def iter_frames(self) -> Iterator[Frame]:
        """All frames, rendered one after the other."""
        return map(self._frame, range(len(self.times_s)))

    def _frame(self, index: int) -> Frame:
        time_s = float(self.times_s[index])
        left, right = (self.renderer.render(time_s, side=side) for side in ("left", "right"))
        return Frame(index, time_s, left, right)

    def lane_px(self, y_px: FloatArray) -> FloatArray:
        """(F, 2, K) columns of the left and right edge of the ego lane in rows (K,), by frame; NaN = not visible."""
        return np.array([list(self._edges_px(time_s, y_px)) for time_s in self.times_s.tolist()])

    def _edges_px(self, time_s: float, y_px: FloatArray) -> Iterator[FloatArray]:
        """(K,) columns of the left, then of the right edge."""
        scene = self.renderer.scene
        lanes = SURROUNDINGS[scene.surroundings].lanes
        pose = scene.pose(time_s)
        z = scene.ego_z_m(time_s) + 1 / np.linspace(1 / NEAREST_M, 1 / FARTHEST_M, N_POINTS)
        for offset_m in next(edges for number, *edges in lanes if number == 0):
            world = np.stack([scene.road.x_m(z) + offset_m, scene.road.y_m(z), z], axis=1)
            points = (world - pose.position_m) @ pose.camera_from_world.T
            x, y = self.renderer.rig.left.project(points[points[:, 2] > 1.0]).T
            crest = 1 + int(np.argmax(np.diff(y, append=np.inf) >= 0))
            yield np.interp(y_px, y[:crest][::-1], x[:crest][::-1], left=np.nan, right=np.nan)
