"""Tests of the drives with wrong inputs, by hand-worked numbers on images of one colour each."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.accuracy.ranging.doubt import _boxes_text, _truth_of_images
from benchmarks.accuracy.ranging.row_scores import quantity
from benchmarks.inputs import faulty_drives as faults
from track_range.ranging.truth.truth import Truth


def drive(n=12, **others):
    images = [np.full((8, 16, 3), number, np.uint8) for number in range(n)]
    P2 = [100.0, 0, 8, 0, 0, 100, 4, 0, 0, 0, 1, 0]
    P3 = [*P2[:3], -50.0, *P2[4:]]
    return faults.Drive("toy", images, list(images), {"P2": P2, "P3": P3}, "", {}, **others)


def greys(images):
    return [int(image[4, 8, 0]) for image in images]


def test_stated_values_change_the_rig_only():
    longer = faults.baseline(1.25)(drive(), 4).rig
    assert longer["P3"][3] == -62.5
    assert faults.focal(1.15)(drive(), 4).rig["P3"][:4] == pytest.approx([115, 0, 8, -57.5])
    assert [P[2] for P in faults.principal(62)(drive(), 4).rig.values()] == [70, 70]


def test_fifth_images_are_doubled_and_the_stated_rate_keeps_the_time():
    doubled = faults.doubled(drive(), 4)
    assert greys(doubled.right) == [0, 1, 2, 3, 4, 4, 5, 6, 7, 8, 9, 9, 10, 11]
    assert doubled.fps == 12.0
    assert doubled.source(5) == (4, 4)


def test_frozen_images_are_of_the_times_that_pass():
    frozen = faults.frozen(drive(30), 4)
    assert greys(frozen.left) == [*range(4), *[4] * 20, *range(24, 30)]
    assert [frozen.source(k) for k in (3, 10, 24)] == [(3, 3), (4, 10), (24, 24)]


def test_late_speeds_are_those_of_earlier_times():
    known = drive(speed=np.array([[0.0, 5.0], [1.0, 6.0], [2.0, 8.0]]))
    late = faults.speed(factor=2.0, late_s=1.0)(known, 0).speed
    np.testing.assert_allclose(late, [[0, 10], [1, 10], [2, 12]])


def test_boxes_follow_the_images_and_their_scale():
    line = "{} -1 Car -1 -1 -10 100 50 120 60 -1 -1 -1 -1000 -1000 -1000 -10 0.9"
    recorded = drive(boxes="\n".join(line.format(k) for k in range(12)))
    scaled = faults.boxes(0.9)(recorded, 0)
    assert _boxes_text(scaled).splitlines()[3].split()[:10] == [
        *("3", "-1", "Car", "-1", "-1", "-10"),
        *("101.000", "50.500", "119.000", "59.500"),
    ]
    # A zoom of 3 % about the principal point (8, 4), from frame 4 on.
    zoomed = _boxes_text(faults.zoom(1.03, 1.03)(recorded, 4)).splitlines()
    assert zoomed[3].split()[6:10] == ["100.000", "50.000", "120.000", "60.000"]
    assert zoomed[4].split()[6:10] == ["102.760", "51.380", "123.360", "61.680"]


def test_truth_of_a_frozen_image_is_where_the_objects_are_then():
    n = 30
    truth = Truth(
        frame=np.arange(n),
        track_id=np.full(n, 7),
        kitti_type=np.full(n, "Car"),
        class_id=np.zeros(n, np.int64),
        xyxy_px=np.arange(n)[:, None] + np.array([0.0, 0, 5, 5]),
        distance_m=50.0 - np.arange(n),
        closing_mps=np.full(n, 10.0),
    )
    shown = _truth_of_images(truth, faults.frozen(drive(n), 4))
    assert shown.frame.tolist() == list(range(n))
    assert shown.xyxy_px[[3, 10, 24], 0].tolist() == [3, 4, 24]
    assert shown.distance_m[[3, 10, 24]].tolist() == [47, 40, 26]


def test_blank_rows_are_counted_apart():
    true, value = np.array([10.0, 20.0, 30.0, 40.0]), np.array([11.0, np.nan, 30.5, 44.0])
    scores = quantity("fused", true, value, np.array([0.8, np.nan, 1.0, 1.0]))
    assert [scores[f"fused_{part}"] for part in ("rows", "known", "1_sigma", "2_sigma")] == [
        *(4, 3, 1, 2),
    ]
    assert scores["fused_median_pct"] == 10.0


@pytest.mark.parametrize("fault", faults.FAULTS, ids=lambda fault: f"{fault.section} {fault.name}")
def test_every_fault_changes_its_input(fault):
    if fault.name == "unrelated videos":
        pytest.skip("needs real drives")
    given = drive(40, speed=np.stack([np.arange(40) / 10, 5 + np.arange(40) / 10], 1), boxes="")
    sides = np.random.default_rng(1).integers(0, 255, (2, 40, 40, 60, 3), np.uint8)
    given = replace(given, left=list(sides[0]), right=list(sides[1]))
    changed = fault.change(given, 10)
    assert changed.n_frames == len(changed.right)
    same_images = (
        all(
            a.shape == b.shape and (a == b).all()
            for side in ("left", "right")
            for a, b in zip(getattr(given, side), getattr(changed, side), strict=False)
        )
        and changed.n_frames == given.n_frames
    )
    same_values = changed.rig == given.rig and changed.fps == given.fps
    same_values &= changed.box_scale == given.box_scale and changed.speed is given.speed
    assert not (same_images and same_values)
