"""What never moves in a recording, before its run."""

from contextlib import closing
from itertools import islice

import pytest

from track_range.calibration.drive.shown_fixed_parts import shown_fixed_parts
from track_range.detection.detections import Detections
from track_range.recording.recording import open_recording

THING_ON_THE_DASHBOARD = (271.0, 620.0, 544.0, 720.0)
MIRROR = (486.0, 0.0, 681.0, 51.0)
CAR_BEHIND_TEXT = (3.0, 468.0, 396.0, 713.0)
LEAD_VEHICLE = (530.0, 520.0, 732.0, 660.0)


@pytest.mark.real
def test_things_on_the_dashboard_are_no_road_users_and_a_car_behind_text_is_one(shared_data):
    video = shared_data / "crashes" / "000540.mp4"
    if not video.exists():
        pytest.skip("no dashcam clips in the folder of real data")
    with closing(open_recording(video)) as recording:
        parts = shown_fixed_parts(recording, lambda: open_recording(video))
        frame = next(islice(recording.frames, 67, None))
    boxes = [THING_ON_THE_DASHBOARD, CAR_BEHIND_TEXT, MIRROR, LEAD_VEHICLE]
    kept = parts.moving(Detections.of(boxes, [0.9] * 4, [2, 2, 7, 5]), frame.left)
    assert kept.xyxy_px.tolist() == [[*CAR_BEHIND_TEXT], [*LEAD_VEHICLE]]


@pytest.mark.real
def test_nothing_is_fixed_in_a_drive_without_text(shared_data):
    video = shared_data / "dashcam" / "solid_white_right.mp4"
    with closing(open_recording(video)) as recording:
        parts = shown_fixed_parts(recording, lambda: open_recording(video))
    assert parts.n_images >= 10
    assert parts.is_fixed.mean() < 0.005
