from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from track_range.foundation.arrays import Image
from track_range.tracking.camera_motion import CameraMotion, CameraMotionSettings

Array = npt.NDArray[np.float64]
NO_BOXES = np.zeros((0, 4))
IDENTITY = np.eye(2, 3)
CROP_PX = 120  # margin of the texture around every image cut from it


@cache
def texture(height: int, width: int, seed: int = 0) -> Image:
    """Coloured blobs of several sizes: features at every level of a pyramid."""
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width, 3))
    for sigma in (1.5, 4.0, 12.0):
        noise = cv2.GaussianBlur(
            rng.normal(size=(height, width, 3)).astype(np.float32), (0, 0), sigma
        )
        total += noise / noise.std()
    image = np.clip(128 + 35 * total, 0, 255).astype(np.uint8)
    image.flags.writeable = False  # shared by the tests
    return image


def view_of(left_px: int, top_px: int, height: int = 375, width: int = 1242) -> Image:
    """A part of the texture, as a view of its array."""
    wide = texture(375 + 2 * CROP_PX, 1242 + 2 * CROP_PX)
    return wide[top_px : top_px + height, left_px : left_px + width]


def cut(left_px: int, top_px: int, height: int = 375, width: int = 1242) -> Image:
    return np.ascontiguousarray(view_of(left_px, top_px, height, width))


def moved(points_px: Array, now_from_before: Array) -> Array:
    return np.asarray(points_px @ now_from_before[:, :2].T + now_from_before[:, 2])


def similarity(scale: float, roll_deg: float, shift: tuple[float, float], image: Image) -> Array:
    """(2, 3) similarity about the image centre."""
    centre = (image.shape[1] - 1) / 2, (image.shape[0] - 1) / 2
    matrix = np.array(cv2.getRotationMatrix2D(centre, roll_deg, scale))
    matrix[:, 2] += shift
    return matrix


def warped(image: Image, now_from_before: Array) -> Image:
    size = image.shape[1], image.shape[0]
    return np.asarray(cv2.warpAffine(image, now_from_before, size, flags=cv2.INTER_CUBIC), np.uint8)


def corner_error_px(estimate: Array, truth: Array, image: Image) -> float:
    height, width = image.shape[:2]
    corners = np.array(
        [[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], np.float64
    )
    return float(np.hypot(*(moved(corners, estimate) - moved(corners, truth)).T).max())


def motion(
    before: Image, now: Image, boxes_before: Array = NO_BOXES, boxes_now: Array = NO_BOXES
) -> Array:
    camera = CameraMotion()
    np.testing.assert_array_equal(camera.update(before, boxes_before), IDENTITY)
    return camera.update(now, boxes_now)


@given(dx=st.integers(-60, 60), dy=st.integers(-40, 40))
@settings(max_examples=20, deadline=None)
def test_shift_is_recovered(dx: int, dy: int) -> None:
    estimate = motion(cut(CROP_PX, CROP_PX), cut(CROP_PX - dx, CROP_PX - dy))
    assert corner_error_px(estimate, np.array([[1.0, 0, dx], [0, 1.0, dy]]), cut(0, 0)) < 0.2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scale", "roll_deg", "shift"),
    [
        (1.0, 0.0, (0.4, -0.3)),
        (1.0, 1.5, (0.0, 0.0)),
        (1.0, -4.0, (8.0, 5.0)),
        (1.04, 0.0, (0.0, 0.0)),
        (0.95, 2.0, (-12.5, 7.25)),
        (1.1, -1.0, (20.0, -10.0)),
    ],
)
@pytest.mark.parametrize("hw", [(375, 1242), (720, 1280), (360, 640), (1080, 1920)])
def test_similarity_is_recovered(
    hw: tuple[int, int], scale: float, roll_deg: float, shift: tuple[float, float]
) -> None:
    image = texture(*hw, seed=1)
    truth = similarity(scale, roll_deg, shift, image)
    factor = 4 if hw[1] == 1920 else 2 if hw[1] > 640 else 1
    assert corner_error_px(motion(image, warped(image, truth)), truth, image) < 0.1 * max(factor, 2)


