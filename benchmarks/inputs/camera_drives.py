"""Rendered drives whose cameras and sizes of cars differ from drive to drive, as those of users do.

Field of view, format, principal point, pitch, baseline and the mean size of the cars are drawn by
the seed, so that no estimator is measured on one camera, and none gets the sizes that it assumes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from track_range.simulation.drive import Drive, write_drive
from track_range.simulation.settings import DriveOptions
from track_range.simulation.world.scenarios import make_scenario
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.focal_guess import focal_of_field
from track_range.stereo.geometry.rig import StereoRig

SIZES_PX = ((1280, 720), (1240, 376))  # of even and odd seeds
FIELD_DEG = (45.0, 95.0)  # smallest and largest horizontal field of view
PRINCIPAL_FRACTION = 0.01  # spread of the principal point around the centre, of the width
PITCH_DEG, BASELINE_M = 1.0, (0.25, 0.6)
SIZE_SIGMA = 0.07  # spread of the logarithm of the mean size of a drive's cars: that of the prior
WIDE_DEG = 110.0  # horizontal field of view of a wide lens
SECONDS, FPS = 20.0, 10.0


@dataclass(frozen=True, slots=True)
class CameraDrive:
    """A drive and what an estimator of its cameras has to find."""

    scenario: str
    seed: int
    rig: StereoRig
    car_size: float  # mean size of the cars relative to the usual one
    pitch_deg: float
    turn_deg: float  # between the directions of the road farthest to the left and to the right
    name: str  # of the drive's folder

    @classmethod
    def drawn(cls, scenario: str, seed: int) -> CameraDrive:
        """The camera of a scenario and seed."""
        rng = np.random.default_rng([seed, 58, *scenario.encode()])
        width_px, height_px = SIZES_PX[seed % 2]
        focal_px = focal_of_field(rng.uniform(*FIELD_DEG), width_px)
        camera = PinholeCamera.of_focal_length(focal_px, (width_px, height_px))
        off_px = rng.normal(0, PRINCIPAL_FRACTION * width_px, 2)
        camera = replace(
            camera, cx_px=camera.cx_px + float(off_px[0]), cy_px=camera.cy_px + float(off_px[1])
        )
        return cls(
            scenario,
            seed,
            StereoRig.rectified(camera, float(rng.uniform(*BASELINE_M))),
            math.exp(rng.normal(0, SIZE_SIGMA)),
            float(rng.normal(0, PITCH_DEG)),
            _turn_deg(scenario, seed),
            f"{scenario}_{seed}",
        )

    @classmethod
    def wide(cls, seed: int) -> CameraDrive:
        """A drive with a turn that is recorded with a lens of 110 degrees, nearly equidistant."""
        rng = np.random.default_rng([seed, 59])
        half_rad, k1 = math.radians(WIDE_DEG / 2), float(rng.uniform(-0.04, 0.02))
        width_px, height_px = SIZES_PX[0]
        middle_x_px, middle_y_px = (width_px - 1) / 2, (height_px - 1) / 2
        focal_px = middle_x_px / (half_rad + k1 * half_rad**3)
        camera = PinholeCamera(
            *(focal_px, focal_px, middle_x_px, middle_y_px, width_px, height_px),
            (k1, 0.0, 0.0, 0.0),
            "kannala-brandt",
        )
        drawn = cls.drawn("winding", seed)
        return replace(drawn, rig=StereoRig.rectified(camera, 0.5), name=f"wide_{seed}")

    def files(self, cache_folder: Path) -> Drive:
        """The files of the drive in the cache folder; if they are not there, rendered first."""
        folder = cache_folder / self.name
        files = Drive.in_folder(folder)
        if not files.detections.exists():  # written last
            write_drive(
                folder,
                scenario=self.scenario,
                seed=self.seed,
                seconds=SECONDS,
                fps=FPS,
                rig=self.rig,
                options=DriveOptions(car_size=self.car_size, camera_pitch_deg=self.pitch_deg),
            )
        return files


def _turn_deg(scenario: str, seed: int) -> float:
    scene = make_scenario(scenario, seed=seed, seconds=SECONDS)
    z_m = scene.ego_z_m(np.arange(0, SECONDS, 1 / FPS))
    return float(np.degrees(np.ptp(scene.road.yaw_rad(z_m))))
