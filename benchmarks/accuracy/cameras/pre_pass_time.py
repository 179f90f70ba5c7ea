"""Time of the pre-pass of a recording: the whole, and its parts one after another."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from benchmarks.harness import Figures
from track_range.calibration.drive.drive_video import DriveVideo, every_step
from track_range.calibration.drive.pre_pass import PrePass
from track_range.calibration.drive.road_evidence import STEP_S
from track_range.detection.formats.detection_files import RecordedDetections, read_detections
from track_range.ranging.size_models.curve import load_curves
from track_range.recording.sources.names import video_name
from track_range.stereo.self_calibration.scene_motion import SceneMotion

VIDEO_S = 20.0  # length of video to which times are scaled
REPETITIONS = 3
_GAP_S = 1e6  # between the times of two parts, so that no track goes over it


def pre_pass_times(video: Path, detections: Path) -> Figures:
    """Seconds of one thread per 20 s of video, medians of some repetitions: the pre-pass with
    recorded boxes as a run calls it, and alone the search for turns, decoding the parts that are
    read, tracking corners in them, and the bundle adjustment of their motion.

    The network is not in it: a run does not detect the frames of the pre-pass again.
    """
    cv2.setNumThreads(1)
    recorded = read_detections(detections, default_class_id=0)
    drive, sizes = DriveVideo.of(video_name(str(video))), load_curves(None, "europe")
    pre_pass = PrePass(detect=lambda frame: recorded.at(frame.index), sizes=sizes)
    scale = VIDEO_S / drive.duration_s
    whole = [_timed(lambda: pre_pass.camera_of([drive])) for _ in range(REPETITIONS)]
    parts = [_parts_s(drive, recorded) for _ in range(REPETITIONS)]
    figures = {name: scale * float(np.median([one[name] for one in parts])) for name in parts[0]}
    return {
        "cpu_s": scale * float(np.median([cpu_s for cpu_s, _ in whole])),
        "wall_s": scale * float(np.median([wall_s for _, wall_s in whole])),
        **figures,
    }


def _timed(do: Callable[[], object]) -> tuple[float, float]:
    """Processor time and wall time, s."""
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    do()
    return time.process_time() - cpu_s, time.perf_counter() - wall_s


def _parts_s(drive: DriveVideo, recorded: RecordedDetections) -> dict[str, float]:
    """Processor time of each step."""
    began_s = time.process_time()
    spans_s = drive.parts_s()
    turns_s = time.process_time() - began_s
    motion = SceneMotion(drive.size_px, start_px=drive.guesses[-1].focal_px)
    decode_s, track_s = 0.0, 0.0
    for number, (start_s, duration_s) in enumerate(spans_s):
        began_s = time.process_time()
        with drive.opened(start_s, duration_s) as recording:
            frames = [*every_step(STEP_S, recording.frames)]
        decoded_s = time.process_time()
        for frame in frames:
            boxes_px = recorded.at(frame.index).xyxy_px
            motion.add(frame.left, number * _GAP_S + frame.time_s, boxes_px)
        decode_s += decoded_s - began_s
        track_s += time.process_time() - decoded_s
    bundle_s, _ = _timed(motion.estimate)
    return {"turns_s": turns_s, "decode_s": decode_s, "track_s": track_s, "bundle_s": bundle_s}