def test_masked_traffic_is_ignored() -> None:
    image = texture(375, 1242, seed=1)
    truth = similarity(1.01, 0.5, (6.0, -3.0), image)
    now = warped(image, truth)
    patch = texture(300, 500, seed=2)  # 32 % of the image, 40 px to the left
    before = image.copy()
    before[40:340, 400:900] = patch
    now[40:340, 360:860] = patch
    box_before, box_now = np.array([[400.0, 40, 900, 340]]), np.array([[360.0, 40, 860, 340]])
    assert corner_error_px(motion(before, now, box_before, box_now), truth, image) < 0.2


def test_boxes_of_both_frames_mask_features() -> None:
    """The traffic covers most of the image, so that the background is estimate only with the boxes
    of both frames."""
    image = texture(375, 1242, seed=1)
    now = image.copy()
    patch = texture(375, 1000, seed=2)
    before = image.copy()
    before[:, 100:1100], now[:, 120:1120] = patch, patch
    box_before, box_now = np.array([[100.0, 0, 1100, 375]]), np.array([[120.0, 0, 1120, 375]])
    assert corner_error_px(motion(before, now, box_before, box_now), IDENTITY, image) < 0.2
    unmasked = motion(before, now)
    assert abs(moved(np.array([[600.0, 180.0]]), unmasked)[0, 0] - 620) < 0.2


def drive(z: Array, rotation: Array, vanishing_xy: tuple[float, float]) -> tuple[Image, Image]:
    """Two frames: strips flow away from the vanishing point by their inverse depth `z`, then the
    camera rotates."""
    scene = texture(375, 1242, seed=3)
    rows, columns = np.indices((375, 1242)).astype(np.float64)
    inverse_rotation = cv2.invertAffineTransform(rotation)
    points = moved(np.stack([columns.ravel(), rows.ravel()], axis=1), inverse_rotation)
    strip = np.clip((points[:, 0] / 1242 * len(z)).astype(int), 0, len(z) - 1)
    source = np.array(vanishing_xy) + (points - vanishing_xy) / (1 + z[strip])[:, None]
    x, y = (source[:, i].reshape(375, 1242).astype(np.float32) for i in (0, 1))
    return scene, np.asarray(
        cv2.remap(scene, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT), np.uint8
    )


@pytest.mark.parametrize("vanishing_xy", [(620.5, 187.0), (640.0, 165.0)])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (9.0, -6.0)])
def test_driving_is_not_camera_motion(
    vanishing_xy: tuple[float, float], shift: tuple[float, float]
) -> None:
    z = np.array([0.09, 0.02, 0.06, 0.01, 0.0, 0.015, 0.05, 0.03])
    truth = similarity(1.0, 0.5, shift, cut(0, 0))
    before, now = drive(z, truth, vanishing_xy)
    assert corner_error_px(motion(before, now), truth, before) < 1.5
    # A robust similarity on the same two images is an order of magnitude worse.
    corners = cv2.goodFeaturesToTrack(cv2.cvtColor(before, cv2.COLOR_BGR2GRAY), 300, 0.01, 15)
    tracked, status, _ = cv2.calcOpticalFlowPyrLK(before, now, corners, np.empty_like(corners))
    cv2.setRNGSeed(0)
    plain, _ = cv2.estimateAffinePartial2D(corners[status > 0], tracked[status > 0])
    assert corner_error_px(np.asarray(plain), truth, before) > 8


@pytest.mark.parametrize("value", [0, 128, 255])
def test_a_flat_image_gives_the_identity(value: int) -> None:
    flat = np.full((375, 1242, 3), value, np.uint8)
    np.testing.assert_array_equal(motion(flat, flat), IDENTITY)


def test_a_new_scene_is_not_a_motion() -> None:
    np.testing.assert_array_equal(motion(texture(375, 1242, 1), texture(375, 1242, 2)), IDENTITY)
    np.testing.assert_array_equal(
        motion(texture(375, 1242, 1), np.zeros((375, 1242, 3), np.uint8)), IDENTITY
    )


