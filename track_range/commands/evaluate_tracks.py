"""`track-range evaluate tracks`: HOTA, CLEAR and identity metrics of tracks against truth, by sequence and together."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rich.console import Console

from track_range.detection.classes import ROAD_CLASSES, road_class_ids, road_class_of_each
from track_range.detection.formats.kitti import LabelFileError, read_kitti
from track_range.foundation.arrays import IntArray
from track_range.foundation.errors import UsageError
from track_range.report.tables import Column, Grid, figure, grid_of
from track_range.results.output_files import write_text
from track_range.run.progress import say
from track_range.sequences.find import (
    KITTI_FOLDER,
    MOT_FOLDER,
    SequenceFile,
    find_sequences,
    first_line,
    paired,
    passed_over,
    without_truth,
)
from track_range.terminal_tables import tell_grid
from track_range.tracking.benchmark_rules import KITTI_TYPES, kitti_cleaned, mot_cleaned
from track_range.tracking.evaluation import TrackingCounts
from track_range.tracking.mot_format import read_mot
from track_range.tracking.motmetrics_comparison import REASONS, MotmetricsFigures, motmetrics_figures
from track_range.tracking.similarity import Similarity
from track_range.tracking.tracked_boxes import TrackedBoxes

TruthFormat = Literal["mot", "kitti"]
Comparison = Literal["motmetrics"]
"""Another package that evaluates the same boxes."""

_COUNTS = ("idsw", "fp", "fn", "frag", "mt", "pt", "ml", "n")
_HEADS = "HOTA DetA AssA LocA MOTA MOTP IDF1 IDsw FP FN Frag MT ML".split()


def evaluate_track_files(
    truth: Path,
    results: Path,
    *,
    truth_format: TruthFormat | None,
    road_class: str | None,
    console: Console,
    compare: Comparison | None = None,
) -> dict[str, Any]:
    """Figures of all sequences, as `--json` keeps them, printed as a table.

    Args:
        truth: a file, or a folder of sequences (see `track_range.sequences.find`).
        results: the same; MOT or KITTI rows, or what `track-range track` wrote.
        truth_format: of the truth; None = told by its first line.
        road_class: which KITTI class; MOTChallenge's is person. None = car for KITTI.
        console: where to print.
        compare: also print this package's figures, and what differs; JSON keeps them under its name.

    Raises:
        LabelFileError, MotFormatError: files cannot be read, or results of a sequence are missing.
        UsageError, ClassNameError: a class that cannot be evaluated.
    """
    wanted = find_sequences(truth, "gt")
    form: TruthFormat = truth_format or ("mot" if "," in first_line(wanted[0].path) else "kitti")
    # what `track` wrote: KITTI's rows name classes, which KITTI's truth asks for
    folders = [results / name for name in ((KITTI_FOLDER, MOT_FOLDER) if form == "kitti" else (MOT_FOLDER,))]
    place = next((each for each in folders if each.is_dir()), results)
    got = find_sequences(place, "det")
    pairs, name = paired(wanted, got), _class_of(form, road_class)
    notes = (*passed_over(truth, wanted), *passed_over(place, got), *without_truth(wanted, got))
    similarity = {of.name: Similarity.of(*_cleaned(of, tracks, form, name)) for of, tracks in pairs}
    counts = {key: TrackingCounts.of_similarity(each) for key, each in similarity.items()}
    combined = TrackingCounts.sum_of(list(counts.values()))
    figures: dict[str, Any] = {
        "truth": str(truth),
        "results": str(results),
        "format": form,
        "class": name,
        "combined": _without_nan(asdict(combined.scores())),
        "sequences": {key: _without_nan(asdict(each.scores())) for key, each in counts.items()},
        "notes": list(notes),
    }
    for note in notes:
        say(console, f"- {note}")
    tell_grid(console, _grid(figures))
    if compare == "motmetrics":
        _compare_motmetrics(figures, motmetrics_figures(similarity), console)
    return figures


def keep_track_figures(figures: Mapping[str, Any], path: Path | None) -> None:
    """Write the figures as JSON, where asked.

    Raises:
        OutputError: it cannot be written.
    """
    if path is not None:
        write_text(path, json.dumps(figures, indent=2, allow_nan=False) + "\n")


def _class_of(form: TruthFormat, road_class: str | None) -> str:
    if road_class is None:
        return "car" if form == "kitti" else "person"
    name = ROAD_CLASSES[int(road_class_ids([road_class])[0])]
    if form == "mot" and name != "person":
        raise UsageError(f"--class {road_class}: MOTChallenge's truth is of persons only.")
    if form == "kitti" and name not in KITTI_TYPES:
        raise UsageError(f"--class {road_class}: KITTI's tracking truth is of {', '.join(KITTI_TYPES)}.")
    return name


def _compare_motmetrics(figures: dict[str, Any], theirs: MotmetricsFigures, console: Console) -> None:
    """Print and keep motmetrics' figures beside ours, and why some differ."""
    figures["motmetrics"] = {
        "combined": _without_nan(theirs.combined),
        "sequences": {key: _without_nan(row) for key, row in theirs.sequences.items()},
    }
    rows: dict[str, Mapping[str, Any]] = {
        "track-range": figures["combined"],
        "motmetrics": figures["motmetrics"]["combined"],
    }
    heads = [head for head in _HEADS if head.lower() in REASONS]
    compared = {head: [figure(row, head.lower()) for row in rows.values()] for head in heads}
    columns = [Column(head, values, _pattern(head.lower())) for head, values in compared.items()]
    tell_grid(console, grid_of("The same boxes evaluated with motmetrics", "", list(rows), columns))
    differing: dict[str, list[str]] = {}
    for head, (ours, other) in compared.items():
        if not _is_same(ours, other):
            differing.setdefault(REASONS[head.lower()], []).append(head)
    for reason, differing_heads in differing.items():
        say(console, f"- {', '.join(differing_heads)}: {reason}.")
    if not differing:
        say(console, "- All figures agree.")


