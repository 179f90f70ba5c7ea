"""Parts of the image that do not move with the scene, and the boxes on them."""

import cv2
import numpy as np
import pytest

from track_range.detection.detections import Detections
from track_range.detection.fixed_parts import FixedParts

SIZE_PX = 400, 224
STEP_S = 0.1
TEXT_BOX = (10.0, 196.0, 196.0, 218.0)
VEHICLE_BOX = (160.0, 80.0, 260.0, 160.0)


def textured(rng, width, height):
    """A random picture with edges some pixels wide, as of leaves or facades."""
    noise = rng.uniform(80, 140, (height // 4 + 1, width // 4 + 1)).astype(np.float32)
    return cv2.resize(noise, (width, height), interpolation=cv2.INTER_LINEAR)


class Scene:
    """A textured scene that moves by `speed_px` per image, with the noise of a camera."""

    def __init__(self, seed, speed_px, *, pitch_px=0.0):
        self.rng = np.random.default_rng(seed)
        width, height = SIZE_PX
        self.picture = textured(self.rng, 4 * width, height)
        self.vehicle = textured(self.rng, 100, 80)
        self.speed_px, self.pitch_px = speed_px, pitch_px

    def image(self, index, text="", *, opacity=1.0, has_vehicle=False):
        width, _ = SIZE_PX
        start = round(index * self.speed_px) % (3 * width)
        grey = self.picture[:, start : start + width].copy()
        if has_vehicle:  # at a constant distance, with the pitch of the camera
            down = round(float(self.rng.normal(0, self.pitch_px)))
            grey[80 + down : 160 + down, 160:260] = self.vehicle
        image = np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)
        written = image.copy()
        cv2.putText(written, text, (12, 215), 0, 0.7, (0, 0, 0), 5)
        cv2.putText(written, text, (12, 215), 0, 0.7, (255, 255, 255), 2)
        image = (1 - opacity) * image + opacity * written + self.rng.normal(0, 2, image.shape)
        return np.clip(image, 0, 255).astype(np.uint8)


def clock(index):
    return f"14:07:{int(index * STEP_S) % 60:02d} CAR"


def seen(scene, n_images, text=lambda index: "", **options):
    """What never moves in images of a scene, and the last image."""
    parts = FixedParts()
    for index in range(n_images):
        image = scene.image(index, text(index), **options)
        parts.add(image, index * STEP_S)
    return parts, image


def boxes(*xyxy_px):
    return Detections.of(list(xyxy_px), [0.5] * len(xyxy_px), [1] * len(xyxy_px))


@pytest.mark.parametrize("opacity", [1.0, 0.6])
def test_a_box_on_a_clock_is_left_out_while_the_scene_moves(opacity):
    parts, image = seen(Scene(1, 7.0), 40, clock, opacity=opacity)
    elsewhere = (300.0, 60.0, 380.0, 120.0)
    kept = parts.moving(boxes(TEXT_BOX, elsewhere), image)
    assert kept.xyxy_px.tolist() == [[*elsewhere]]
    assert parts.notes == (
        "On parts of the image that never move (burnt-in text, things on the dashboard), 1 box "
        "left out.",
    )


def test_nothing_is_learnt_while_the_scene_stands():
    parts, image = seen(Scene(1, 0.0), 60, clock)
    assert not parts.is_fixed.size
    assert parts.n_images == 0
    assert len(parts.moving(boxes(TEXT_BOX), image)) == 1
    assert parts.notes == ()


def test_parked_cars_are_no_fixed_parts_while_others_cross_before_a_standing_camera():
    parts = FixedParts()
    scene, crossing = Scene(2, 0.0), textured(np.random.default_rng(3), 1400, 70)
    for index in range(60):
        image = scene.image(0)
        image[90:160] = crossing[:, 15 * index : 15 * index + 400, None]
        parts.add(image, index * STEP_S)
    assert parts.n_images == 0


def test_a_vehicle_at_a_constant_distance_moves_with_the_pitch_of_the_camera():
    parts, image = seen(Scene(4, 7.0, pitch_px=1.5), 200, has_vehicle=True)
    assert parts.n_images > 20
    assert len(parts.moving(boxes(VEHICLE_BOX), image)) == 1


def test_a_car_behind_text_is_kept():
    parts, image = seen(Scene(5, 7.0), 40, clock)
    near = (10.0, 110.0, 196.0, 223.0)
    assert len(parts.moving(boxes(near), image)) == 1


def test_a_vehicle_ahead_is_kept_before_a_steady_camera():
    """Its pixels never move, as near the vanishing point of a straight road."""
    parts, image = seen(Scene(1, 7.0), 40, has_vehicle=True)
    x1, y1, x2, y2 = map(int, VEHICLE_BOX)
    assert parts.is_fixed[y1:y2, x1:x2].mean() > 0.1
    assert len(parts.moving(boxes(VEHICLE_BOX), image)) == 1


def test_what_was_fixed_may_begin_to_move():
    scene, parts = Scene(6, 7.0), FixedParts()
    for index in range(250):
        text = "LOGO" if index < 40 else ""
        parts.add(scene.image(index, text), index * STEP_S)
        if index == 39:
            assert parts.is_fixed.any()
    assert not parts.is_fixed.any()


def test_fixed_pixels_are_those_of_the_text():
    parts, _ = seen(Scene(1, 7.0), 40, lambda index: "HHHH")
    x1, y1, x2, y2 = map(int, TEXT_BOX)
    is_fixed = parts.is_fixed
    assert is_fixed[y1:y2, x1:x2].mean() > 0.1
    assert is_fixed[y1 - 3 : y2 + 3, x1 - 3 : x2 + 3].sum() >= 0.99 * is_fixed.sum()


def test_images_of_another_size_start_again():
    parts, image = seen(Scene(1, 7.0), 40, clock)
    assert parts.is_fixed.any()
    parts.add(image[:100, :300], 40 * STEP_S)  # at once
    assert not parts.is_fixed.size
    assert len(parts.moving(boxes(TEXT_BOX), image[:100, :300])) == 1


def test_boxes_outside_the_image_and_without_area_are_kept():
    parts, image = seen(Scene(1, 7.0), 40, clock)
    outside = boxes((-50.0, -50.0, -5.0, -5.0), (30.0, 210.0, 30.0, 210.0), (0.0, 0.0, 2e3, 2e3))
    assert len(parts.moving(outside, image)) == 3
    assert len(parts.moving(Detections.empty(), image)) == 0
