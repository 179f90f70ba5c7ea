"""Stereo pairs of the scenario `occlusion` with exact truth: unrelated images, and short sequences of tracks.

Each seed is a drive; even seeds have KITTI's images (1242 x 375 px, f = 723 px), odd ones 1280 x 720 px with the same
angle of view; the baseline is 0.54 m. Unrelated images are `EVERY_S` apart. A pair contains the boxes of all road users
and signs with at least `MIN_VISIBLE_PX` visible pixels, also of those that occlude others; `is_scored` selects the
objects that count.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.inputs.covered_objects import CoveredObjects, covered_objects
from track_range.detection.classes import ROAD_CLASS_OF
from track_range.foundation.arrays import BoolArray
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scenarios.occlusion import reference_times_s
from track_range.stereo.evaluation.disparity_errors import BANDS_M
from track_range.stereo.evaluation.kitti_2015 import MIN_INNER_PIXELS, MIN_TRUE_PIXELS, StereoPair

SIZES_PX = ((1242, 375), (1280, 720))
"""Image sizes of even and of odd seeds."""

SECONDS = 7.0
"""Length of a drive, s."""

SEQUENCE_FPS, N_SEQUENCE = 10.0, 6
"""Frame rate and number of frames of the sequence; its last but one frame is the third unrelated image."""

MIN_VISIBLE_PX = MIN_TRUE_PIXELS
"""Smallest visible area of an object with a box, px."""

MAX_COVERED_FRACTION, MAX_COVERED_INNER = 0.5, 0.75
"""Largest covered fractions of scored objects: of the body, as for KITTI's "partly occluded" objects, which the other
evaluations use too, and of its part in the inner half of the box."""

ID_STEP = 100_000
"""Difference between the track ids of successive seeds."""


@dataclass(frozen=True, slots=True)
class OcclusionPair:
    """A pair with the truth of its objects, in the same order as `pair.xyxy_px`."""

    pair: StereoPair
    objects: CoveredObjects
    seed: int


def unrelated_pairs(seeds: range) -> Iterator[OcclusionPair]:
    """The unrelated images of each seed; they have no track ids."""
    for seed in seeds:
        renderer = _renderer(seed)
        for time_s in reference_times_s(SECONDS):
            yield _pair(renderer, time_s, has_ids=False)


def sequences(seeds: range) -> Iterator[OcclusionPair]:
    """The frames of the sequence of each seed; track ids differ between seeds."""
    for seed in seeds:
        renderer = _renderer(seed)
        last_s = reference_times_s(SECONDS)[2] + 1 / SEQUENCE_FPS
        for number in reversed(range(N_SEQUENCE)):
            yield _pair(renderer, last_s - number / SEQUENCE_FPS, has_ids=True)


def is_scored(objects: CoveredObjects, pair: StereoPair) -> BoolArray:
    """(N,) objects that count: vehicles and people of known distance, inside the image and at least half visible."""
    distance_m = pair.rig.distance_m(pair.true_px)
    return np.asarray(
        ~objects.is_cut
        & (objects.kitti_type != "TrafficSign")
        & (distance_m >= BANDS_M[0][0])
        & (distance_m <= BANDS_M[-1][1])
        & (objects.covered_fraction <= MAX_COVERED_FRACTION)
        & (objects.covered_inner <= MAX_COVERED_INNER)
        & (objects.n_inner_px >= MIN_INNER_PIXELS)
    )


def _renderer(seed: int) -> Renderer:
    width_px, height_px = SIZES_PX[seed % 2]
    scene = make_scenario("occlusion", seed=seed, seconds=SECONDS)
    return Renderer(scene, kitti_like_rig(width_px=width_px, height_px=height_px))


def _pair(renderer: Renderer, time_s: float, *, has_ids: bool) -> OcclusionPair:
    seed = renderer.scene.seed
    objects = covered_objects(renderer, time_s)
    objects = objects.select((objects.n_visible_px >= MIN_VISIBLE_PX) & np.isfinite(objects.true_px))
    left, right = (renderer.render(time_s, side=side) for side in ("left", "right"))
    pair = StereoPair(
        f"{seed}_{round(100 * time_s):04}",
        left,
        right,
        objects.xyxy_px,
        objects.true_px,
        renderer.rig,
        track_id=objects.track_id + ID_STEP * seed if has_ids else np.zeros(0, np.int64),
        class_names=tuple(ROAD_CLASS_OF[kind.lower()] for kind in objects.kitti_type.tolist()),
    )
    return OcclusionPair(pair, objects, seed)
