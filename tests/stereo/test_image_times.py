"""Repeated images and the moments of the others, on textures that move by known steps."""

from itertools import pairwise

import cv2
import numpy as np
import pytest

from track_range.foundation.arrays import Image
from track_range.stereo.odometry.image_times import ImageTime, ImageTimes

rng = np.random.default_rng(5)
TEXTURE = cv2.GaussianBlur(rng.uniform(0, 255, (240, 2000)).astype(np.float32), (0, 0), 6.0)
TEXTURE = np.clip(128 + 6 * (TEXTURE - 128), 0, 255)


def image(at_px: float, noise_grey: float = 0.0, seed: int = 0) -> Image:
    """A part of a texture that starts at a column, with noise."""
    shift = np.array([[1.0, 0.0, -at_px], [0.0, 1.0, 0.0]])
    moved = cv2.warpAffine(TEXTURE, shift, (320, 240))
    noise = np.random.default_rng(seed).normal(0, 1, moved.shape) * noise_grey
    return np.clip(moved + noise, 0, 255).astype(np.uint8)


def shown(
    places_px: list[float], fps: float, noise_grey: float = 0.0
) -> tuple[ImageTimes, list[ImageTime]]:
    """Frames at a constant rate that show the texture at these places; equal places, equal
    images.
    """
    times = ImageTimes()
    images = {at_px: image(at_px, noise_grey, seed) for seed, at_px in enumerate(places_px)}
    found = [times.update(images[at_px], k / fps) for k, at_px in enumerate(places_px)]
    return times, found


def test_images_at_25_hz_shown_at_30_hz_have_their_own_times():
    numbers = [(5 * k + 4) // 6 for k in range(61)]
    times, found = shown([6.0 * number for number in numbers], fps=30.0)
    is_repeated = [image.is_repeated for image in found]
    assert is_repeated == [False, *(after == before for before, after in pairwise(numbers))]
    new_s = np.array([image.time_s for image in found if not image.is_repeated])
    # before three repetitions, the times of the frames
    assert np.diff(new_s)[:10] == pytest.approx(1 / 30 * np.array([1, 1, 1, 1, 2, 1, 1, 1, 1, 2]))
    assert np.diff(new_s)[15:] == pytest.approx(1 / 25, abs=1e-9)
    assert (np.diff([image.time_s for image in found]) > 0).all()
    (note,) = times.notes
    assert note.startswith("Every sixth frame repeats the image before it (10 of 61 frames)")


@pytest.mark.parametrize("pattern", [(2,), (2, 3)])
def test_film_rates_of_television(pattern: tuple[int, ...]) -> None:
    numbers = [n for n in range(24) for _ in range(pattern[n % len(pattern)])]
    times, found = shown([9.0 * number for number in numbers], fps=60.0)
    new_s = np.array([image.time_s for image in found if not image.is_repeated])
    assert np.diff(new_s)[-8:] == pytest.approx(np.mean(pattern) / 60, abs=1e-9)
    assert sum(image.is_repeated for image in found) >= len(numbers) - 24 - 4
    assert "repeat" in " ".join(times.notes)


def test_image_in_the_place_of_a_lost_one_does_not_change_other_times():
    numbers = [k - 1 if k % 5 == 4 else k for k in range(60)]
    _, found = shown([6.0 * number for number in numbers], fps=30.0)
    assert [image.is_repeated for image in found] == [k % 5 == 4 for k in range(60)]
    assert [image.time_s for image in found] == pytest.approx([k / 30 for k in range(60)])


def test_camera_that_brakes_to_rest_repeats_nothing():
    speeds = [8.0] * 20 + [8.0 - 0.8 * k for k in range(10)] + [0.0] * 20
    times, found = shown(np.cumsum(speeds).tolist(), fps=10.0)
    assert not any(image.is_repeated for image in found)
    assert times.notes == ()


def test_camera_at_rest_repeats_nothing():
    times, found = shown([0.0] * 30, fps=10.0)
    assert not any(image.is_repeated for image in found)
    assert times.notes == ()


def test_frozen_camera_shows_nothing_new_until_it_moves_again():
    places_px = [6.0 * k for k in range(20)] + [114.0] * 15 + [6.0 * k for k in range(35, 45)]
    times, found = shown(places_px, fps=10.0)
    assert [k for k, image in enumerate(found) if image.is_repeated] == [*range(20, 35)]
    (note,) = times.notes
    assert note.startswith("The images do not change from 1.9 to 3.5 s")
    assert found[-1].time_s == pytest.approx(4.4)


def test_note_on_a_camera_that_stays_frozen():
    times, _ = shown([6.0 * min(k, 19) for k in range(40)], fps=10.0)
    assert times.notes[0].startswith("The images do not change from 1.9 to 3.9 s")


def test_compressed_repetition_is_one_and_a_noisy_drive_has_none():
    ghost = ImageTimes()
    compressed = [image(6.0 * ((5 * k + 4) // 6), noise_grey=1.0, seed=k) for k in range(30)]
    found = [ghost.update(compressed[k], k / 30).is_repeated for k in range(30)]
    assert found[10:] == [k % 6 == 5 for k in range(10, 30)]
    _, moving = shown([0.7 * k for k in range(60)], fps=30.0, noise_grey=2.0)
    assert not any(image.is_repeated for image in moving)


def test_images_of_another_size_start_anew():
    times = ImageTimes()
    for k in range(10):
        times.update(image(6.0 * k), k / 10)
    assert times.update(image(54.0)[:120], 1.0) == ImageTime(1.0)


def test_times_are_unsure_from_a_repetition_until_the_rate_shows():
    _, found = shown([6.0 * ((5 * k + 4) // 6) for k in range(40)], fps=30.0)
    # the third repetition is frame 17
    assert [k for k, image in enumerate(found) if not image.is_sure] == [
        k for k in range(6, 18) if k % 6 != 5
    ]


def test_times_are_sure_soon_after_a_single_repetition():
    numbers = [*range(10), 9, *range(11, 50)]
    _, found = shown([6.0 * number for number in numbers], fps=30.0)
    unsure = [k for k, image in enumerate(found) if not image.is_sure]
    assert (unsure[0], len(unsure)) == (11, 20)
