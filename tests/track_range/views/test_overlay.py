"""The overlay: drawing, layout of labels, and robustness to any result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.results.overlay_results import BOX, HEIGHT, WIDTH, grey, painted, result
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.lanes.lines import LaneLine, LaneLines
from track_range.pipeline.colours import LANE_COLOUR, PALETTE, RED, track_colour
from track_range.ranging.warning.safety import SafetyMeasures
from track_range.ranging.warning.warnings import Warnings
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rectification import Undistorter
from track_range.views.overlay.annotator import Overlay
from track_range.views.overlay.labels import label_lines, shown_name


def test_frame_is_not_modified() -> None:
    rng = np.random.default_rng(3)
    image = rng.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
    before = image.copy()
    image.setflags(write=False)
    drawn = Overlay().draw(result([BOX], image=image))
    assert np.array_equal(image, before)
    assert drawn.shape == image.shape
    assert drawn.dtype == np.uint8
    assert not np.array_equal(drawn, before)


def test_predicted_box_is_dashed() -> None:
    # the lower edge, where no label is placed while there is room above
    fraction = {}
    for observed in (True, False):
        drawn = Overlay().draw(result([BOX], observed=observed))
        fraction[observed] = painted(drawn, track_colour(1))[280, 505:615].mean()
    assert fraction[True] == 1.0
    assert 0.3 < fraction[False] < 0.8


def test_dashed_outline_stays_on_the_box() -> None:
    drawn = Overlay().draw(result([BOX], observed=False))
    changed = (drawn != 128).any(axis=2)
    changed[:200] = changed[:, :160] = False
    rows, columns = np.nonzero(changed)
    assert 497 <= columns.min() <= columns.max() <= 623
    assert rows.max() <= 283
    assert not changed[210:270, 510:610].any()


def test_inner_window_is_marked_by_its_corners() -> None:
    # The inner half of BOX: columns 530..590, rows 220..260.
    inside = Overlay().draw(result([BOX]))[205:275, 505:615]
    rows, columns = np.nonzero(painted(inside, track_colour(1)))
    assert (rows.min() + 205, rows.max() + 205) == (220, 260)
    assert (columns.min() + 505, columns.max() + 505) == (530, 590)
    assert not painted(inside, track_colour(1))[30:40].any()
    for unmarked in (result([BOX], ranges={"mono": (9.0, 1.0)}), result([BOX], observed=False)):
        assert not painted(Overlay().draw(unmarked)[205:275, 505:615], track_colour(1)).any()


def test_lane_lines_are_drawn() -> None:
    straight = LaneLine(np.array([700.0, 0.5, 0.0]), np.eye(3), 210.0, 350.0)
    drawn = Overlay().draw(result([], lanes=LaneLines(None, straight)))
    lime = painted(drawn, LANE_COLOUR)
    rows = np.flatnonzero(lime.any(axis=1))
    assert (rows.min(), rows.max()) == pytest.approx((210, 350), abs=2)
    for row in (230, 280, 340):
        assert np.flatnonzero(lime[row]).mean() == pytest.approx(700 + 0.5 * row, abs=1.5)
    assert not painted(Overlay().draw(result([])), LANE_COLOUR).any()


def test_lane_line_beyond_the_image() -> None:
    wild = LaneLine(np.array([-1e9, 1e7, 0.0]), np.eye(3), 90.0, 373.0)
    assert Overlay().draw(result([], lanes=LaneLines(wild, None))).shape == (HEIGHT, WIDTH, 3)


def test_colours_of_tracks() -> None:
    assert len(set(PALETTE)) == len(PALETTE) == 12
    assert track_colour(5) == track_colour(5 + 12) != track_colour(6)
    for blue, green, red in PALETTE:
        assert 0.114 * blue + 0.587 * green + 0.299 * red >= 0.49 * 255


def test_frame_without_tracks() -> None:
    drawn = Overlay().draw(result([]))
    changed = (drawn != 128).any(axis=2)
    assert changed[:20].any()
    assert not changed[20:, 160:].any()
    assert changed[300, 60]  # bird's-eye view


@pytest.mark.parametrize(
    ("ttc_front_s", "offset_m", "probability", "text"),
    [
        (0.6, 1.0, 0.1, "TTC 0.6 s  closing 20.5 m/s"),
        # its edge and that of the path, 1.8 m wide each, overlap
        (np.nan, 1.7, 0.1, "closing 20.5 m/s"),
        (np.nan, 1.9, 0.1, "beside in 0.7 s  closing 20.5 m/s"),
        (np.nan, -1.9, 0.3, "closing 20.5 m/s"),  # a contact is possible
        (np.nan, np.nan, 0.1, "closing 20.5 m/s"),
    ],
)
def test_time_to_collision_is_that_of_the_front_on_a_collision_course(
    ttc_front_s: float, offset_m: float, probability: float, text: str
) -> None:
    nan = np.full(1, np.nan)
    safety = SafetyMeasures(nan, np.array([ttc_front_s]), *[nan] * 7, np.zeros(1, np.bool_))
    warnings = Warnings(np.array([probability]), np.zeros(1, np.bool_), np.array([offset_m]))
    shown = result([BOX], closing=(20.5, 0.7), safety=safety, warnings=warnings)
    [span] = label_lines(shown, 0, class_names=ROAD_CLASSES, sizes_px=(16, 11))[-1]
    assert span.text == text
    assert (span.filled > 0) == text.startswith("TTC")


def test_urgent_track_is_red() -> None:
    n_red = [
        painted(Overlay().draw(result([BOX], closing=(10.0, ttc_s))), RED).sum()
        for ttc_s in (1.5, 3.0, 10.0)
    ]
    assert n_red[0] > 500
    assert n_red[1:] == [0, 0]


def test_class_names_are_shortened() -> None:
    assert shown_name("小汽车 <b>&\"'") == "小汽车 <b>&\"'"
    assert shown_name("two\nlines\tof it") == "two lines of it"
    assert shown_name("x" * 300) == "x" * 23 + "…"
    for names in (("person", "bicycle", "x" * 300), ("", "", "\n"), ("a", "b", "<script>")):
        assert Overlay(names).draw(result([BOX])).shape == (HEIGHT, WIDTH, 3)


HOSTILE = [
    [-300.0, -200.0, -100.0, -50.0],
    [1e9, 1e9, 2e9, 2e9],
    [-1e12, -1e12, 1e12, 1e12],
    [np.nan, 10.0, 20.0, 30.0],
    [10.0, 10.0, np.inf, 30.0],
    [100.0, 100.0, 100.0, 100.0],
    [300.0, 300.0, 200.0, 200.0],
    [1200.0, 350.0, 1300.0, 420.0],
]


@pytest.mark.parametrize("observed", [True, False])
@pytest.mark.parametrize("size", [(HEIGHT, WIDTH), (24, 32), (1, 1), (2160, 3840), (1280, 720)])
def test_any_boxes_on_any_image(observed: bool, size: tuple[int, int]) -> None:
    ranges = {"fused": (np.nan, np.nan), "mono": (np.inf, np.nan)}
    shown = result(HOSTILE, image=grey(*size), observed=observed, ranges=ranges, closing=(9.0, 1.0))
    assert Overlay().draw(shown).shape == (*size, 3)


def test_box_with_nan_is_not_drawn() -> None:
    nowhere = Overlay().draw(result([[np.nan, 10.0, 20.0, 30.0]]))
    assert np.array_equal(nowhere, Overlay().draw(result([])))


def test_box_partly_outside() -> None:
    drawn = Overlay().draw(result([[1100.0, 250.0, 1400.0, 500.0]]))
    own = painted(drawn, track_colour(1))
    assert own[250, 1110:WIDTH].all()
    assert not own[300:340, WIDTH - 2].any()


def test_crowd_is_drawn_nearest_on_top() -> None:
    rng = np.random.default_rng(5)
    corner = rng.uniform((0, 100), (1200, 300), (80, 2))
    boxes = np.hstack([corner, corner + 40]).tolist()
    drawn = Overlay().draw(result(boxes))
    assert (drawn != 128).any(axis=2).mean() > 0.3


def test_nearest_of_a_thousand_have_labels() -> None:
    """The box with the lowest bottom edge is nearest; labels of farther ones do not affect it."""
    column, row = np.divmod(np.arange(1000), 20)
    boxes = np.stack(
        [70.0 * column, 100.0 * row + 50, 70.0 * column + 20, 100.0 * row + 70 + column / 100],
        axis=1,
    )
    shown = result(boxes.tolist(), image=grey(2160, 3840))
    pictures = []
    for changed in (np.argmax(boxes[:, 3]), np.argmin(boxes[:, 3]), None):
        tracks = shown.tracks
        class_id = np.where(np.arange(1000) == changed, 1, tracks.class_id)
        pictures.append(Overlay().draw(replace(shown, tracks=replace(tracks, class_id=class_id))))
    assert not np.array_equal(pictures[0], pictures[2])
    assert np.array_equal(pictures[1], pictures[2])


def test_image_too_small_for_text() -> None:
    tiny = Overlay().draw(result([[4.0, 4.0, 20.0, 16.0]], image=grey(24, 32)))
    assert painted(tiny, track_colour(1)).any()
    assert (tiny[0] == 128).all()
    assert (tiny[20:] == 128).all()


def test_real_frame_is_visible_under_the_overlay(shared_data: Path) -> None:
    video = cv2.VideoCapture(str(shared_data / "kitti_stereo/0003/left.mp4"))
    read, image = video.read()
    video.release()
    assert read
    drawn = Overlay().draw(
        result([BOX, [100.0, 180.0, 160.0, 220.0]], image=np.asarray(image, np.uint8))
    )
    assert (drawn == image).all(axis=2).mean() > 0.9


def test_status_in_the_corner() -> None:
    statuses = iter([(), ("12.3 fps", "a sentence that needs room")])
    overlay = Overlay(status=lambda: next(statuses))
    short, long = (overlay.draw(result([])) for _ in range(2))
    assert (long != short).any(axis=2)[:15, 150:350].any()


def test_label_keeps_its_place() -> None:
    """Car 1 covers what is above car 2; when it has gone, car 2's label stays below."""
    overlay = Overlay()
    blocked = [[480.0, 60.0, 700.0, 195.0], BOX]
    rows = []
    for boxes in (blocked, [[0.0, 0.0, 0.0, 0.0], BOX]):
        label = np.flatnonzero((overlay.draw(result(boxes)) != 128).any(axis=2)[:, 505])
        rows.append(bool((label > 284).any()))
    assert rows[0]
    assert rows[0] == rows[1]


def test_boxes_are_curved_in_the_recorded_image_of_a_wide_lens() -> None:
    lens = PinholeCamera(200.0, 200.0, 319.5, 199.5, 640, 400, (0.0,) * 4, "kannala-brandt")
    undistorter = Undistorter(lens)
    camera = undistorter.camera
    box = [camera.cx_px + 150, camera.cy_px + 40, camera.cx_px + 300, camera.cy_px + 180]
    shown = result([box], image=grey(camera.height_px, camera.width_px))
    recorded = replace(shown, frame=replace(shown.frame, recorded=grey(400, 640)))
    drawn = Overlay(camera=camera, recorded=undistorter).draw(recorded)
    assert drawn.shape == (400, 640, 3)
    middle_px = undistorter.recorded_points(
        np.array([[box[2], (box[1] + box[3]) / 2], [box[2], box[3]]])
    )
    for x, y in np.rint(middle_px).astype(int):
        assert painted(drawn, track_colour(1))[y - 2 : y + 3, x - 2 : x + 3].any()
    assert middle_px[0, 0] - middle_px[1, 0] > 4  # the right edge is curved