@pytest.mark.parametrize(
    "hw",
    [
        (0, 0),
        (1, 1),
        (2, 3),
        (1, 3000),
        (20, 20),
        (31, 500),
        (32, 32),
        (33, 65),
        (40, 1),
        (64, 5000),
    ],
)
def test_small_and_narrow_images(hw: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 256, (*hw, 3), dtype=np.uint8)
    estimate = motion(image, image)
    assert np.abs(estimate - IDENTITY).max() < 0.05


@pytest.mark.parametrize(
    "gate",
    [
        {"max_roll_rad": 0.03},
        {"max_scale": 1.05},
        {"max_shift": 0.01},
        {"min_inlier_fraction": 1.01},
    ],
)
def test_implausible_motion_is_the_identity(gate: dict[str, float]) -> None:
    image = texture(375, 1242, seed=1)
    now = warped(image, similarity(1.08, 2.5, (25.0, 0.0), image))
    for options, is_accepted in (({}, True), (gate, False)):
        camera = CameraMotion(CameraMotionSettings(**options))  # type: ignore[arg-type]
        camera.update(image, NO_BOXES)
        assert np.array_equal(camera.update(now, NO_BOXES), IDENTITY) is not is_accepted


def test_a_change_of_size_restarts() -> None:
    camera = CameraMotion()
    small, large = cut(CROP_PX, CROP_PX, 300, 800), cut(CROP_PX, CROP_PX)
    camera.update(small, NO_BOXES)
    np.testing.assert_array_equal(camera.update(large, NO_BOXES), IDENTITY)
    shifted = camera.update(cut(CROP_PX - 9, CROP_PX + 4), NO_BOXES)
    assert corner_error_px(shifted, np.array([[1.0, 0, 9], [0, 1.0, -4]]), large) < 0.2
    np.testing.assert_array_equal(camera.update(np.zeros((5, 5, 3), np.uint8), NO_BOXES), IDENTITY)
    np.testing.assert_array_equal(camera.update(large, NO_BOXES), IDENTITY)


def test_boxes_over_the_whole_image() -> None:
    everything = np.array([[-10.0, -10.0, 2000.0, 2000.0]])
    before, now = cut(CROP_PX, CROP_PX), cut(CROP_PX + 5, CROP_PX)
    np.testing.assert_array_equal(motion(before, now, everything, NO_BOXES), IDENTITY)
    np.testing.assert_array_equal(motion(before, now, NO_BOXES, everything), IDENTITY)


def test_a_patch_of_background_gives_only_a_shift() -> None:
    """Scale and roll from a small group of features would be noise at the other end of the
    image."""
    far_side = np.array([[140.0, -1.0, 1300.0, 400.0]])
    image = cut(CROP_PX, CROP_PX)
    estimate = motion(image, cut(CROP_PX - 7, CROP_PX - 3), far_side, far_side)
    np.testing.assert_array_equal(estimate[:, :2], np.eye(2))
    np.testing.assert_allclose(estimate[:, 2], [7, 3], atol=0.2)


def test_many_and_invalid_boxes() -> None:
    rng = np.random.default_rng(0)
    corner = rng.uniform([-300, -300], [500, 700], (10_000, 2))  # the right half stays free
    boxes = np.concatenate([corner, corner + rng.uniform(1, 60, (10_000, 2))], axis=1)
    invalid = np.array(
        [
            [np.nan, 0, 5, 5],
            [0, 0, np.inf, 400],
            [900, 0, 700, 300],
            [-1e300, 1e300, 1e300, 2e300],
            [0, 400, 2000, 900],
        ]
    )
    boxes = np.concatenate([boxes, invalid])
    estimate = motion(cut(CROP_PX, CROP_PX), cut(CROP_PX - 6, CROP_PX + 2), boxes, boxes)
    assert corner_error_px(estimate, np.array([[1.0, 0, 6], [0, 1.0, -2]]), cut(0, 0)) < 0.3


def test_instances_are_independent_and_deterministic() -> None:
    frames = [cut(CROP_PX + 7 * i, CROP_PX - 3 * i) for i in range(5)]
    one, two, alone = CameraMotion(), CameraMotion(), CameraMotion()
    interleaved = []
    for image, other in zip(frames, reversed(frames), strict=True):
        interleaved.append(one.update(image, NO_BOXES))
        two.update(other, NO_BOXES)
    np.testing.assert_array_equal(interleaved, [alone.update(image, NO_BOXES) for image in frames])


