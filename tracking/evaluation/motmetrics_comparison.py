"""Scores of the package motmetrics for the same boxes, and why some differ from `evaluation.clear`.

Both use the boxes that count under the benchmark's rules (`benchmark_rules`), and match at an IoU
of at least 0.5. `clear` agrees with TrackEval, as published by KITTI and MOTChallenge; motmetrics
follows Bernardin and Stiefelhagen, 2008.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from track_range.tracking.evaluation.clear import MIN_IOU
from track_range.tracking.evaluation.tracked_boxes import Similarity

# motmetrics' names of the fields of `TrackingScores`, where it has them
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
# in per cent in `TrackingScores`, fractions in motmetrics
_RATIOS = ("mota", "motp", "idf1", "idp", "idr")

_MATCHING = (
    "different pairs are matched: motmetrics prefers the last match of each truth track, however "
    "old; track-range prefers a match in the previous frame only, as TrackEval does"
)

_EIGHTY_PER_CENT = (
    "a truth track matched in exactly 80 % of its frames counts as mostly tracked in motmetrics "
    "only; different pairs may be matched, see IDsw"
)
REASONS: Mapping[str, str] = {  # why motmetrics' score may differ, by field of `TrackingScores`
    "mota": "a consequence of the differences in IDsw, FP and FN",
    "motp": _MATCHING,
    "idf1": "the definitions agree",
    "idp": "the definitions agree",
    "idr": "the definitions agree",
    "idsw": _MATCHING,
    "fp": _MATCHING,
    "fn": _MATCHING,
    "frag": (
        "only track-range counts a fragmentation if a track is matched again after frames without "
        "a truth box, and only motmetrics if it is unmatched in frames without results; different "
        "pairs may be matched, see IDsw"
    ),
    "mt": _EIGHTY_PER_CENT,
    "pt": _EIGHTY_PER_CENT,
    "ml": _MATCHING,
}


@dataclass(frozen=True, slots=True)
class MotmetricsFigures:
    """motmetrics' scores by their names in `TrackingScores`: ratios in per cent, NaN where the
    denominator is 0.
    """

    combined: Mapping[str, float]  # scores of all sequences combined
    sequences: Mapping[str, Mapping[str, float]]  # scores of each sequence, by name


def motmetrics_figures(sequences: Mapping[str, Similarity]) -> MotmetricsFigures:
    """Scores of one or more sequences, computed by motmetrics."""
    import motmetrics  # takes most of a second, since it imports pandas

    accumulators = []
    for similarity in sequences.values():
        accumulator = motmetrics.MOTAccumulator()
        for frame, (truth, results, iou) in enumerate(similarity.by_frame):
            # NaN forbids a match.
            distance = np.where(iou >= MIN_IOU - np.finfo(np.float64).eps, 1.0 - iou, np.nan)
            accumulator.update(truth, results, distance, frameid=frame)
        accumulators.append(accumulator)
    table = motmetrics.metrics.create().compute_many(
        accumulators,
        names=list(range(len(accumulators))),
        metrics=[*_METRICS.values(), "num_detections"],
        generate_overall=True,
    )
    # The mean distance over all matches; motmetrics' own is NaN where one sequence has no match.
    n_matches, mean_distance = (
        table["num_detections"].to_numpy()[:-1],
        table["motp"].to_numpy()[:-1],
    )
    table.loc[table.index[-1], "motp"] = (
        np.nansum(n_matches * mean_distance) / n_matches.sum() if n_matches.any() else np.nan
    )
    *rows, combined = (_figures(dict(row)) for _, row in table.iterrows())
    return MotmetricsFigures(combined, dict(zip(sequences, rows, strict=True)))


def _figures(row: Mapping[str, float]) -> dict[str, float]:
    figures = {
        name: float(row[metric]) * (100.0 if name in _RATIOS else 1.0)
        for name, metric in _METRICS.items()
    }
    figures["motp"] = 100.0 - figures["motp"]  # motmetrics gives the mean of 1 - IoU
    return figures
