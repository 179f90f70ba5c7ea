"""Regions of an image that contain heads and number plates, from the boxes of road users.

A region is a rectangle. Its position in the box covers heads of upright people and plates of
vehicles seen from the front or rear, with tolerances for oblique views and inaccurate boxes:

    person                 upper part of the box, over its whole width
    bicycle, motorcycle    upper part, and above the box, where the rider's head is if the box contains only the vehicle
    vehicle                middle and lower part, over its whole width, since oblique views show the plate at one side

Positions and tolerances were chosen on simulated drives (`python -m benchmarks anonymization`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape

HEAD_FRACTION = 0.22  # head with neck / height of a person; 0.155 of the body, and a margin
# head region above a person's box / height: boxes of the packaged detector may begin lower
ABOVE_PERSON = 0.15
STANDING_RATIO = 2.2  # smallest height / width of a box that shows more than the upper body
RIDER_FRACTION = 0.36  # of a box of a bicycle or motorcycle, from its top: the rider's head region
# the rider's head region above the box, of the box's height
ABOVE_BICYCLE, ABOVE_MOTORCYCLE = 0.75, 0.5
PLATE_FROM, LARGE_VEHICLE_PLATE_FROM, PLATE_TO = 0.42, 0.5, 0.96  # of the box height from the top
# width / height of a car from front or rear; its sides have no plate then
FRONTAL_RATIO, FRONTAL_SIDE = 1.2, 0.12
# tolerance of the edges of a box: fraction of the smaller side, and pixels
MARGIN_FRACTION, MARGIN_PX = 0.05, 1.5
# cell / height of a person: about 3 cells over the height of a head, 2 over its width
HEAD_CELL = 0.05
# cell / height of a vehicle: at most 3 x 1 cells on a plate
PLATE_CELL, LARGE_VEHICLE_PLATE_CELL = 0.12, 0.08
MIN_CELL_PX = 8.0  # minimum cell size of the mosaic, px

_PERSON, _BICYCLE, _CAR, _MOTORCYCLE, _BUS, _TRUCK = (
    ROAD_CLASSES.index(name) for name in ("person", "bicycle", "car", "motorcycle", "bus", "truck")
)
_CYCLES, _LARGE_VEHICLES = (_BICYCLE, _MOTORCYCLE), (_BUS, _TRUCK)
_WITH_PLATE = (_CAR, _MOTORCYCLE, _BUS, _TRUCK)


@dataclass(frozen=True, slots=True)
class Boxes:
    """Boxes of road users in one image, observed, predicted or interpolated."""

    xyxy_px: FloatArray  # (N, 4) left, top, right, bottom edge; pixel centres at integers
    class_id: IntArray  # (N,) index into `detection.classes.ROAD_CLASSES`
    margin_px: FloatArray  # (N,) uncertainty of the edges beyond that of an observed box

    def __post_init__(self) -> None:
        n = len(self.class_id)
        check_shape("xyxy_px", self.xyxy_px, (n, 4))
        check_shape("margin_px", self.margin_px, (n,))

    def __len__(self) -> int:
        return len(self.class_id)

    def select(self, rows: BoolArray | IntArray) -> Boxes:
        """The boxes of the given rows."""
        return Boxes(self.xyxy_px[rows], self.class_id[rows], self.margin_px[rows])


@dataclass(frozen=True, slots=True)
class Regions:
    """Rectangles of an image to cover."""

    xyxy_px: FloatArray  # (N, 4) left, top, right, bottom edge; pixel centres at integers
    cell_px: FloatArray  # (N,) cell size of the mosaic

    def __len__(self) -> int:
        return len(self.cell_px)


def regions_of(boxes: Boxes) -> Regions:
    """Head and plate regions of boxes; boxes of other classes and boxes that are not finite have
    none.
    """
    boxes = boxes.select(np.flatnonzero(np.isfinite(boxes.xyxy_px).all(axis=1)))
    parts = (_heads(boxes), _heads_of_riders(boxes), _plates(boxes))
    return Regions(
        np.concatenate([part.xyxy_px for part in parts]),
        np.maximum(np.concatenate([part.cell_px for part in parts]), MIN_CELL_PX),
    )


def _heads(boxes: Boxes) -> Regions:
    people = boxes.select(np.flatnonzero(boxes.class_id == _PERSON))
    x1, y1, x2, y2 = people.xyxy_px.T
    height_px = np.maximum(y2 - y1, STANDING_RATIO * (x2 - x1))
    lower = np.minimum(y1 + HEAD_FRACTION * height_px, y2)
    return _widened(people, (x1, y1 - ABOVE_PERSON * height_px, x2, lower), HEAD_CELL * height_px)


def _heads_of_riders(boxes: Boxes) -> Regions:
    cycles = boxes.select(np.isin(boxes.class_id, _CYCLES))
    x1, y1, x2, y2 = cycles.xyxy_px.T
    height_px = y2 - y1
    above = np.where(cycles.class_id == _BICYCLE, ABOVE_BICYCLE, ABOVE_MOTORCYCLE)
    edges = (x1, y1 - above * height_px, x2, y1 + RIDER_FRACTION * height_px)
    return _widened(cycles, edges, HEAD_CELL * height_px * (1 + above))


def _plates(boxes: Boxes) -> Regions:
    vehicles = boxes.select(np.isin(boxes.class_id, _WITH_PLATE))
    x1, y1, x2, y2 = vehicles.xyxy_px.T
    height_px = y2 - y1
    is_large = np.isin(vehicles.class_id, _LARGE_VEHICLES)
    first = np.where(is_large, LARGE_VEHICLE_PLATE_FROM, PLATE_FROM)
    cell = np.where(is_large, LARGE_VEHICLE_PLATE_CELL, PLATE_CELL)
    is_frontal = (vehicles.class_id == _CAR) & (x2 - x1 < FRONTAL_RATIO * height_px)
    inwards_px = np.where(is_frontal, FRONTAL_SIDE, 0.0) * (x2 - x1)
    edges = (x1 + inwards_px, y1 + first * height_px, x2 - inwards_px, y1 + PLATE_TO * height_px)
    return _widened(vehicles, edges, cell * height_px)


def _widened(
    boxes: Boxes, edges: tuple[FloatArray, FloatArray, FloatArray, FloatArray], cell_px: FloatArray
) -> Regions:
    """Regions with the given edges (N,), widened by the tolerances of their boxes."""
    side_px = (boxes.xyxy_px[:, 2:] - boxes.xyxy_px[:, :2]).min(axis=1, initial=np.inf)
    margin_px = MARGIN_FRACTION * side_px + MARGIN_PX + boxes.margin_px
    signs = np.array([-1.0, -1.0, 1.0, 1.0])
    return Regions(np.stack(edges, axis=1) + margin_px[:, None] * signs, cell_px)
