"""Bags that people recorded, each with what is right: focal length, principal point, baseline, times
and the note that says what is missing or guessed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from track_range.recording.recording import open_recording
from track_range.recording.sources.names import video_name
from track_range.recording.video.frame import VideoError


@dataclass(frozen=True, kw_only=True)
class Case:
    """A bag of the shared folder, the topics, and what a run should find."""

    name: str
    bag: str
    topics: tuple[str, ...]
    focal_px: float
    cx_px: float | None = None
    distortion: float = 0.0  # k1 of the images before they are undistorted
    baseline_m: float | None = None
    n_frames: int
    step_s: float = 0.1
    note: str


CASES = (
    Case(
        name="bag_K0_P_stereo",
        bag="k0.bag",
        topics=tuple(f"/multisense/{side}/image_rect/compressed" for side in ("left", "right")),
        focal_px=360.77,
        baseline_m=0.5327,
        n_frames=5,
        note="Using calibration /multisense/right/camera_info",
    ),
    Case(
        name="bag_nanosec_overflow",
        bag="ns.bag",
        topics=("/cam/image_raw/compressed",),
        focal_px=180.38,
        n_frames=46,
        note="the times of recording are used",
    ),
    Case(
        name="bag_one_info",
        bag="one.bag",
        topics=tuple(f"/stereo/{side}/image_raw/compressed" for side in ("left", "right")),
        focal_px=360.77,
        n_frames=5,
        note="/stereo/right/image_raw/compressed): no calibration",
    ),
    Case(
        name="bag_roi_mono",
        bag="roi.bag",
        topics=("/cam/left/image_raw/compressed",),
        focal_px=721.54,
        cx_px=299.56,
        n_frames=10,
        note="Using calibration /cam/left/camera_info",
    ),
    Case(
        name="bag_ros1_split",
        bag="split",
        topics=("/cam/image_raw/compressed",),
        focal_px=180.38,
        n_frames=20,
        note="Using calibration /cam/camera_info of",
    ),
    Case(
        name="bag_topic_color_corrected",
        bag="c.bag",
        topics=("/alphasense_driver_node/cam1/color_corrected/image/compressed",),
        focal_px=360.77,
        distortion=-0.2,
        n_frames=9,
        note="K and D, 361 px, as of raw images",
    ),
)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_bag(shared_data: Path, case: Case) -> None:
    bags = [shared_data / "cases" / case.name / case.bag] * len(case.topics)
    recording = open_recording(*bags, topics=case.topics, align="off", has_checks=False)
    camera, recorded = recording.camera, recording.calibration.raw_camera
    assert recorded is not None
    assert camera.fx_px == pytest.approx(case.focal_px, abs=0.01)
    assert case.cx_px is None or camera.cx_px == pytest.approx(case.cx_px, abs=0.01)
    assert (recorded.distortion or (0.0,))[0] == pytest.approx(case.distortion)
    if case.baseline_m is not None:
        assert recording.rig is not None
        assert recording.rig.baseline_m == pytest.approx(case.baseline_m, abs=1e-4)
    times_s = [frame.time_s for frame in recording.frames]
    assert len(times_s) == case.n_frames
    assert np.diff(times_s) == pytest.approx(case.step_s, abs=0.002)
    notes = (*recording.notes, *(note for video in recording.videos for note in video.notes))
    assert any(case.note in note for note in notes)
    recording.close()


def test_files_of_a_split_bag_one_by_one(shared_data: Path) -> None:
    files = sorted((shared_data / "cases/bag_ros1_split/split").glob("*.bag"))
    with pytest.raises(VideoError, match="the folder of the files of one bag"):
        open_recording(video_name(files), topics=["/cam/image_raw/compressed"])
