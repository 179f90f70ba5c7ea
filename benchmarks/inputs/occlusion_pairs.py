"""Stereo pairs of the scenario `occlusion` with exact truth: unrelated images, and short sequences
of tracks.

Each seed is a drive; even seeds have KITTI's images (1242 x 375 px, f = 723 px), odd ones 1280 x
720 px with the same angle of view; the baseline is 0.54 m. A pair contains the boxes of all road
users and signs with at least `MIN_VISIBLE_PX` visible pixels, also of those that occlude others;
`is_scored` selects the objects that count.

Exact occlusion: each body is drawn alone and with everything else. A sample (four per pixel) of the
body is covered if it is drawn alone, but shows something else in the scene. The true disparity is
that of the body itself where the ray through the box centre first meets it, behind its occluders.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from track_range.detection.classes import ROAD_CLASS_OF
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.simulation.render.renderer import SAMPLES, Renderer, kitti_like_rig
from track_range.simulation.render.surface import centre_depth_m
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scenarios.occlusion import reference_times_s
from track_range.simulation.world.truth import visible_objects
from track_range.stereo.evaluation.disparity_errors import BANDS_M
from track_range.stereo.evaluation.kitti_2015 import MIN_INNER_PIXELS, MIN_TRUE_PIXELS, StereoPair
from track_range.stereo.matching.sgbm import inner_halves

SIZES_PX = ((1242, 375), (1280, 720))  # image sizes of even and of odd seeds
SECONDS = 7.0  # length of a drive, s

SEQUENCE_FPS, N_SEQUENCE = 10.0, 6
"""Frame rate and number of frames of the sequence; its last but one frame is the third unrelated
image."""

MIN_VISIBLE_PX = MIN_TRUE_PIXELS  # smallest visible area of an object with a box, px

MAX_COVERED_FRACTION, MAX_COVERED_INNER = 0.5, 0.75
"""Largest covered fractions of scored objects: of the body, as for KITTI's "partly occluded"
objects, which the other evaluations use too, and of its part in the inner half of the box."""

ID_STEP = 100_000  # difference between the track ids of successive seeds

NOT_COVERED = "none"  # kind of occluder of an object that is not covered
SCENERY = "scenery"  # kind of occluder for trees, lamps and other objects of the street

MIN_COVERED_FRACTION = 0.01
"""Smallest covered fraction of the body, or of its part in the inner half of the box, of an object
with an occluder."""

MODAL_FRACTION = 0.5  # fraction of objects with the bounding box of their visible part


@dataclass(frozen=True, slots=True)
class CoveredObjects:
    """N labelled objects of a frame, nearest first."""

    track_id: IntArray  # (N,) id of the road user
    kitti_type: npt.NDArray[np.str_]  # (N,) type of the road user
    # (N, 4) box in the left image: of the visible part of the body if `is_modal`, else of the whole
    # 3-D box
    xyxy_px: FloatArray
    # (N,) whether the box is that of the visible part, as KITTI's stereo data set 2015 has it
    is_modal: BoolArray
    is_cut: BoolArray  # (N,) whether the image border cuts the object
    # (N,) disparity of the body on the ray through the box centre, as without occluders
    true_px: FloatArray
    covered_fraction: FloatArray  # (N,) covered fraction of the body's samples
    # (N,) covered fraction of the body's samples in the inner half of the box
    covered_inner: FloatArray
    # n_visible_px, n_inner_px: (N,) visible area of the body in px, in total and in the inner half
    # of the box
    n_visible_px: FloatArray
    n_inner_px: FloatArray
    # (N,) what covers most of the body: "pole", "fence", "bush", "sign", "road user", `SCENERY`,
    # `NOT_COVERED`
    kind: npt.NDArray[np.str_]
    occluder_id: IntArray  # (N,) track id of this occluder; -1 = no road user
    occluder_px: FloatArray  # (N,) median disparity of its samples in front of the body; NaN = none

    def __len__(self) -> int:
        return len(self.track_id)

    def select(self, rows: BoolArray | IntArray) -> CoveredObjects:
        return CoveredObjects(*(getattr(self, part.name)[rows] for part in fields(self)))


def covered_objects(
    renderer: Renderer, time_s: float, *, modal_fraction: float = MODAL_FRACTION
) -> CoveredObjects:
    """The labelled objects of the left image at a time; a constant fraction of the road users has
    modal boxes.
    """
    scene, camera = renderer.scene, renderer.rig.left
    inverse_depth, owner = renderer.drawn_owners(time_s)
    visible = visible_objects(scene, time_s, frame=0, camera=camera, inverse_depth=inverse_depth)
    location_m, rotations = scene.location_m(time_s), scene.rotations(time_s)
    focal_baseline = camera.fx_px * renderer.rig.baseline_m
    rows: list[tuple[object, ...]] = []
    for number in np.flatnonzero(visible.labels.track_id >= 0).tolist():
        row, label_box = int(visible.row[number]), visible.labels.xyxy_px[number]
        user = scene.road_users[row]
        window = _samples(label_box, (camera.height_px, camera.width_px))
        body = renderer.silhouette(time_s, row)[window] > 0
        shown = (owner[window] == row + 1) & body
        if not shown.any():
            continue
        is_modal = np.random.default_rng([scene.seed, 32, user.track_id]).uniform() < modal_fraction
        box = _bounding_box(shown, window) if is_modal else label_box
        patch = next(inner_halves(box[None], (camera.height_px, camera.width_px)))
        inner = np.zeros_like(body)
        if patch is not None:
            inner_box = np.array([patch.left, patch.top, patch.right, patch.bottom], np.float64)
            top, left = window[0].start, window[1].start
            part = _samples(inner_box, (camera.height_px, camera.width_px))
            inner[
                part[0].start - top : part[0].stop - top, part[1].start - left : part[1].stop - left
            ] = True
        covered = body & ~shown
        kind, occluder_id, occluder_px = _occluder(
            renderer, owner[window], focal_baseline * inverse_depth[window], covered, inner
        )
        surface = renderer.surface(row).transformed(rotations[row], location_m[row])
        rows.append(
            (
                user.track_id,
                user.kitti_type,
                box,
                is_modal,
                visible.labels.truncated[number] > 0,
                focal_baseline / centre_depth_m(surface, camera, box),
                covered.sum() / body.sum(),
                (covered & inner).sum() / max((body & inner).sum(), 1),
                shown.sum() / SAMPLES**2,
                (shown & inner).sum() / SAMPLES**2,
                kind,
                occluder_id,
                occluder_px,
            )
        )
    dtypes = (
        np.int64,
        np.str_,
        float,
        bool,
        bool,
        float,
        float,
        float,
        float,
        float,
        np.str_,
        np.int64,
        float,
    )
    columns = zip(*rows, strict=True) if rows else ([] for _ in dtypes)
    arrays = [np.array(list(column), dtype) for column, dtype in zip(columns, dtypes, strict=True)]
    arrays[2] = arrays[2].reshape(-1, 4)
    return CoveredObjects(*arrays)


def _occluder(
    renderer: Renderer,
    owner: npt.NDArray[np.uint16],
    disparity_px: FloatArray,
    covered: BoolArray,
    inner: BoolArray,
) -> tuple[str, int, float]:
    """Kind, track id and disparity of what covers most of a body; all arrays are windows of samples
    around it.
    """
    if (
        not covered.any()
        or max(covered.mean(), (covered & inner).sum() / max(inner.sum(), 1)) < MIN_COVERED_FRACTION
    ):
        return NOT_COVERED, -1, np.nan
    where = covered & inner if (covered & inner).any() else covered
    number = int(np.bincount(owner[where]).argmax())
    occluder_px = float(np.median(disparity_px[where & (owner == number)]))
    users, obstacles = renderer.scene.road_users, renderer.scene.obstacles
    if number == 0:
        return SCENERY, -1, occluder_px
    if number > len(users):
        return obstacles[number - len(users) - 1].kind, -1, occluder_px
    user = users[number - 1]
    return "sign" if user.raised_m > 0 else "road user", user.track_id, occluder_px


def _samples(xyxy_px: FloatArray, image_hw: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of the samples of the pixels between the edges of a box, inclusive."""
    first = np.maximum(np.floor(xyxy_px[:2] + 0.5), 0).astype(int).tolist()
    last = np.minimum(np.ceil(xyxy_px[2:] - 0.5), np.array(image_hw[::-1]) - 1).astype(int).tolist()
    return (
        slice(SAMPLES * first[1], SAMPLES * (last[1] + 1)),
        slice(SAMPLES * first[0], SAMPLES * (last[0] + 1)),
    )


def _bounding_box(shown: BoolArray, window: tuple[slice, slice]) -> FloatArray:
    """(4,) box of the pixels with a shown sample, in a window of samples."""
    rows, columns = (np.flatnonzero(shown.any(axis=axis)) // SAMPLES for axis in (1, 0))
    top, left = window[0].start // SAMPLES, window[1].start // SAMPLES
    low = np.array([left + columns[0], top + rows[0]]) - 0.5
    high = np.array([left + columns[-1], top + rows[-1]]) + 0.5
    return np.concatenate([low, high])


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
    """(N,) objects that count: vehicles and people of known distance, inside the image and at least
    half visible.
    """
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
    objects = objects.select(
        (objects.n_visible_px >= MIN_VISIBLE_PX) & np.isfinite(objects.true_px)
    )
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
