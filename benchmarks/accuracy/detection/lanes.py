"""Lane detection: time per image and accuracy on simulated drives.

The true line is the edge of the lane, which is the middle of a double line: a detector of one of
its two lines has an error of 3 %.
"""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.boxes.true_boxes import true_boxes
from benchmarks.harness import Figures, median_or_none, option, quantile_or_none, workload
from benchmarks.inputs.drives import REAL_DATA, SimulatedDrive
from track_range.detection.lanes.lines import LaneLines
from track_range.detection.lanes.nets import CLASSICAL, open_lane_finder
from track_range.detection.models.onnx_session import Runtime
from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.world.scenarios import SCENARIOS as ALL_SCENARIOS

SCENARIOS = ("town", "highway", "city", "cut-in", "queue")
SEEDS = (201, 202)
# (K,) rows in which lines are compared, as fractions of the image height
ROWS = np.linspace(0.62, 0.92, 6)
OTHER_LANE = 0.2  # error of a line, in lane widths, above which it belongs to another lane

NETS = tuple(
    REAL_DATA / "models" / name
    for name in ("twinlitenet_360x640.onnx", "lstr_tusimple_360x640.onnx")
)
"""Default lane networks."""


@workload(
    option(
        "--net", default=NETS, nargs="*", metavar="FILE", help="lane networks, in addition to edges"
    ),
    option(
        "--scenarios",
        default=SCENARIOS,
        nargs="*",
        choices=tuple(ALL_SCENARIOS),
        metavar="NAME",
        help="scenarios",
    ),
    option("--seeds", default=SEEDS, metavar="N", help="random seeds of the drives"),
    option("--seconds", default=5.0, help="length of a simulated drive"),
)
def lanes(options: Namespace) -> Figures:
    cv2.setNumThreads(1)
    finders = [CLASSICAL, *map(str, _available(options.net, "networks"))]
    by_scenario = {name: _simulated(name, finders, options) for name in options.scenarios}
    simulated: Figures = {}
    for finder in finders if by_scenario else ():
        samples = [sample for by_finder in by_scenario.values() for sample in by_finder[finder]]
        errors = {name: _errors(by_finder[finder]) for name, by_finder in by_scenario.items()}
        simulated[_name(finder)] = {"all": _errors(samples)} | errors
    return {"simulated": simulated}


def _available(paths: Sequence[Path], what: str) -> list[Path]:
    """The paths that exist; prints the others."""
    missing = [path.name for path in paths if not path.is_file()]
    if missing or not paths:
        print(f"{what} not available: {', '.join(missing) or 'none given'}")
    return [path for path in paths if path.is_file()]


def _name(finder: str) -> str:
    return "edges" if finder == CLASSICAL else Path(finder).stem.split("_")[0]


@dataclass(frozen=True, slots=True)
class _Sample:
    """Columns (2, K) of lines in `ROWS`, detected (NaN = not both) and true (NaN = not known), and
    processor time.
    """

    detected_px: FloatArray
    true_px: FloatArray
    ms: float


def _samples(
    finder_name: str, drive: SimulatedDrive, images: Sequence[Image], true_px: FloatArray
) -> list[_Sample]:
    """Lines detected in the images of a drive between its true boxes; `true_px` (F, 2, K) are the
    true lines.
    """
    boxes = true_boxes(drive.renderer.scene, drive.times_s, drive.renderer.rig.left)
    finder = open_lane_finder(finder_name, Runtime(n_threads=1, device="cpu"))
    samples = []
    for number, (image, time_s) in enumerate(zip(images, drive.times_s.tolist(), strict=True)):
        start_s = time.process_time()
        lines = finder.find(image, time_s, boxes.xyxy_px[boxes.frame == number])
        ms = 1e3 * (time.process_time() - start_s)
        samples.append(_Sample(_columns_px(lines, len(image)), true_px[number], ms))
    return samples


def _columns_px(lines: LaneLines, height_px: int) -> FloatArray:
    """(2, K) columns of both lines in `ROWS`; NaN unless both were detected."""
    if lines.left is None or lines.right is None:
        return np.full((2, len(ROWS)), np.nan)
    return np.stack([lines.left.x_px(ROWS * height_px), lines.right.x_px(ROWS * height_px)])


def _simulated(
    scenario: str, finders: Sequence[str], options: Namespace
) -> dict[str, list[_Sample]]:
    samples: dict[str, list[_Sample]] = {finder: [] for finder in finders}
    for seed in options.seeds:
        drive = SimulatedDrive.of(scenario, seed=seed, seconds=options.seconds)
        images, true_px = (
            drive.left_images(),
            drive.lane_px(ROWS * drive.renderer.rig.left.height_px),
        )
        for finder in finders:
            samples[finder] += _samples(finder, drive, images, true_px)
    return samples


def _errors(samples: Sequence[_Sample]) -> Figures:
    detected = np.array([sample.detected_px for sample in samples])
    true = np.array([sample.true_px for sample in samples])
    return {
        "images": len(samples),
        "ms": round(float(np.median([sample.ms for sample in samples])), 2),
        "both_lines": round(float(np.isfinite(detected).all(axis=(1, 2)).mean()), 3),
        **_differences(detected, true),
    }


def _differences(detected_px: FloatArray, reference_px: FloatArray) -> Figures:
    """Differences of lines (F, 2, K) from reference lines, over the images with both of them in all
    rows.
    """
    both = np.isfinite(detected_px).all(axis=(1, 2)) & np.isfinite(reference_px).all(axis=(1, 2))
    detected_px, reference_px = detected_px[both], reference_px[both]
    width_px = reference_px[:, 1] - reference_px[:, 0]
    width_error = np.abs((detected_px[:, 1] - detected_px[:, 0]) / width_px - 1).mean(axis=1)
    line_error = (np.abs(detected_px - reference_px).max(axis=1) / width_px).mean(axis=1)
    return {
        "compared": len(width_error),
        "width_median_pct": median_or_none(width_error, 100),
        "width_90_pct": quantile_or_none(width_error, 0.9, 100),
        "line_median_pct": median_or_none(line_error, 100),
        "other_lane": float((line_error > OTHER_LANE).mean()) if len(line_error) else None,
    }
