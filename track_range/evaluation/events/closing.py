"""Errors of the closing speeds by class, with tall vehicles separately."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASS_OF
from track_range.evaluation.events.objects import LabelledBoxes
from track_range.ranging.evaluation.errors import match_truth, score_closing
from track_range.ranging.evaluation.truth import Truth
from track_range.results.columns import Columns, boxes_px

NEAREST_M, FARTHEST_M = 10.0, 40.0
"""True distances at which closing speeds are scored, m: nearer, boxes are cut; farther, warnings hardly use them."""

TALL = "tall vehicles"  # section of buses, trucks and vans, whose rear is far behind their tallest visible edge

_TALL_CLASSES = ("bus", "truck", "van")


def closing_errors(columns: Columns, boxes: LabelledBoxes, vans: Collection[int] = ()) -> dict[str, Any]:
    """Errors of the closing speeds of a run by class of the label, and of tall vehicles; figures as `score_closing`.

    `vans` are numbers of objects that are vans, for labels with the class car.
    """
    in_range = (boxes.distance_m >= NEAREST_M) & (boxes.distance_m <= FARTHEST_M) & np.isfinite(boxes.closing_mps)
    if not in_range.any():
        return {}
    truth = Truth(
        frame=boxes.frame,
        track_id=boxes.object_id,
        kitti_type=boxes.class_name,
        class_id=np.zeros(len(boxes.frame), np.int64),
        xyxy_px=boxes.xyxy_px,
        distance_m=boxes.distance_m,
        closing_mps=boxes.closing_mps,
    )
    rows = match_truth(columns["frame"].astype(np.int64), boxes_px(columns), truth)
    true_mps = np.where((rows >= 0) & in_range[rows], boxes.closing_mps[rows], np.nan)
    is_tall = np.isin(boxes.class_name, _TALL_CLASSES) | np.isin(boxes.object_id, list(vans))
    classes = np.array([ROAD_CLASS_OF.get(str(name), str(name)) for name in boxes.class_name], np.str_)
    sections = {}
    for name, chosen in [*((name, classes == name) for name in np.unique(classes[in_range])), (TALL, is_tall)]:
        class_mps = np.where((rows >= 0) & chosen[rows], true_mps, np.nan)
        score = score_closing(columns["closing_mps"], columns["closing_sigma_mps"], class_mps)
        if score is not None:
            sections[str(name)] = score
    return sections
