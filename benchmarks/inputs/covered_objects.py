"""Exact occlusion of the labelled objects in a frame: fractions of drawn bodies that other bodies hide, and by what.

Each body is drawn alone and with everything else. A sample (four per pixel) of the body is covered if it is drawn
alone, but shows something else in the scene. The true disparity is that of the body itself where the ray through the
box centre first meets it, behind its occluders.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.simulation.render.renderer import SAMPLES, Renderer
from track_range.simulation.render.surface import centre_depth_m
from track_range.simulation.world.truth import visible_objects
from track_range.stereo.matching.patches import inner_halves

NOT_COVERED = "none"
"""Kind of occluder of an object that is not covered."""

SCENERY = "scenery"
"""Kind of occluder for trees, lamps and other objects of the street."""

MIN_COVERED_FRACTION = 0.01
"""Smallest covered fraction of the body, or of its part in the inner half of the box, of an object with an occluder."""

MODAL_FRACTION = 0.5
"""Fraction of objects with the bounding box of their visible part."""


@dataclass(frozen=True, slots=True)
class CoveredObjects:
    """N labelled objects of a frame, nearest first.

    Attributes:
        track_id: (N,) id of the road user.
        kitti_type: (N,) type of the road user.
        xyxy_px: (N, 4) box in the left image: of the visible part of the body if `is_modal`, else of the whole 3-D box.
        is_modal: (N,) whether the box is that of the visible part, as KITTI's stereo data set 2015 has it.
        is_cut: (N,) whether the image border cuts the object.
        true_px: (N,) disparity of the body on the ray through the box centre, as without occluders.
        covered_fraction: (N,) covered fraction of the body's samples.
        covered_inner: (N,) covered fraction of the body's samples in the inner half of the box.
        n_visible_px, n_inner_px: (N,) visible area of the body in px, in total and in the inner half of the box.
        kind: (N,) what covers most of the body: "pole", "fence", "bush", "sign", "road user", `SCENERY`, `NOT_COVERED`.
        occluder_id: (N,) track id of this occluder; -1 = no road user.
        occluder_px: (N,) median disparity of its samples in front of the body; NaN = none.
    """

    track_id: IntArray
    kitti_type: npt.NDArray[np.str_]
    xyxy_px: FloatArray
    is_modal: BoolArray
    is_cut: BoolArray
    true_px: FloatArray
    covered_fraction: FloatArray
    covered_inner: FloatArray
    n_visible_px: FloatArray
    n_inner_px: FloatArray
    kind: npt.NDArray[np.str_]
    occluder_id: IntArray
    occluder_px: FloatArray

    def __len__(self) -> int:
        return len(self.track_id)

    def select(self, rows: BoolArray | IntArray) -> CoveredObjects:
        """The objects of the given rows."""
        return CoveredObjects(*(getattr(self, part.name)[rows] for part in fields(self)))


def covered_objects(renderer: Renderer, time_s: float, *, modal_fraction: float = MODAL_FRACTION) -> CoveredObjects:
    """The labelled objects of the left image at a time.

    Args:
        renderer: renderer of the scene.
        time_s: the time.
        modal_fraction: fraction of the road users, constant over time, with boxes of their visible part.
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
        patch = next(inner_halves(box[None], (camera.height_px, camera.width_px), margin_px=0, min_side_px=1))
        inner = np.zeros_like(body)
        if patch is not None:
            inner_box = np.array([patch.left, patch.top, patch.right, patch.bottom], np.float64)
            top, left = window[0].start, window[1].start
            part = _samples(inner_box, (camera.height_px, camera.width_px))
            inner[part[0].start - top : part[0].stop - top, part[1].start - left : part[1].stop - left] = True
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
    dtypes = (np.int64, np.str_, float, bool, bool, float, float, float, float, float, np.str_, np.int64, float)
    columns = zip(*rows, strict=True) if rows else ([] for _ in dtypes)
    arrays = [np.array(list(column), dtype) for column, dtype in zip(columns, dtypes, strict=True)]
    arrays[2] = arrays[2].reshape(-1, 4)
    return CoveredObjects(*arrays)


def _occluder(
    renderer: Renderer, owner: npt.NDArray[np.uint16], disparity_px: FloatArray, covered: BoolArray, inner: BoolArray
) -> tuple[str, int, float]:
    """Kind, track id and disparity of what covers most of a body; all arrays are windows of samples around it."""
    if not covered.any() or max(covered.mean(), (covered & inner).sum() / max(inner.sum(), 1)) < MIN_COVERED_FRACTION:
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
