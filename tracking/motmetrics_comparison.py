"""Figures of the package motmetrics for the same boxes, and why some differ from those of `track_range.tracking.clear`.

Both use the boxes that the benchmark's rules leave (`benchmark_rules`), and match at an IoU of at least 0.5. Those of
`clear` are TrackEval's, which KITTI and MOTChallenge publish; motmetrics follows Bernardin and Stiefelhagen, 2008.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.tracking.clear import MIN_IOU
from track_range.tracking.similarity import Similarity

_METRICS: Mapping[str, str] = {
    "mota": "mota",
    "motp": "motp",
    "idf1": "idf1",
    "idp": "idp",
    "idr": "idr",
    "idsw": "num_switches",
    "fp": "num_false_positives",
    "fn": "num_misses",
    "frag": "num_fragmentations",
    "mt": "mostly_tracked",
    "pt": "partially_tracked",
    "ml": "mostly_lost",
}
"""motmetrics' name of each figure of `TrackingScores` that it has."""

_RATIOS = ("mota", "motp", "idf1", "idp", "idr")

_MATCHING = (
    "other pairs are matched: motmetrics first repeats the last match of each truth track, however long ago it was; "
    "here only a match in the frame before is preferred, as in TrackEval"
)

_EIGHTY_PER_CENT = (
    "a truth track matched in exactly 80 % of its frames is mostly tracked in motmetrics, not here; and other pairs "
    "may be matched, see IDsw"
)

REASONS: Mapping[str, str] = {
    "mota": "follows from IDsw, FP and FN",
    "motp": _MATCHING,
    "idf1": "the definitions agree",
    "idp": "the definitions agree",
    "idr": "the definitions agree",
    "idsw": _MATCHING,
    "fp": _MATCHING,
    "fn": _MATCHING,
    "frag": (
        "a truth track that is found again after frames without its truth box is a fragment here, not in motmetrics; "
        "one missed in frames without any result is a fragment in motmetrics, not here; and other pairs may be "
        "matched, see IDsw"
    ),
    "mt": _EIGHTY_PER_CENT,
    "pt": _EIGHTY_PER_CENT,
    "ml": _MATCHING,
}
"""Why motmetrics' figure may differ from ours, by figure."""


@dataclass(frozen=True, slots=True)
class MotmetricsFigures:
    """motmetrics' figures by their names in `TrackingScores`: ratios in per cent, NaN where nothing is divided by.

    Attributes:
        combined: of all sequences together.
        sequences: of each.
    """

    combined: Mapping[str, float]
    sequences: Mapping[str, Mapping[str, float]]


def motmetrics_figures(sequences: Mapping[str, Similarity]) -> MotmetricsFigures:
    """Evaluate sequences, at least one, with motmetrics."""
    import motmetrics  # takes most of a second, since it imports pandas

    accumulators = []
    for similarity in sequences.values():
        accumulator = motmetrics.MOTAccumulator()
        for frame, (truth, results, iou) in enumerate(similarity.frames()):
            accumulator.update(truth, results, _distance(iou), frameid=frame)
        accumulators.append(accumulator)
    table = motmetrics.metrics.create().compute_many(
        accumulators,
        names=list(range(len(accumulators))),
        metrics=[*_METRICS.values(), "num_detections"],
        generate_overall=True,
    )
    # The mean distance over all matches; motmetrics' own is NaN where one sequence has no match.
    n_matches, distance = table["num_detections"].to_numpy()[:-1], table["motp"].to_numpy()[:-1]
    table.loc[table.index[-1], "motp"] = (
        np.nansum(n_matches * distance) / n_matches.sum() if n_matches.any() else np.nan
    )
    *rows, combined = (_figures(dict(row)) for _, row in table.iterrows())
    return MotmetricsFigures(combined, dict(zip(sequences, rows, strict=True)))


def _distance(iou: FloatArray) -> FloatArray:
    """(n, m) 1 - IoU; NaN forbids a match."""
    return np.where(iou >= MIN_IOU - np.finfo(np.float64).eps, 1.0 - iou, np.nan)


def _figures(row: Mapping[str, float]) -> dict[str, float]:
    figures = {name: float(row[theirs]) * (100.0 if name in _RATIOS else 1.0) for name, theirs in _METRICS.items()}
    figures["motp"] = 100.0 - figures["motp"]  # theirs is the mean distance
    return figures
