"""SceneCuts: other scenes, and images that only look as if they were of one."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from track_range.foundation.arrays import Image
from track_range.stereo.odometry.image_times import ImageTimes
from track_range.stereo.odometry.scene_cuts import SceneCuts

N, CUT = 12, 6


def scene(seed: int, at_px: float) -> Image:
    """A part of a texture of one scene that starts at a column."""
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (120, 400)).astype(np.float32), (0, 0), 5.0)
    texture = np.clip(128 + 8 * (texture - 128), 0, 255)
    shift = np.array([[1.0, 0.0, -at_px], [0.0, 1.0, 0.0]])
    return np.asarray(cv2.warpAffine(texture, shift, (160, 120)), np.uint8)


def cuts(images: list[Image], hidden: float = 0.0) -> list[int]:
    """Numbers of the images at which a cut is known."""
    found = SceneCuts()
    return [k for k, image in enumerate(images) if found.update(image, k / 30, hidden)]


def drive(seed: int = 0) -> list[Image]:
    return [scene(seed, 1.0 * k) for k in range(N)]


def test_another_scene_is_known_with_its_second_image() -> None:
    assert cuts(drive(0)) == []
    assert cuts(drive(0)[:CUT] + drive(1)[CUT:]) == [CUT + 1]
    assert cuts(drive(0)[:4] + drive(1)[4:8] + drive(2)[8:]) == [5, 9]


def wiper(image: Image) -> Image:
    """A dark bar across a fifth of the image."""
    wiped = image.copy()
    wiped[:, 64:96] = 20
    return wiped


@pytest.mark.parametrize(
    "changed",
    [
        lambda image: np.zeros_like(image),
        lambda image: np.full_like(image, 255),
        lambda image: scene(8, 0.0),
        lambda image: np.asarray(image * 0.3, np.uint8),
        lambda image: np.clip(image.astype(np.int64) * 2 + 40, 0, 255).astype(np.uint8),
        lambda image: image[::-1].copy(),
        wiper,
    ],
    ids=["black", "white", "broken", "tunnel", "overexposed", "upside-down", "wiper"],
)
@pytest.mark.parametrize("n_changed", [1, 2])
def test_images_that_are_hidden_for_a_moment_are_no_scene(
    changed: Callable[[Image], Image], n_changed: int, request: pytest.FixtureRequest
) -> None:
    """One image is never a scene; two equal ones of another texture are, then the old one is."""
    images = drive()
    images[CUT : CUT + n_changed] = [changed(image) for image in images[CUT : CUT + n_changed]]
    is_scene = "broken" in request.node.name and n_changed == 2
    assert cuts(images) == ([CUT + 1, CUT + 3] if is_scene else [])


@pytest.mark.parametrize("step_px", [0.0, 4.0, 20.0])
def test_pans_and_dropped_images_are_no_scene(step_px: float) -> None:
    """Images that are all far from each other, and a jump within one scene."""
    assert cuts([scene(0, step_px * k % 240) for k in range(N)]) == []
    dropped = [scene(0, k + (step_px / 4 if k >= CUT else 0.0)) for k in range(N)]
    assert cuts(dropped) == []


def test_images_after_a_gap_show_no_scene() -> None:
    found = SceneCuts()
    times_s = [*np.arange(CUT) / 30, *(np.arange(CUT) / 30 + 0.4)]
    images = drive(0)[:CUT] + drive(1)[CUT:]
    assert not any(map(found.update, images, times_s))


def test_images_of_another_size_show_no_scene() -> None:
    images = drive(0)[:CUT] + [image[:60] for image in drive(1)[CUT:]]
    assert cuts(images) == []


def test_a_view_that_a_truck_fills_is_no_scene() -> None:
    """Growing by 2 from image to image, until only its rear is left."""
    view, rear = scene(0, 0.0), scene(3, 0.0)
    images = [view, view, view]
    for height_px in (15, 30, 60, 120):
        near = view.copy()
        width_px = height_px * 4 // 3
        top, left = (120 - height_px) // 2, (160 - width_px) // 2
        shown = cv2.resize(rear, (width_px, height_px))
        near[top : top + height_px, left : left + width_px] = shown
        images.append(near)
    images += [images[-1], images[-1]]
    assert cuts(images) != []
    assert cuts(images, hidden=0.3) == []


def test_a_cut_to_a_view_with_a_near_road_user_is_known() -> None:
    """As from the camera ahead to the one behind, where a car stands."""
    found = SceneCuts()
    images = drive(0)[:CUT] + drive(1)[CUT:]
    hidden = [0.1] * CUT + [0.4] * CUT
    known = [found.update(image, k / 30, hidden[k]) for k, image in enumerate(images)]
    assert np.flatnonzero(known).tolist() == [CUT + 1]


def test_note_says_when_another_scene_begins() -> None:
    times = ImageTimes()
    images = drive(0)[:CUT] + drive(1)[CUT:]
    large = [np.asarray(cv2.resize(one, (640, 480)), np.uint8) for one in images]
    found = [times.update(image, k / 10) for k, image in enumerate(large)]
    assert [k for k, image in enumerate(found) if image.starts_scene] == [CUT + 1]
    (note,) = times.notes
    assert note.startswith("The images show another scene from 0.6 s on: tracks, odometry")
