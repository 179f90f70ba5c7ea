"""Lane finders: what a look costs, how right they are on simulated drives, how far they agree on real videos.

Looks ten times a second, as a run looks, one thread; processor time, the median over looks at simulated drives. Where
the lines are is compared in six rows, at 0.62 to 0.92 of the image's height (about 20 to 7 m ahead), and averaged over
them: the lane's width against the truth's, and how far the worse of the two lines is from the true one, in true widths.
Medians and 90 % over looks; a line that is off by more than 20 % of the width is another lane's, or none. Truth is the
lane's own edge, the middle between two lines painted side by side: a finder that takes one of the two is wrong by 3 %.
Real videos have no truth: the same comparison between finders.
"""

from __future__ import annotations

import time
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console

from benchmarks.inputs.drives import REAL_DATA
from benchmarks.inputs.simulated_drives import SimulatedDrive
from benchmarks.plain_tables import figure_text, plain_table
from track_range.detection.lanes.lines import LaneLines
from track_range.detection.lanes.nets import CLASSICAL, open_lane_finder
from track_range.detection.models.onnx_session import Runtime
from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.world.scenarios import SCENARIOS as KNOWN
from track_range.video.reader import VideoReader

SCENARIOS = ("town", "highway", "city", "cut-in", "queue")
SEEDS = (201, 202)
ROWS = np.linspace(0.62, 0.92, 6)
OTHER_LANE = 0.2
STEP_S = 0.09
NETS = tuple(REAL_DATA / "models" / name for name in ("twinlitenet_360x640.onnx", "lstr_tusimple_360x640.onnx"))


def add_options(parser: ArgumentParser) -> None:
    """Options of the workload."""
    parser.add_argument("--net", type=Path, nargs="*", default=NETS, metavar="FILE", help="beside the edges")
    parser.add_argument("--scenarios", nargs="*", default=SCENARIOS, choices=list(KNOWN), metavar="NAME")
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS, metavar="N")
    parser.add_argument("--seconds", type=float, default=5.0, help="of each simulated drive")
    videos = [*(REAL_DATA / "kitti_stereo" / name / "left.mp4" for name in ("0003", "0005"))]
    videos += sorted((REAL_DATA / "dashcam").glob("*.mp4"))
    parser.add_argument("--videos", type=Path, nargs="*", default=videos, metavar="FILE", help="real ones")


def measure(options: Namespace) -> dict[str, Any]:
    """Run all finders over all of it, print the tables, and return their figures."""
    cv2.setNumThreads(1)
    words = [CLASSICAL, *map(str, _present(options.net, "networks"))]
    by_scenario = {name: _simulated(name, words, options) for name in options.scenarios}
    simulated = {}
    for word in words if by_scenario else ():
        every = [look for looked in by_scenario.values() for look in looked[word]]
        each = {name: _errors(looked[word]) for name, looked in by_scenario.items()}
        simulated[_name(word)] = {"all": _errors(every)} | each
    real = {_title(video): _agreement(video, words) for video in _present(options.videos, "videos")}
    if simulated:
        _tell_simulated(simulated)
    if real:
        _tell_real(real)
    return {"simulated": simulated, "real": real}


def _present(paths: Sequence[Path], what: str) -> list[Path]:
    missing = [path.name for path in paths if not path.is_file()]
    if missing or not paths:
        print(f"{what} left out, as there are none here: {', '.join(missing) or 'none given'}")
    return [path for path in paths if path.is_file()]


def _name(word: str) -> str:
    return "edges" if word == CLASSICAL else Path(word).stem.split("_")[0]


def _title(video: Path) -> str:
    return video.parent.name if video.stem == "left" else video.stem


@dataclass(frozen=True, slots=True)
class _Look:
    """One look at one image: columns (2, K) of the lines found and of the true ones (NaN = unknown), and its cost."""

    found_px: FloatArray
    true_px: FloatArray
    ms: float


def _looks(word: str, images: Sequence[Image], times_s: Sequence[float], true_px: FloatArray | None) -> list[_Look]:
    finder = open_lane_finder(word, Runtime(n_threads=1, device="cpu"))
    nothing = np.full((2, len(ROWS)), np.nan)
    looks = []
    for number, (image, time_s) in enumerate(zip(images, times_s, strict=True)):
        began_s = time.process_time()
        lines = finder.find(image, time_s)
        ms = 1e3 * (time.process_time() - began_s)
        looks.append(_Look(_columns_px(lines, len(image)), nothing if true_px is None else true_px[number], ms))
    return looks


