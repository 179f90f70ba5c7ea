import cv2
import numpy as np
import pytest

from track_range.foundation.sparse_flow import (
    BackgroundFlow,
    isotropy,
    masked_cells,
    ranked_corners,
    small_grey,
)
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.image_motion import ImageMotionEstimator
from track_range.tracking.camera_motion import CameraMotion

NO_BOXES = np.zeros((0, 4))
CAMERA = PinholeCamera(360.0, 360.0, 160.0, 90.0, width_px=320, height_px=180)


def image_at(left_px):
    texture = np.random.default_rng(0).integers(0, 255, (90, 260, 3), np.uint8)
    wide = cv2.resize(texture, (520, 180), interpolation=cv2.INTER_CUBIC)
    return np.ascontiguousarray(wide[:, left_px : left_px + 320])


def shifted_flow():
    """Two frames; the scene moves 3 px to the right."""
    flow = BackgroundFlow()
    flow.add(image_at(103), NO_BOXES, 0.0)
    flow.add(image_at(100), NO_BOXES, 0.1)
    return flow


def test_grey_is_the_green_channel_halved_by_means():
    """Also of a part of an image, whose rows are apart, and of an image that is grey."""
    image = np.random.default_rng(0).integers(0, 255, (41, 60, 3), np.uint8)
    for part in (image, image[3:37, 7:50]):
        green = part[..., 1]
        np.testing.assert_array_equal(small_grey(part, 0), green)
        even = green[: len(green) // 2 * 2, : green.shape[1] // 2 * 2].astype(int)
        total = even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]
        np.testing.assert_array_equal(small_grey(part, 1), (total + 2) // 4)
    grey = np.ascontiguousarray(image[..., 0])
    assert small_grey(grey, 0) is grey


@pytest.mark.parametrize("counts", [(100, 20), (20, 100), (20, 60, 100)])
def test_fewer_corners_are_the_first_ones(counts):
    """The flow of a corner does not depend on who asked for it, or on the order."""
    flow = shifted_flow()
    results = {count: flow.tracked(count, 0.01) for count in counts}
    before, now = shifted_flow().tracked(100, 0.01)
    np.testing.assert_array_equal(results[100][0], before)
    np.testing.assert_array_equal(results[100][1], now)
    fewer_before, fewer_now = results[20]
    assert 10 < len(fewer_now) <= 20
    np.testing.assert_array_equal(fewer_before, before[: len(fewer_before)])
    np.testing.assert_array_equal(fewer_now, now[: len(fewer_now)])
    np.testing.assert_allclose(np.median(now - before, axis=0), [3, 0], atol=0.05)


def test_min_quality_selects_better_corners():
    corners = shifted_flow().now.corners
    assert corners.n_good(1000, 0.5) < corners.n_good(1000, 0.01)
    assert (np.diff(corners.quality) <= 0).all()


def test_isotropy_of_corners_and_edges():
    image = np.full((180, 320), 50, np.uint8)
    cv2.fillPoly(image, [np.array([[100, 20], [300, 20], [300, 100], [100, 100]])], 200)
    cv2.line(image, (20, 170), (90, 100), 255, 3)
    image = cv2.GaussianBlur(image, (0, 0), 1.0)
    corners = np.array([[100.5, 20.5], [100.5, 100.5]], np.float32)
    edges = np.array([[200.5, 20.5], [100.5, 60.5], [54.5, 134.5]], np.float32)
    assert (isotropy(image, corners) > 0.2).all()
    assert (isotropy(image, edges) < 0.05).all()
    points = ranked_corners(image, masked_cells(NO_BOXES, image.shape, 0)).points
    assert isotropy(image, points).shape == (len(points),)
    assert isotropy(image, points[:0]).shape == (0,)


def test_frame_of_the_same_time_is_added_once():
    flow = shifted_flow()
    frame, before = flow.now, flow.before
    flow.add(image_at(0), NO_BOXES, 0.1)
    assert flow.now is frame
    assert flow.before is before
    flow.add(image_at(97), NO_BOXES)
    assert flow.before is frame


def test_flow_restarts_after_another_size_and_a_tiny_image():
    flow = shifted_flow()
    flow.add(image_at(100)[:, :200], NO_BOXES, 0.2)
    assert flow.before is None
    assert len(flow.tracked(100, 0.01)[0]) == 0
    flow.add(np.zeros((20, 400, 3), np.uint8), NO_BOXES, 0.3)
    assert flow.now is None
    flow.add(image_at(100), NO_BOXES, 0.4)
    assert flow.before is None


def test_small_image_has_at_most_the_long_side():
    flow = BackgroundFlow(100)
    flow.add(image_at(100), NO_BOXES)
    assert flow.now.small.shape == (45, 80)
    assert flow.n_halvings((180, 320)) == flow.now.n_halved == 2


def test_shared_flow_gives_equal_results():
    """Tracker and odometry with one flow, as in a run, and with one each."""
    boxes = np.array([[50.0, 60, 110, 120]])
    flow = BackgroundFlow()
    shared = CameraMotion(flow=flow), ImageMotionEstimator(CAMERA, flow=flow)
    separate = CameraMotion(), ImageMotionEstimator(CAMERA)
    for k in range(4):
        image, time_s = image_at(110 - 3 * k), k / 10
        results = []
        for camera_motion, image_motion in (shared, separate):
            matrix = camera_motion.update(image, boxes, time_s)
            results.append((matrix.tobytes(), image_motion.update(image, time_s, boxes)))
        assert results[0][0] == results[1][0]
        assert repr(results[0][1]) == repr(results[1][1])
    assert results[0][1].yaw_rad_s == pytest.approx(-10 * 3 / 360, abs=0.01)


def test_corners_of_fast_frames_are_detected_in_every_second_one():
    """25 frames/s: between, the tracked corners go on, and lead back to where they were detected."""
    flow, detected_s = BackgroundFlow(), [0.0]
    for k in range(6):
        flow.add(image_at(110 - 3 * k), NO_BOXES, k / 25)
        before, now = flow.tracked(100, 0.01)
        first, last = flow.since_detection(100, 0.01)
        assert flow.is_between == (k in (2, 4))  # no corners are needed before frame 1
        if k:
            np.testing.assert_allclose(np.median(now - before, axis=0), [3, 0], atol=0.05)
            n_frames = round(25 * (k / 25 - detected_s[-1]))
            moved = np.median(last - first, axis=0)
            np.testing.assert_allclose(moved, [3 * n_frames, 0], atol=0.05)
            assert flow.detection_before.time_s == detected_s[-1]
        if not flow.is_between:
            detected_s.append(k / 25)
    assert len(now) > 50


def test_corners_are_detected_where_few_are_left():
    """Half of them are in the box of a road user that appears."""
    flow, half = BackgroundFlow(), np.array([[0.0, 0, 160, 180]])
    for k, boxes in enumerate((NO_BOXES, NO_BOXES, NO_BOXES, half)):
        flow.add(image_at(110 - 2 * k), boxes, 0.01 * k)
        flow.tracked(100, 0.01)
        assert flow.is_between == (k == 2)


def test_expected_corners_are_found_far_away():
    """Two levels of the pyramid reach 20 px."""
    flow = BackgroundFlow()
    flow.add(image_at(160), NO_BOXES, 0.0)
    flow.expect(flow.now.corners.points + np.array([60, 0], np.float32))
    flow.add(image_at(100), NO_BOXES, 0.1)
    before, now = flow.tracked(100, 0.01)
    assert len(now) > 50
    np.testing.assert_allclose(np.median(now - before, axis=0), [60, 0], atol=0.05)
