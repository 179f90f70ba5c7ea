"""Corners of a texture that moves by known pixels."""

import cv2
import numpy as np
import pytest

from track_range.stereo.self_calibration.corner_tracks import CornerTracks, KeyPoints

SIZE_PX = (400, 240)
NO_BOXES = np.zeros((0, 4))


def drive(shifts_px: list[int], step_s: float, boxes: np.ndarray = NO_BOXES) -> list[KeyPoints]:
    """The keyframes of a texture that moves to the left by these pixels from image to image."""
    noise = np.random.default_rng(4).integers(0, 255, (240, 1200), np.uint8)
    texture = cv2.GaussianBlur(noise, (0, 0), 2.0)
    tracks = CornerTracks(SIZE_PX)
    found = []
    for number, start in enumerate(np.cumsum(shifts_px).tolist()):
        image = np.ascontiguousarray(texture[:, start : start + SIZE_PX[0]])
        found.append(tracks.add(image, step_s * number, boxes))
    return [one for one in found if one is not None]


def test_points_move_with_the_texture_between_images_that_are_far_enough_apart() -> None:
    keyframes = drive([0] + [3] * 10, 0.1)
    assert [one.time_s for one in keyframes] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    first, last = keyframes[0], keyframes[-1]
    _, i, j = np.intersect1d(first.number, last.number, return_indices=True)
    assert len(i) > 100
    moved_px = last.xy_px[j] - first.xy_px[i]
    assert np.abs(moved_px - [-30.0, 0.0]).max() < 0.1


def test_a_standing_camera_has_one_keyframe_and_boxes_have_no_points() -> None:
    (only,) = drive([0] * 6, 0.2, np.array([[100.0, 0.0, 200.0, 239.0]]))
    is_inside = (only.xy_px[:, 0] > 97) & (only.xy_px[:, 0] < 203)
    assert len(only.number) > 100
    assert not is_inside.any()
