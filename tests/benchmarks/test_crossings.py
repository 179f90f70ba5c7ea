from __future__ import annotations

import numpy as np
import pytest

from benchmarks.accuracy.tracking.crossings import counts_of
from benchmarks.inputs.crossing_scenes import MOTIONS, crossing_scene
from track_range.tracking.deepsort import DeepSortSettings


@pytest.mark.parametrize("motion", MOTIONS)
def test_exact_boxes_lie_on_the_true_ones(motion: str) -> None:
    scene = crossing_scene(3, noise=0.0, motion=motion, n=20)
    assert len(scene.frames) == 20
    for frame, boxes in enumerate(scene.frames):
        true_px = scene.truth.xyxy_px[scene.truth.frame == frame]
        assert 0 < len(boxes) <= len(true_px)
        distance_px = np.abs(boxes.xyxy_px[:, None] - true_px[None]).max(axis=2).min(axis=1)
        assert distance_px.max() < 1e-9


def test_people_who_cross_keep_their_identities_while_the_camera_turns() -> None:
    n_switches = {
        is_compensated: sum(
            counts_of(
                crossing_scene(seed, noise=0.02, motion="turning", n=60),
                DeepSortSettings(is_camera_motion_compensated=is_compensated),
            )
            .scores()
            .idsw
            for seed in range(3)
        )
        for is_compensated in (True, False)
    }
    assert n_switches[True] < 0.8 * n_switches[False]