@pytest.mark.parametrize("hw", [(375, 1242), (200, 320)])
def test_the_image_is_not_modified_nor_referenced(hw: tuple[int, int]) -> None:
    before = cut(CROP_PX, CROP_PX, *hw)
    copy = before.copy()
    before.flags.writeable = False
    camera = CameraMotion()
    camera.update(before, NO_BOXES)
    np.testing.assert_array_equal(before, copy)
    before.flags.writeable = True
    before[:] = 0
    estimate = camera.update(cut(CROP_PX - 5, CROP_PX, *hw), NO_BOXES)
    np.testing.assert_allclose(estimate[:, 2], [5, 0], atol=0.3)


def test_non_contiguous_images() -> None:
    view = view_of(CROP_PX, CROP_PX)
    assert not view.flags.c_contiguous
    now = cut(CROP_PX + 8, CROP_PX)
    np.testing.assert_array_equal(motion(view, now), motion(np.ascontiguousarray(view), now))


def test_wrong_shapes() -> None:
    with pytest.raises(ValueError, match=r"image.*shape"):
        CameraMotion().update(np.zeros((20, 20), np.uint8), NO_BOXES)
    with pytest.raises(ValueError, match=r"xyxy_px.*shape"):
        CameraMotion().update(np.zeros((20, 20, 3), np.uint8), np.zeros((2, 5)))


def frames_of(path: Path, n: int) -> list[Image]:
    video = cv2.VideoCapture(str(path))
    frames = [video.read()[1] for _ in range(n)]
    video.release()
    return [np.asarray(frame, np.uint8) for frame in frames]


def test_yaw_and_pitch_of_a_real_drive(shared_data: Path) -> None:
    """KITTI odometry: points on the horizon, which driving does not move, against the known
    poses."""
    folder = shared_data / "kitti_odometry" / "gray51"
    frames = frames_of(folder / "left.mp4", 51)
    K = np.array((folder / "calib.txt").read_text().split("\n")[0].split()[1:], np.float64).reshape(
        3, 4
    )[:, :3]
    pose = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)[:, :, :3]
    horizon = np.stack([np.linspace(100, 1126, 9), np.full(9, K[1, 2])], axis=1)
    camera = CameraMotion()
    camera.update(frames[0], NO_BOXES)
    errors, steps = [], []
    for image, before, now in zip(frames[1:], pose[:-1], pose[1:], strict=True):
        rays = np.column_stack([horizon, np.ones(9)]) @ (K @ now.T @ before @ np.linalg.inv(K)).T
        truth = rays[:, :2] / rays[:, 2:]
        errors.append(moved(horizon, camera.update(image, NO_BOXES)) - truth)
        steps.append(truth - horizon)
    rms_px = float(np.sqrt((np.array(errors) ** 2).mean() * 2))
    assert 0.3 < rms_px < 0.9
    assert rms_px < 0.75 * float(np.sqrt((np.array(steps) ** 2).mean() * 2))


@pytest.mark.parametrize("name", ["kitti_stereo/0003/left.mp4", "dashcam/highway_two_cars.mp4"])
def test_shake_added_to_a_real_drive(shared_data: Path, name: str) -> None:
    frames = frames_of(shared_data / name, 16)
    height, width = frames[0].shape[0] - 48, frames[0].shape[1] - 48
    offsets = np.random.default_rng(0).integers(0, 49, (16, 2))
    centre = np.array([[width / 2, height / 2]])
    still, shaken = CameraMotion(), CameraMotion()
    errors = []
    for i, (frame, (left, top)) in enumerate(zip(frames, offsets, strict=True)):
        plain = still.update(frame[24 : 24 + height, 24 : 24 + width], NO_BOXES)
        moving = shaken.update(frame[top : top + height, left : left + width], NO_BOXES)
        if i > 0:
            errors.append(
                (moved(centre, moving) - moved(centre, plain))[0] + offsets[i] - offsets[i - 1]
            )
    assert np.median(np.abs(errors)) < 0.4
    assert np.abs(errors).max() < 1.5
