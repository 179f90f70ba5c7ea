"""What the first frames of a pipeline would wait for, done before them."""

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.foundation.arrays import Image
from track_range.recording.cameras.calibration import LensView, calibration_of
from track_range.run.box_source import boxes_of
from track_range.run.build import open_pipeline
from track_range.run.options.settings import PipelineOptions
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig

_SIZE_PX, _FOCAL_PX, _BASELINE_M = (640, 360), 500.0, 0.3
_STEP_S, _N_STEPS = 0.1, 6  # a track is ranged from its third frame on
_MOTION_PX, _DISPARITY_PX = 4, 10
_CAR_PX = (280.0, 170.0, 360.0, 230.0)


class _OneCar:
    """A detector that sees a car at the same place in every image."""

    def detect(self, image: Image) -> Detections:
        del image
        return Detections.of([_CAR_PX], [0.9], [ROAD_CLASSES.index("car")])


def warm_up(options: PipelineOptions, *, is_pair: bool) -> None:
    """Use the parts of a pipeline but its networks on images of noise.

    Modules are then imported, and tables computed: of the sizes of road users, 0.2 s, and of
    OpenCV's colours, 0.07 s.
    """
    camera = PinholeCamera.of_focal_length(_FOCAL_PX, _SIZE_PX)
    cameras = StereoRig.rectified(camera, baseline_m=_BASELINE_M) if is_pair else camera
    calibration = calibration_of(cameras, (_SIZE_PX,) * (1 + is_pair), LensView())
    # networks of appearance and lanes are not opened twice
    usual = options.model_copy(update={"sgbm": False, "reid": None, "lanes": "classical"})
    stages = open_pipeline(usual, calibration, boxes_of(_OneCar()))
    noise = np.random.default_rng(0).integers(0, 256, (*_SIZE_PX[::-1], 3), np.uint8)
    for index in range(_N_STEPS):
        left = np.roll(noise, _MOTION_PX * index, axis=1)
        right = np.roll(left, -_DISPARITY_PX, axis=1) if is_pair else None
        frame = Frame(index, index * _STEP_S, left, right)
        stages.step(stages.detected(frame))
    stages.close()
