"""Stereo networks of the user against the matchers, on real pairs with lidar on which nothing was
chosen.

KITTI-360 by default: 7 single pairs, of which 6 show 36 boxes of vehicles: 20 of a detector, and 16
projected cuboids, partly of the same vehicles. Intervals are those of resampled pairs. All matchers
measure once; their distances are then those without a correction, and those with an alignment that
the other pairs show (leaving two out at a time), of each matcher its own.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.drives import REAL_DATA
from track_range.calibration.reference_pairs import read_drive
from track_range.evaluation.network_matcher import NetworkMatcher
from track_range.evaluation.stereo_evaluation import expected_disparities
from track_range.foundation.bootstrap import CI95
from track_range.foundation.processes import one_opencv_thread
from track_range.ranging.registry import network_names
from track_range.stereo.alignment.from_reference import fit_reference
from track_range.stereo.evaluation.box_matchers import MatcherResults, measure_pairs
from track_range.stereo.evaluation.disparity_errors import (
    comparison,
    corrected,
    left_out_alignments,
    matcher_figures,
)
from track_range.stereo.geometry.alignment import Alignment

MATCHERS = ("patch", "sgbm", "sgbm-hh")
MEDIAN = "median_relative_error_pct"
SHOWN = ("n_measured", MEDIAN, MEDIAN + CI95, "p95_relative_error_pct", "failures_pct", "bias_pct")
WITHIN = ("within_1_sigma", "within_2_sigma")


@workload(
    option("--model", type=Path, nargs="+", default=[], metavar="FILE", help="stereo networks"),
    option("--pairs", default=REAL_DATA / "kitti360", help="folder with left, right, calib.txt"),
    option("--truth", default=("detected.csv", "truth.csv"), help="tables of objects in it"),
    option("--matchers", default=MATCHERS, help="matchers beside the networks"),
)
def networks(options: Namespace) -> Figures:
    files = network_names("disparity", options.model) if options.model else {}
    others = {name: NetworkMatcher(file) for name, file in files.items()}
    truth = [options.pairs / name for name in options.truth]
    with one_opencv_thread():
        measured = measure_pairs(
            read_drive(options.pairs, truth=truth),
            options.matchers,
            expected=expected_disparities,
            others=others,
        )
    ms = {name: round(value, 1) for name, value in measured.ms_per_frame.items()}
    parts = {
        "as measured": _rows(measured),
        "aligned by other pairs": _rows(measured, left_out=True),
    }
    return {"n_boxes": len(measured.objects), "ms_per_pair": ms, **parts}


def _rows(measured: MatcherResults, *, left_out: bool = False) -> dict[str, Mapping[str, Any]]:
    """Figures by matcher, and their differences from the smallest median error on common boxes."""
    objects, columns = measured.objects, {}
    for name, column in measured.columns.items():
        alignments = dict.fromkeys(range(len(objects.cameras)), Alignment())
        if left_out:
            alignments = left_out_alignments(column, objects, fit_reference)
        columns[name] = corrected(column, objects, alignments)
    compared = comparison(columns, objects)[MEDIAN]["methods"]
    return {
        name: {
            **{key: row.get(key) for key in (*SHOWN, *WITHIN)},
            **{key: compared[name].get(key) for key in ("difference", "difference_ci95")},
            "is_worse": compared[name].get("is_worse"),
        }
        for name, row in matcher_figures(columns, objects).items()
    }
