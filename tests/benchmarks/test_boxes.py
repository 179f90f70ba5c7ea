"""Tests of drives without images: boxes against the rendered drives' labels, errors, and a run."""

import numpy as np
import pytest

from benchmarks.boxes.box_drive import BoxDrive
from benchmarks.boxes.box_run import IDS_PER_DRIVE, run_boxes, tracked
from benchmarks.boxes.error_model import Memory
from benchmarks.boxes.true_boxes import true_boxes
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.truth import label_scene

RIG = kitti_like_rig(width_px=620, height_px=188)


def test_true_boxes_are_those_of_the_labels():
    scene = make_scenario("city", seed=3, seconds=4.0)
    labels = label_scene(scene, [3.0], camera=RIG.left)
    boxes = true_boxes(scene, np.array([2.9, 3.0]), RIG.left)
    at_3_s = {
        int(user): box
        for user, box, frame in zip(boxes.user, boxes.xyxy_px, boxes.frame, strict=True)
        if frame
    }
    common = [
        (row, at_3_s[user]) for row, user in enumerate(labels.track_id.tolist()) if user in at_3_s
    ]
    assert len(common) > 5
    for row, box in common:
        assert box == pytest.approx(labels.xyxy_px[row], abs=1e-6)


def test_memory_has_the_correlation_of_its_equation():
    values = Memory(0.3, 0.5, 0.4).sample(np.random.default_rng(1), 4000, 30, 0.1)
    assert values.std() == pytest.approx(1.0, abs=0.02)
    for lag in (1, 4, 10):
        expected = 0.3 + 0.5 * np.exp(-0.1 * lag / 0.4)
        assert (values[:, 10] * values[:, 10 + lag]).mean() == pytest.approx(expected, abs=0.05)


def test_drive_depends_on_the_seed_only():
    scene, times_s = make_scenario("following", seed=1, seconds=3.0), np.arange(30) / 10
    first, same, other = (list(BoxDrive(scene, times_s, RIG, seed=seed)) for seed in (1, 1, 2))
    assert all(
        np.array_equal(a.detections.xyxy_px, b.detections.xyxy_px)
        for a, b in zip(first, same, strict=True)
    )
    assert any(len(a.detections) != len(b.detections) for a, b in zip(first, other, strict=True))


def test_runs_of_two_drives_follow_the_vehicle_ahead():
    scene, times_s = make_scenario("following", seed=1, seconds=3.0), np.arange(30) / 10
    drives = [BoxDrive(scene, times_s, RIG, seed=seed) for seed in (1, 2)]
    *_, last = run_boxes(drives, [tracked(drive) for drive in drives])
    ahead = np.flatnonzero(last.user == 0)
    assert set((last.result.tracks.track_id[ahead] // IDS_PER_DRIVE).tolist()) == {0, 1}
    assert last.result.ranges["fused"].distance_m[ahead] == pytest.approx(
        last.true_m[ahead], rel=0.1
    )
