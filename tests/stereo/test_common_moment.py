"""The offset of two clocks from the images of a simulated drive, in which each video begins elsewhere."""

import cv2
import numpy as np
import pytest

from track_range.recording.recording import open_recording
from track_range.stereo.alignment.common_moment import TimedImages, found_offset
from track_range.stereo.geometry.frames import grey, whole_image


@pytest.fixture(scope="module")
def views(render_drive):
    """Grey left and right images of a drive of 25 frames, 10 per second."""
    drive = render_drive(seed=3, seconds=2.5)
    recording = open_recording(
        drive.left, drive.right, rig=drive.rig, align="off", has_checks=False
    )
    frames = list(recording.frames)
    return [
        [np.asarray(grey(whole_image(view))) for view in side]
        for side in zip(*((frame.left, frame.right) for frame in frames), strict=True)
    ]


def timed(images):
    return TimedImages([number / 10 for number in range(len(images))], images)


@pytest.mark.parametrize("lag", [0, 1, -3, 7, -9])
def test_offset(views, lag):
    left, right = views
    offset = found_offset(timed(left[max(0, -lag) :]), timed(right[max(0, lag) :]))
    assert offset.kind == "found"
    assert offset.value_s == pytest.approx(lag / 10)
    assert offset.points > 1.8 * offset.other_points


def test_another_scene(views):
    left, right = views
    other = [cv2.flip(image, 0) for image in right]
    assert found_offset(timed(left), timed(other)).kind == "apart"


def test_camera_at_rest_and_few_images(views):
    left, right = views
    assert found_offset(timed([left[5]] * 20), timed([right[5]] * 20)).kind == "unknown"
    assert found_offset(timed(left[:1]), timed(right)).kind == "unknown"
    blank = [np.full_like(left[0], 90)] * 9
    assert found_offset(timed(blank), timed(blank)).kind == "unknown"
