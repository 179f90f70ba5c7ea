"""Notes on runs that found nothing: images without content or upside down, and pairs that measure
nothing."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.results.overlay_results import BOX, result
from track_range.detection.detections import Detections
from track_range.run.reports.findings import Findings
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

RIG = StereoRig.rectified(PinholeCamera(720.0, 720.0, 620.0, 187.0, 1242, 374), 0.5)
SKY = np.repeat(np.linspace(220, 60, 374).astype(np.uint8)[:, None, None], 1242, axis=1).repeat(
    3, axis=2
)  # bright above
NOISE = np.random.default_rng(0).integers(0, 6, (374, 1242, 3)).astype(np.uint8)


def notes_of(image, *, boxes=(), right=None, detect=None, rig=None, ranges=None, n=30):
    findings = Findings(detect, rig)
    for index in range(n):
        frame = result(list(boxes), image=image, ranges=ranges, index=index, time_s=index / 10)
        findings.add(replace(frame, frame=replace(frame.frame, right=right)))
    return findings.notes()


def boxes_if_bright_above(frame):
    """Three road users in an image whose upper rows are brighter than its lower ones."""
    n = 3 if frame.left[0].mean() > frame.left[-1].mean() else 0
    return Detections.of(np.tile(BOX, (n, 1)), np.full(n, 0.9), np.full(n, 2))


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (SKY * 0, "black (mean brightness 0 of 255"),
        (NOISE, "black (mean brightness 3 of 255"),  # noise of the sensor behind a lens cap
        (SKY * 0 + 128, "nearly uniform (mean brightness 128"),
        (SKY, "No road user was found in 30 frames (mean brightness 141 of 255)"),
        (SKY[::-1], "upside down"),
    ],
)
def test_a_run_without_road_users(image, words):
    (note,) = notes_of(np.ascontiguousarray(image), detect=boxes_if_bright_above)
    assert words in note


def test_a_run_with_road_users_has_no_note():
    assert notes_of(SKY, boxes=[BOX], detect=boxes_if_bright_above) == ()
    dark = SKY // 10  # a night drive: 14 of 255
    assert notes_of(dark, boxes=[BOX], detect=boxes_if_bright_above) == ()
    assert Findings(boxes_if_bright_above, None).notes() == ()


def test_upside_down_images_with_some_boxes():
    upside_down = np.ascontiguousarray(SKY[::-1])
    assert "upside down" in notes_of(upside_down, boxes=[BOX], detect=boxes_if_bright_above)[0]
    # recorded boxes: nothing can be detected
    assert notes_of(upside_down, boxes=[BOX], detect=None) == ()
    # lower rows may be brighter at night, by the headlights: the detector decides
    upright = notes_of(
        upside_down,
        boxes=[BOX],
        detect=lambda frame: boxes_if_bright_above(replace(frame, left=SKY)),
    )
    assert upright == ()


@pytest.mark.parametrize(
    ("right", "distance_m", "words"),
    [
        (SKY * 0, 20.0, "The right images are black"),
        (SKY, 400.0, "about 400 m away, where their disparity is 0.9 px"),
        (SKY, 20.0, "images do not match on the road users"),
    ],
)
def test_a_pair_that_measures_nothing(right, distance_m, words):
    ranges = {"mono": (distance_m, 1.0), "stereo": (np.nan, np.nan), "fused": (distance_m, 1.0)}
    (note,) = notes_of(SKY, boxes=[BOX], right=right, rig=RIG, ranges=ranges)
    assert note.startswith("stereo measured none of 30 boxes. ")
    assert words in note
    assert notes_of(SKY, boxes=[BOX], right=right, rig=RIG) == ()  # stereo measured all
    # too few boxes
    assert notes_of(SKY, boxes=[BOX], right=right, rig=RIG, ranges=ranges, n=10) == ()