def _columns_px(lines: LaneLines, height_px: int) -> FloatArray:
    """(2, K) of both lines, NaN unless both were found."""
    if lines.left is None or lines.right is None:
        return np.full((2, len(ROWS)), np.nan)
    return np.stack([lines.left.x_px(ROWS * height_px), lines.right.x_px(ROWS * height_px)])


def _simulated(scenario: str, words: Sequence[str], options: Namespace) -> dict[str, list[_Look]]:
    looks: dict[str, list[_Look]] = {word: [] for word in words}
    for seed in options.seeds:
        drive = SimulatedDrive.of(scenario, seed=seed, seconds=options.seconds)
        images, true_px = drive.left_images(), drive.lane_px(ROWS * drive.renderer.rig.left.height_px)
        for word in words:
            looks[word] += _looks(word, images, drive.times_s.tolist(), true_px)
    return looks


def _errors(looks: Sequence[_Look]) -> dict[str, float | int | None]:
    found, true = np.array([look.found_px for look in looks]), np.array([look.true_px for look in looks])
    return {
        "looks": len(looks),
        "ms": round(float(np.median([look.ms for look in looks])), 2),
        "both_lines": round(float(np.isfinite(found).all(axis=(1, 2)).mean()), 3),
        **_differences(found, true),
    }


def _differences(found_px: FloatArray, wanted_px: FloatArray) -> dict[str, float | int | None]:
    """Of lines (F, 2, K) from others, over the frames where both are known in all rows."""
    both = np.isfinite(found_px).all(axis=(1, 2)) & np.isfinite(wanted_px).all(axis=(1, 2))
    found_px, wanted_px = found_px[both], wanted_px[both]
    true_px = wanted_px[:, 1] - wanted_px[:, 0]
    width = np.abs((found_px[:, 1] - found_px[:, 0]) / true_px - 1).mean(axis=1)
    aside = (np.abs(found_px - wanted_px).max(axis=1) / true_px).mean(axis=1)
    known = len(width) > 0
    return {
        "compared": len(width),
        "width_median_pct": _pct(np.median(width)) if known else None,
        "width_90_pct": _pct(np.quantile(width, 0.9)) if known else None,
        "line_median_pct": _pct(np.median(aside)) if known else None,
        "other_lane": round(float((aside > OTHER_LANE).mean()), 3) if known else None,
    }


def _pct(share: np.floating[Any]) -> float:
    return round(100 * float(share), 2)


def _agreement(video: Path, words: Sequence[str]) -> dict[str, Any]:
    """Share of looks with both lines per finder, and how each two of them differ."""
    images, times_s = zip(*_ten_a_second(video), strict=True)
    found = {_name(word): np.array([look.found_px for look in _looks(word, images, times_s, None)]) for word in words}
    both = {name: round(float(np.isfinite(px).all(axis=(1, 2)).mean()), 3) for name, px in found.items()}
    pairs = {f"{one} - {other}": _differences(found[one], found[other]) for one, other in combinations(found, 2)}
    return {"looks": len(images), "both_lines": both, "pairs": pairs}


def _ten_a_second(video: Path) -> Iterator[tuple[Image, float]]:
    due_s = -np.inf
    for frame in VideoReader(video):
        if frame.time_s >= due_s:
            yield frame.image, frame.time_s
            due_s = frame.time_s + STEP_S


def _tell_simulated(figures: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> None:
    headings = ("finder", "drives", "looks", "ms", "both %", "width %", "90 %", "line %", "other lane %")
    table = plain_table("simulated drives, against the truth", *headings, n_words=2)
    for finder, each in figures.items():
        for name, row in each.items():
            errors = (figure_text(row[key]) for key in ("width_median_pct", "width_90_pct", "line_median_pct"))
            both, other = (figure_text(row[key], digits=0, times=100) for key in ("both_lines", "other_lane"))
            table.add_row(finder, name, str(row["looks"]), figure_text(row["ms"], digits=1), both, *errors, other)
    Console().print(table)


def _tell_real(figures: Mapping[str, Mapping[str, Any]]) -> None:
    finders = next(iter(figures.values()))["both_lines"]
    table = plain_table("real videos: both lines, %", "video", "looks", *finders)
    headings = ("video", "finders", "looks", "width %", "90 %", "other lane %")
    pairs = plain_table("how far two finders differ", *headings, n_words=2)
    for video, row in figures.items():
        shares = (figure_text(share, digits=0, times=100) for share in row["both_lines"].values())
        table.add_row(video, str(row["looks"]), *shares)
        for name, pair in row["pairs"].items():
            errors = (figure_text(pair[key]) for key in ("width_median_pct", "width_90_pct"))
            other = figure_text(pair["other_lane"], digits=0, times=100)
            pairs.add_row(video, name, str(pair["compared"]), *errors, other)
    Console().print(table, pairs)
