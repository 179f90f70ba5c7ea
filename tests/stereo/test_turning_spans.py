"""Turns of a rotating camera that looks at a panorama, which is known exactly."""

import cv2
import numpy as np
import pytest

from track_range.foundation.arrays import Image
from track_range.stereo.self_calibration.turns import turning_spans


def images(turns_deg: list[float], step_s: float = 0.25) -> list[tuple[float, Image]]:
    """A camera of 320 x 120 px and f 256 px before a distant panorama, at headings of these steps."""
    rng = np.random.default_rng(5)
    panorama = cv2.GaussianBlur(rng.integers(0, 255, (120, 6000), np.uint8), (0, 0), 3.0)
    shift_px = np.cumsum(np.tan(np.radians(turns_deg)) * 256).round().astype(int) + 1500
    return [
        (step_s * number, np.ascontiguousarray(panorama[:, start : start + 320]))
        for number, start in enumerate(shift_px.tolist())
    ]


def test_the_two_turns_of_a_drive_are_found_in_the_order_of_their_size() -> None:
    turns_deg = [0.0] * 40 + [2.0] * 10 + [0.0] * 60 + [-3.0] * 10 + [0.0] * 40
    first, second = turning_spans(images(turns_deg), span_s=5.0)
    assert first.turn_deg == pytest.approx(30.0, rel=0.05)
    assert first.start_s <= 110 * 0.25 + 0.5
    assert first.end_s >= 119 * 0.25
    assert second.turn_deg == pytest.approx(20.0, rel=0.05)
    assert second.start_s <= 40 * 0.25 + 0.5
    assert second.end_s >= 49 * 0.25


def test_a_straight_drive_has_no_turn() -> None:
    assert turning_spans(images([0.0] * 30)) == ()
    assert turning_spans([]) == ()


def test_pairs_of_images_each_second_show_the_turn_between_them() -> None:
    every = images([0.0] * 40 + [0.5] * 60 + [0.0] * 40, step_s=0.1)
    pairs = [one for number, one in enumerate(every) if number % 10 in (0, 2)]
    (turn,) = turning_spans(pairs, span_s=10.0)
    assert turn.turn_deg == pytest.approx(30.0, rel=0.15)
    assert turn.start_s <= 4.5
    assert turn.end_s >= 9.5
    # images that miss each other by seconds show nothing
    assert turning_spans(every[::30], span_s=10.0) == ()