def _cleaned(
    truth: SequenceFile, results: SequenceFile, form: TruthFormat, road_class: str
) -> tuple[TrackedBoxes, TrackedBoxes]:
    """Truth and results of one sequence that count by the benchmark's rules."""
    if form == "mot":
        wanted = read_mot(truth.path)
        _check_once(truth.path, wanted.frame, wanted.track_id)
        return mot_cleaned(wanted, _read_results(results.path, road_class))
    labels = read_kitti(truth.path)
    named = labels.track_id >= 0
    _check_once(truth.path, labels.frame[named], labels.track_id[named])
    return kitti_cleaned(labels, _read_results(results.path, road_class), road_class)


def _read_results(path: Path, road_class: str) -> TrackedBoxes:
    """Tracks of one class, frames from 0, from MOT rows (no class, frames from 1) or KITTI rows (frames from 0)."""
    class_id = ROAD_CLASSES.index(road_class)
    first = first_line(path)
    if not first:
        return _tracked(path, np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 4)), class_id)
    if "," in first:
        rows = read_mot(path)
        return _tracked(path, rows.frame, rows.track_id, rows.xyxy_px, class_id)
    labels = read_kitti(path)
    mine = road_class_of_each([str(kind) for kind in labels.kitti_type]) == class_id
    labels = labels.select(mine & (labels.track_id >= 0))
    return _tracked(path, labels.frame, labels.track_id, labels.xyxy_px, class_id)


def _check_once(path: Path, frame: IntArray, track_id: IntArray) -> None:
    if len(np.unique(np.stack([frame, track_id]), axis=1).T) < len(frame):
        raise LabelFileError(f"{path}: an identity is there twice in one frame.")


def _tracked(path: Path, frame: IntArray, track_id: IntArray, xyxy_px: Any, class_id: int) -> TrackedBoxes:
    try:
        return TrackedBoxes(frame, track_id, xyxy_px, np.full(len(frame), class_id))
    except ValueError as error:
        raise LabelFileError(f"{path}: an identity is there twice in one frame.") from error


def _is_same(ours: float | None, theirs: float | None) -> bool:
    return ours == theirs if ours is None or theirs is None else math.isclose(ours, theirs, abs_tol=1e-6)


def _without_nan(figures: Mapping[str, float]) -> dict[str, float | int | None]:
    """For JSON: counts as whole numbers, None for NaN."""
    return {
        key: None if math.isnan(value) else int(value) if key in _COUNTS else float(value)
        for key, value in figures.items()
    }


def _grid(figures: Mapping[str, Any]) -> Grid:
    rows: Mapping[str, Mapping[str, Any]] = {**figures["sequences"], "together": figures["combined"]}
    if len(figures["sequences"]) == 1:
        rows = figures["sequences"]
    names: Sequence[str] = list(rows)
    columns = [
        Column(head, [figure(row, head.lower()) for row in rows.values()], _pattern(head.lower())) for head in _HEADS
    ]
    return grid_of(f"Tracks of class {figures['class']}", "sequence", names, columns)


def _pattern(key: str) -> str:
    return "{:.0f}" if key in _COUNTS else "{:.1f}"
