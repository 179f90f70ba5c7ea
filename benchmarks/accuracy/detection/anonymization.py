"""Fraction of the head and number plate pixels that `--anonymize` covers in simulated drives.

`live` uses no later frames. Heads and plates that may be recognised count separately
(`READABLE_PX`).
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
import numpy.typing as npt
from rich.console import Console

from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.drives import SimulatedDrive
from track_range.detection.boxes import iou
from track_range.detection.catalogue.lookup import DEFAULT_MODEL
from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.detections import Detections
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.pipeline.alarming import Alarms
from track_range.pipeline.filtering import Approach
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.world import World
from track_range.run.box_source import CANDIDATE_SCORE
from track_range.run.options.opened import DetectorOptions, open_detector
from track_range.run.ready_model import ready_model
from track_range.simulation.camera.drive_files import masks_of
from track_range.simulation.world.bodies.faces import IdentifyingPart
from track_range.simulation.world.truth import visible_objects
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.deepsort import DeepSortTracker
from track_range.tracking.tracks import Tracks
from track_range.views.anonymization.look_ahead import LIVE, OFFLINE, LookAhead, with_regions
from track_range.views.anonymization.regions import Regions

SCENARIOS = ("town", "highway", "city", "cut-in", "crossing", "queue", "night")

READABLE_PX = {IdentifyingPart.HEAD: 8, IdentifyingPart.PLATE: 12}
"""Minimum width of a part of which details can be recognised, px."""

CLASSES = {
    IdentifyingPart.HEAD: [
        ROAD_CLASSES.index(name) for name in ("person", "bicycle", "motorcycle")
    ],
    IdentifyingPart.PLATE: [
        ROAD_CLASSES.index(name) for name in ("car", "motorcycle", "bus", "truck")
    ],
}
"""Classes of road users with each part."""

COVERED_FRACTION = 0.9
"""Minimum covered fraction of a readable part; with less in one of its frames, its road user counts
as exposed."""

TRACKED_IOU = 0.3
MIN_VISIBLE_FRACTION = 0.1

BoxSource = Literal["detector", "truth"]
Key = tuple[IdentifyingPart, bool, bool]
"""Part, whether only readable ones count, whether only those of tracked objects count."""


@dataclass(frozen=True, slots=True)
class SeenPart:
    """A visible head or plate: row of its road user in the scene, (P,) rows and columns of its
    pixels.

    `is_tracked`: whether a track shows its road user, by source of the boxes.
    """

    user: int
    part: IdentifyingPart
    row: IntArray
    column: IntArray
    is_tracked: dict[BoxSource, bool]

    @property
    def is_readable(self) -> bool:
        return int(np.ptp(self.column)) + 1 >= READABLE_PX[self.part]


@dataclass(frozen=True, slots=True)
class SeenFrame:
    results: dict[BoxSource, FrameResult]
    parts: tuple[SeenPart, ...]
    shape: tuple[int, int]


@workload(
    option("--scenarios", default=SCENARIOS, choices=SCENARIOS, help="scenarios of the drives"),
    option("--seeds", default=(101, 102), help="random seeds of the drives"),
    option("--seconds", default=5.0, help="length of each drive"),
)
def anonymization(options: Namespace) -> Figures:
    drives = [
        list(seen_frames(scenario, seed, options.seconds))
        for scenario in options.scenarios
        for seed in options.seeds
    ]
    figures: Figures = {}
    sources: tuple[BoxSource, ...] = ("detector", "truth")
    for source, (name, look_ahead) in product(sources, (("file", OFFLINE), ("live", LIVE))):
        for fraction, value in scores(drives, source, look_ahead).items():
            figures.setdefault(fraction, {})[f"{source}, {name}"] = value
    return {"coverage": figures}


def seen_frames(scenario: str, seed: int, seconds: float) -> Iterator[SeenFrame]:
    drive = SimulatedDrive.of(scenario, seed=seed, seconds=seconds)
    renderer = drive.renderer
    network = open_detector(ready_model(DEFAULT_MODEL, Console(quiet=True)), DetectorOptions())
    trackers: dict[BoxSource, DeepSortTracker] = {
        "detector": DeepSortTracker(),
        "truth": DeepSortTracker(),
    }
    for index, time_s in enumerate(drive.times_s.tolist()):
        image, inverse_depth, labels = renderer.render_with_labels(time_s)
        visible = visible_objects(
            renderer.scene,
            time_s,
            frame=index,
            camera=renderer.rig.left,
            inverse_depth=inverse_depth,
        )
        is_visible = visible.visible_share >= MIN_VISIBLE_FRACTION
        class_id = map_to_road_classes([user.kitti_type for user in renderer.scene.road_users])[
            visible.row
        ]
        rows = np.flatnonzero(is_visible & (class_id >= 0))
        boxes_px = visible.labels.xyxy_px
        detections: dict[BoxSource, Detections] = {
            "detector": network.detect(image),
            "truth": Detections.of(boxes_px[rows], np.ones(len(rows)), class_id[rows]),
        }
        candidates = {"detector": network.candidates(CANDIDATE_SCORE), "truth": detections["truth"]}
        frame = Frame(index, time_s, image[:0], None)
        results: dict[BoxSource, FrameResult] = {}
        for source, tracker in trackers.items():
            tracks = tracker.update(detections[source], time_s, image)
            results[source] = result_of(frame, tracks, candidates[source])
        parts = seen_parts(
            *masks_of(labels), visible.row, boxes_px, {s: r.tracks for s, r in results.items()}
        )
        yield SeenFrame(results, tuple(parts), image.shape[:2])


def result_of(frame: Frame, tracks: Tracks, candidates: Detections) -> FrameResult:
    """A frame result without distances."""
    n = len(tracks)
    return FrameResult(
        frame=frame,
        tracks=tracks,
        ranges={},
        approach=Approach.unknown(n),
        world=World.unknown(n),
        alarms=Alarms.none(n),
        candidates=candidates,
    )


def seen_parts(
    part: npt.NDArray[np.uint8],
    user: IntArray,
    visible_row: IntArray,
    boxes_px: FloatArray,
    tracks: dict[BoxSource, Tracks],
) -> Iterator[SeenPart]:
    box_of = {int(row): boxes_px[k] for k, row in enumerate(visible_row)}
    for number in np.unique(np.where(part > 0, 2 * user + part, 0))[1:].tolist():
        which, row = IdentifyingPart((number - 1) % 2 + 1), (number - 1) // 2
        rows, columns = np.nonzero((part == which) & (user == row))
        is_tracked = {
            source: row in box_of
            and _is_shown(box_of[row], shown.select(np.isin(shown.class_id, CLASSES[which])))
            for source, shown in tracks.items()
        }
        yield SeenPart(row, which, rows, columns, is_tracked)


def _is_shown(xyxy_px: FloatArray, tracks: Tracks) -> bool:
    return len(tracks) > 0 and bool(iou(xyxy_px[None], tracks.xyxy_px).max() >= TRACKED_IOU)


def covered(regions: Regions, shape: tuple[int, int]) -> BoolArray:
    """(H, W) pixels that the blur replaces."""
    mask = np.zeros(shape, np.bool_)
    height, width = shape
    for x1, y1, x2, y2 in regions.xyxy_px.tolist():
        left, top = (
            int(np.clip(np.floor(edge + 0.5), 0, size))
            for edge, size in ((x1, width), (y1, height))
        )
        right, bottom = (
            int(np.clip(np.ceil(edge + 0.5), 0, size)) for edge, size in ((x2, width), (y2, height))
        )
        mask[top:bottom, left:right] = True
    return mask


def scores(
    drives: Sequence[Sequence[SeenFrame]], source: BoxSource, look_ahead: LookAhead
) -> dict[str, float]:
    """Fractions of covered pixels, and of needlessly covered ones of the image."""
    n_covered: dict[Key, int] = {}
    n_pixels: dict[Key, int] = {}
    n_needless = n_image = 0
    exposed: dict[tuple[IdentifyingPart, bool], dict[tuple[int, int], bool]] = {}
    for drive, frames in enumerate(drives):
        results = with_regions((frame.results[source] for frame in frames), look_ahead)
        for frame, (_, regions) in zip(frames, results, strict=True):
            mask = covered(regions, frame.shape)
            n_image += mask.size
            n_needless += int(mask.sum())
            for seen in frame.parts:
                n_in_mask = int(mask[seen.row, seen.column].sum())
                n_needless -= n_in_mask
                for key in _keys(seen, source):
                    n_covered[key] = n_covered.get(key, 0) + n_in_mask
                    n_pixels[key] = n_pixels.get(key, 0) + len(seen.row)
                    if key[1]:
                        objects = exposed.setdefault((key[0], key[2]), {})
                        is_exposed = n_in_mask < COVERED_FRACTION * len(seen.row)
                        objects[drive, seen.user] = (
                            objects.get((drive, seen.user), False) or is_exposed
                        )
    return {
        **{_name(key): n_covered[key] / n_pixels[key] for key in sorted(n_pixels)},
        **{
            f"{part.name.lower()}s exposed in a frame, {'tracked' if is_tracked else 'all'}": float(
                np.mean(list(objects.values()))
            )
            for (part, is_tracked), objects in sorted(exposed.items())
        },
        "needless": n_needless / n_image,
    }


def _keys(seen: SeenPart, source: BoxSource) -> Iterator[Key]:
    for is_readable in {False, seen.is_readable}:
        for is_tracked in {False, seen.is_tracked[source]}:
            yield seen.part, is_readable, is_tracked


def _name(key: Key) -> str:
    part, is_readable, is_tracked = key
    size = f" of at least {READABLE_PX[part]} px" if is_readable else ""
    return f"{part.name.lower()}s{size}, {'tracked' if is_tracked else 'all'}"
