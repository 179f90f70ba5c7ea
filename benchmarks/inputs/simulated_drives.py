"""Simulated drives in memory: pictures of one eye or both, and where the own lane's edges are in them.

An edge lies so far across from the road's middle, (x(z) + across, y(z), z), and is projected like anything else;
columns of rows between two of its points are interpolated, up to the first crest of the road, which hides the rest.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.camera.faults import NO_FAULTS, Faults
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.surroundings import SURROUNDINGS
from track_range.stereo.geometry.frames import Frame

FPS = 10.0
NEAREST_M, FARTHEST_M, N_PLACES = 2.0, 90.0, 300


@dataclass(frozen=True, slots=True)
class SimulatedDrive:
    """A drive that is drawn when it is looked at, with KITTI's angle of view.

    Attributes:
        renderer: draws its scene.
        times_s: (F,) of its frames, from 0 on.
    """

    renderer: Renderer
    times_s: FloatArray

    @classmethod
    def of(cls, scenario: str, *, seed: int, seconds: float, faults: Faults = NO_FAULTS) -> SimulatedDrive:
        """A drive at `FPS`."""
        scene = make_scenario(scenario, seed=seed, seconds=seconds)
        renderer = Renderer(scene, kitti_like_rig(), faults=faults)
        return cls(renderer, np.arange(round(seconds * FPS)) / FPS)

    def left_images(self) -> list[Image]:
        """The left eye's, (H, W, 3) BGR."""
        with ThreadPoolExecutor(os.cpu_count()) as drawing:
            return list(drawing.map(self.renderer.render, self.times_s.tolist()))

    def frames(self) -> list[Frame]:
        """Both eyes'."""
        with ThreadPoolExecutor(os.cpu_count()) as drawing:
            return list(drawing.map(self._frame, range(len(self.times_s))))

    def _frame(self, index: int) -> Frame:
        time_s = float(self.times_s[index])
        return Frame(index, time_s, *(self.renderer.render(time_s, side=side) for side in ("left", "right")))

    def lane_px(self, y_px: FloatArray) -> FloatArray:
        """(F, 2, K) columns of the own lane's left and right edge in rows (K,) of each frame; NaN where not seen."""
        return np.array([list(self._edges_px(time_s, y_px)) for time_s in self.times_s.tolist()])

    def _edges_px(self, time_s: float, y_px: FloatArray) -> Iterator[FloatArray]:
        scene = self.renderer.scene
        lanes = SURROUNDINGS[scene.surroundings].lanes
        pose = scene.pose(time_s)
        z = scene.ego_z_m(time_s) + 1 / np.linspace(1 / NEAREST_M, 1 / FARTHEST_M, N_PLACES)
        for across_m in next(edges for number, *edges in lanes if number == 0):
            world = np.stack([scene.road.x_m(z) + across_m, scene.road.y_m(z), z], axis=1)
            seen = (world - pose.place_m) @ pose.camera_from_world.T
            x, y = self.renderer.rig.left.project(seen[seen[:, 2] > 1.0]).T
            crest = 1 + int(np.argmax(np.diff(y, append=np.inf) >= 0))  # behind it the road is hidden
            yield np.interp(y_px, y[:crest][::-1], x[:crest][::-1], left=np.nan, right=np.nan)
