"""Images that are unlike those on which detection was measured: what is said, and when."""

import cv2
import numpy as np
import pytest

from tests.support.results.overlay_results import result
from track_range.results.summary_shape import valid_summary
from track_range.run.reports.visibility import Visibility, look_of

RNG = np.random.default_rng(0)
# edges and shades as of a street: large patches with sharp borders, and fine texture
PATCHES = np.kron(RNG.integers(30, 220, (18, 32, 3)), np.ones((40, 40, 1)))
DAY = np.clip(PATCHES + RNG.normal(0, 12, PATCHES.shape), 0, 255).astype(np.uint8)
DARK = (0.1 * DAY).astype(np.uint8)
FOG = (0.15 * DAY + 0.85 * 180).astype(np.uint8)
BRIGHT = np.clip(4.0 * DAY + 100.0, 0, 255).astype(np.uint8)
BLURRED = np.asarray(cv2.GaussianBlur(DAY, (0, 0), 12.0))


def seen(*images, frame_s=0.1):
    """Ten frames of each image."""
    visibility = Visibility()
    for index in range(10 * len(images)):
        image = images[index // 10]
        visibility.add(result([], image=image, index=index, time_s=frame_s * index))
    return visibility


@pytest.mark.parametrize(
    ("image", "fault", "word"),
    [
        (DARK, "dark", "dark"),
        (FOG, "flat", "low contrast"),
        (BRIGHT, "bright", "overexposed"),
        (BLURRED, "blurred", "blurred"),
    ],
)
def test_what_is_outside_of_the_measured_range_is_said_with_its_numbers(image, fault, word):
    visibility = seen(*[image] * 5)
    section = visibility.summary()["visibility"]
    assert (section[fault], section["outside"], section["is_low"]) == (1.0, 1.0, True)
    (note,) = visibility.notes()
    assert (note.code, note.severity) == ("low-visibility", "warning")
    assert note == f"{section['sentence'].rstrip('.')} ({section['figures']})."
    assert word in note
    assert "100 % of the video, from 0.0 to 4.0 s" in note
    assert (
        f"brightness {section['brightness']:.0f}, contrast {section['contrast']:.0f}, sharpness"
        in note
    )


def test_daylight_has_no_note():
    visibility = seen(DAY, DAY)
    section = visibility.summary()["visibility"]
    assert visibility.notes() == ()
    assert (section["outside"], section["is_low"], section["spans_s"]) == (0.0, False, [])
    assert section["brightness"] == pytest.approx(DAY.mean(), rel=0.05)
    assert section["contrast"] == pytest.approx(DAY.std(), rel=0.05)


def test_a_tunnel_is_a_note_with_its_times_but_not_the_first_word():
    images = [DAY] * 12 + [DARK] * 2 + [DAY] * 6
    visibility = seen(*images)
    section = visibility.summary()["visibility"]
    assert (section["outside"], section["is_low"]) == (0.1, False)
    assert section["spans_s"] == [[12.0, 13.0]]
    (note,) = visibility.notes()
    assert "dark" in note
    assert "10 % of the video, from 12.0 to 13.0 s" in note


def test_the_look_does_not_depend_on_the_resolution():
    small = look_of(np.asarray(cv2.resize(DAY, (640, 360), interpolation=cv2.INTER_AREA)))
    large = look_of(DAY)
    assert small.brightness == pytest.approx(large.brightness, rel=0.02)
    assert small.contrast == pytest.approx(large.contrast, rel=0.1)
    grey = look_of(DAY[:, :, 1])
    assert grey == large


def test_black_and_tiny_images_have_no_sharpness():
    assert np.isnan(look_of(np.zeros((360, 640, 3), np.uint8)).sharpness)
    assert look_of(np.zeros((4, 4, 3), np.uint8)).faults() == ()
    section = seen(np.zeros((360, 640, 3), np.uint8)).summary()["visibility"]
    assert section["sharpness"] is None


def test_the_section_is_one_of_a_summary_that_is_read_again():
    summary = dict(seen(DARK).summary())
    assert valid_summary(summary) == (summary, [])
    assert Visibility().summary() == {}
    assert Visibility().notes() == ()
