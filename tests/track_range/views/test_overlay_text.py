"""Texts of the overlay: labels and corners, their sizes and colours."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.results.overlay_results import BOX, grey, painted, result
from track_range.pipeline.colours import AMBER, CALM, RED, alarm_colour
from track_range.pipeline.frame_result import FrameResult
from track_range.views.overlay.labels import (
    Span,
    TextRenderer,
    closing_span,
    corner_lines,
    distance_text,
    label_lines,
    shown_distance,
    sigma_text,
    text_sizes_px,
)


def words(shown: FrameResult, row: int = 0) -> list[list[str]]:
    lines = label_lines(shown, row, class_names=["person", "bicycle", "car"], sizes_px=(15, 11))
    return [[span.text for span in line] for line in lines]


def test_texts_in_the_corners() -> None:
    clock, legend = corner_lines(result([BOX]), 11)
    assert [span.text for span in clock[0]] == ["frame 7", "0.72 s"]
    _, fixed = corner_lines(result([BOX]), 11, large="speed over ground, else fused")
    assert fixed[0][0].text.startswith("large: speed over ground, else fused ±1 sigma")
    more, _ = corner_lines(
        result([BOX]), 11, status=("9.8 fps", "85 ms behind"), warning="uncalibrated"
    )
    assert [span.text for span in more[0]] == [
        "frame 7",
        "0.72 s",
        "9.8 fps",
        "85 ms behind",
        "uncalibrated",
    ]
    assert more[0][-1].bgr == AMBER
    assert legend[0][0].text == "large: fused ±1 sigma   M mono   S stereo   dashed: predicted"


def test_label_shows_distances_and_identity() -> None:
    assert words(result([BOX])) == [["22.5 m", "±0.5", "car 1"], ["M 23.1  S 22.4"]]
    both = {
        "sgbm": (np.nan, np.nan),
        "lane": (104.2, 9.0),
        "mono": (99.96, 3.0),
        "fused": (7.04, 0.1),
    }
    assert words(result([BOX], ranges=both)) == [["7.0 m", "±0.1", "car 1"], ["M 100  L 104"]]


def test_label_without_distance() -> None:
    assert words(result([BOX], ranges={})) == [["- m", "car 1"]]
    assert words(result([BOX], ranges={"fused": (np.nan, np.nan)})) == [["- m", "car 1"]]


def test_predicted_track_shows_its_filtered_distance() -> None:
    carried = result(
        [BOX], observed=False, ranges={"fused": (np.nan, np.nan), "fused_kf": (31.0, 2.0)}
    )
    assert shown_distance(carried, 0) == (31.0, 2.0)
    assert words(carried) == [["31.0 m", "±2.0", "car 1"]]


def test_closing_speed_and_its_bar() -> None:
    spans = [
        closing_span(6.2, ttc_s, 11, alarm=alarm_colour(ttc_s)) for ttc_s in (1.9, 3.6, 6.0, 12.0)
    ]
    texts = [f"TTC {ttc_s:.1f} s  closing 6.2 m/s" for ttc_s in (1.9, 3.6, 6.0, 12.0)]
    assert [span.text for span in spans if span] == texts
    assert [span.fill for span in spans if span] == [RED, AMBER, CALM, CALM]
    assert [span.filled for span in spans if span] == pytest.approx(
        [1 - 1.9 / 8, 1 - 3.6 / 8, 0.25, 0]
    )
    assert closing_span(-3.0, np.nan, 11) is None
    assert closing_span(np.nan, np.nan, 11) is None
    slow = closing_span(0.6, 80.0, 11)
    assert slow is not None
    assert (slow.text, slow.filled) == ("closing 0.6 m/s", 0.0)


def test_bar_length_and_text_contrast() -> None:
    place = np.array([10.0, 10.0, 213.0, 30.0])  # 200 px behind the stripe
    for filled in (0.0, 0.25, 0.75, 1.0):
        canvas = grey(60, 300)
        TextRenderer().write(
            canvas,
            [[Span("TTC 3.0 s  closing 6.2 m/s", 14, 700, (255, 255, 255), AMBER, filled)]],
            place,
        )
        columns = np.flatnonzero(painted(canvas, AMBER)[11])
        assert len(columns) == round(200 * filled)
        if filled:
            assert (columns[0], columns[-1]) == (13, 12 + round(200 * filled))
        unfilled = canvas[11:27, 13 + round(200 * filled) : 213]
        assert filled == 1.0 or unfilled.max() > 200  # white text
        # black text
        assert not filled or (canvas[11:27, 13 : 13 + round(200 * filled)].max(axis=2) < 60).any()


def test_warnings_start_below_four_and_two_seconds() -> None:
    assert [alarm_colour(ttc_s) for ttc_s in (1.99, 2.0, 3.99, 4.0, np.nan)] == [
        RED,
        AMBER,
        AMBER,
        None,
        None,
    ]


@pytest.mark.parametrize(
    ("metres", "text"), [(7.04, "7.0"), (99.94, "99.9"), (99.96, "100"), (np.nan, "-")]
)
def test_distance_texts(metres: float, text: str) -> None:
    assert distance_text(metres) == text


@pytest.mark.parametrize(
    ("sigma_m", "text"), [(0.04, "0.04"), (0.094, "0.09"), (0.096, "0.1"), (12.3, "12.3")]
)
def test_sigma_text_is_never_zero(sigma_m: float, text: str) -> None:
    assert sigma_text(sigma_m) == text


def test_text_grows_with_the_image() -> None:
    assert text_sizes_px((1242, 374)) == (15, 11, 2)
    assert text_sizes_px((1280, 720)) == (26, 18, 3)
    assert text_sizes_px((133, 100))[1] == 11
    assert text_sizes_px((720, 1280)) == text_sizes_px((720, 540)) == (20, 14, 2)
