"""HOTA, CLEAR and identity metrics of tracks against ground truth, per sequence and combined."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.classes import (
    KITTI_IGNORED,
    ROAD_CLASSES,
    map_to_road_classes,
    road_class_id,
)
from track_range.detection.formats.label_formats import is_blank, label_format_of, read_labels
from track_range.detection.formats.tables.box_table import NO_FACTS, BoxTable
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.table_checks import names_with_counts, other_labels_note
from track_range.detection.formats.video_labels.kitti import read_kitti
from track_range.detection.formats.video_labels.mot import MOT_CLASSES, read_mot
from track_range.evaluation.sequences import find
from track_range.evaluation.sequences.settings import TrackEvaluationSettings, truth_formats
from track_range.foundation.arrays import IntArray
from track_range.foundation.bootstrap import CI95, Resamples, interval
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import counted, real_path
from track_range.tracking.evaluation.benchmark_rules import (
    KITTI_RULE,
    KITTI_TYPES,
    MOT_RULE,
    kitti_cleaned,
    mot_cleaned,
    of_kitti_type,
)
from track_range.tracking.evaluation.frame_shift import frame_shift_note
from track_range.tracking.evaluation.motmetrics_comparison import motmetrics_figures
from track_range.tracking.evaluation.scores import TrackingCounts
from track_range.tracking.evaluation.tracked_boxes import Similarity, TrackedBoxes

_DUPLICATE = "expected each track id at most once per frame, found a duplicate."

_RULES = {"kitti": KITTI_RULE, "mot": MOT_RULE}
_NO_RULE = "all labels and tracks of the class count"

# metrics that are counts; the others are in per cent
COUNTS = ("idsw", "fp", "fn", "frag", "mt", "pt", "ml", "n")


def evaluate_tracks(settings: TrackEvaluationSettings) -> dict[str, Any]:
    """Metrics per sequence and of all sequences combined, as plain values for JSON; MOT metrics in
    per cent.

    Raises LabelFileError, MotFormatError: a file cannot be read, or the results of a sequence are
    missing. Raises UsageError, ClassNameError: the class cannot be evaluated.
    """
    truth, results = settings.truth, settings.results
    labelled = find.find_sequences(truth, "gt")
    form = settings.truth_format or _form_of(labelled[0].path)
    results_folder = _folder_of_results(results, form)
    tracked = find.find_sequences(results_folder, "det")
    pairs = find.paired(labelled, tracked)
    is_challenge = form == "mot" and all(_is_mot_challenge(labels.path) for labels in labelled)
    has_rules = form == "kitti" or is_challenge
    if has_rules:
        notes: list[str] = []
        name = _class_of(form, settings.road_class, [labels.path for labels, _ in pairs])
        boxes = {labels.name: _cleaned(labels, tracks, form, name) for labels, tracks in pairs}
    else:
        name, boxes, notes = _boxes_of_tables(settings, pairs, form)
    if not any(len(tracked_boxes) for _, tracked_boxes in boxes.values()):
        notes += _other_classes_note([tracks.path for _, tracks in pairs], name)
    for key, (true, tracks) in boxes.items():
        notes += frame_shift_note(key, true.frame, true.xyxy_px, tracks.frame, tracks.xyxy_px)
    similarity = {key: Similarity.of(*both) for key, both in boxes.items()}
    counts = {key: TrackingCounts.of_similarity(value) for key, value in similarity.items()}
    combined = TrackingCounts.sum_of(list(counts.values()))
    figures = {
        "truth": str(truth),
        "results": str(results),
        "format": form,
        "class": name,
        "rule": _RULES[form] if has_rules else _NO_RULE,
        "combined": {
            **_without_nan(asdict(combined.scores())),
            **_intervals(list(counts.values()), settings.seed),
        },
        "sequences": {key: _without_nan(asdict(value.scores())) for key, value in counts.items()},
        "notes": [
            *find.ignored_files_note(truth, labelled),
            *find.ignored_files_note(results_folder, tracked),
            *find.no_truth_note(labelled, tracked),
            *_empty_notes([labels for labels, _ in pairs]),
            *notes,
        ],
    }
    if settings.compare == "motmetrics":
        reference = motmetrics_figures(similarity)
        figures["motmetrics"] = {
            "combined": _without_nan(reference.combined),
            "sequences": {key: _without_nan(row) for key, row in reference.sequences.items()},
        }
    return figures


def _intervals(counts: Sequence[TrackingCounts], seed: int) -> dict[str, list[float]]:
    """95 % intervals of the combined metrics that are no counts, `NAME_ci95`, by resampling the
    sequences; none of fewer than two.
    """
    sequences = np.arange(len(counts))
    resamples = Resamples.of(sequences, seed=seed, rows=sequences >= 0)
    scores = []
    for times in resamples.counts.astype(np.int64):
        drawn = [counts[number] for number in np.repeat(sequences, times).tolist()]
        scores.append(asdict(TrackingCounts.sum_of(drawn).scores()))
    names = [name for name in scores[0] if name not in COUNTS] if scores else []
    ends = {name + CI95: interval(np.array([row[name] for row in scores])) for name in names}
    return {name: limits for name, limits in ends.items() if limits is not None}


def _folder_of_results(results: Path, form: str) -> Path:
    """The folder with the rows: in the output folder of `track` only KITTI rows contain the classes
    that KITTI's truth distinguishes.
    """
    names = (find.KITTI_FOLDER, find.MOT_FOLDER) if form == "kitti" else (find.MOT_FOLDER,)
    folders = [results / name for name in names]
    return next((folder for folder in folders if folder.is_dir()), results)


def _boxes_of_tables(
    settings: TrackEvaluationSettings,
    pairs: Sequence[tuple[find.SequenceFile, find.SequenceFile]],
    form: str,
) -> tuple[str, dict[str, tuple[TrackedBoxes, TrackedBoxes]], list[str]]:
    """The class, true and tracked boxes by sequence, and notes, of labels without rules of a
    benchmark.
    """
    notes: list[str] = []
    tables = {
        labels.name: _truth_table(labels.path, settings.truth_format, notes) for labels, _ in pairs
    }
    name = _class_of_labels(tables.values(), settings.road_class)
    boxes = {}
    for labels, tracks in pairs:
        notes += _no_classes_note(tracks.path, name)
        true = _boxes_of(tables[labels.name], name, labels.path)
        boxes[labels.name] = (true, _read_results(tracks.path, name, form))
    return name, boxes, notes


def _empty_notes(labelled: Sequence[find.SequenceFile]) -> list[str]:
    return [
        f"{labels.path}: the file is empty, so all tracks of {labels.name} are false positives."
        for labels in labelled
        if is_blank(labels.path, "ground truth")
    ]


def _form_of(path: Path) -> str:
    """The format of a file of ground truth; an empty file is taken to be KITTI's."""
    if is_blank(path, "ground truth"):
        return "kitti"
    name = label_format_of(path, "ground truth").name
    if name not in truth_formats():
        raise LabelFileError(f"{path}: expected ground truth, found the rows of a run.")
    return name


def _truth_table(path: Path, form: str | None, notes: list[str]) -> BoxTable:
    """The labels of a file in one of the formats without rules for boxes that are ignored; notes
    are appended.
    """
    label_format = label_format_of(path, "ground truth")
    if form not in (None, label_format.name):
        raise LabelFileError(
            f"{path}: expected the format {form} (--format), found {label_format.title}."
        )
    table = read_labels(path, NO_FACTS, expected="ground truth")
    notes += [*table.notes, *other_labels_note(table, path)]
    if n_regions := int(table.is_region.sum()):
        notes.append(
            f"{path.name}: did not apply {counted(n_regions, 'ignore region')} of the ground "
            "truth; tracks in such regions count as false positives."
        )
    return table


def _no_classes_note(path: Path, road_class: str) -> tuple[str, ...]:
    """A note on results without classes, which `--class` cannot filter."""
    if (
        is_blank(path, "tracks")
        or label_format_of(path, "tracks").name != "mot"
        or any(read_mot(path).class_name)
    ):
        return ()
    return (
        f"{path.name}: rows of MOTChallenge have no class, so all tracks count as {road_class}.",
    )


def _other_classes_note(paths: Iterable[Path], road_class: str) -> tuple[str, ...]:
    """A note on results without the evaluated class."""
    names = [
        read_labels(path, expected="tracks").class_name
        for path in paths
        if not is_blank(path, "tracks")
    ]
    if not (counts := names_with_counts(np.concatenate([np.zeros(0, np.str_), *names]))):
        return ()
    return (
        f"No track has the evaluated class {road_class}; the boxes of the results have the classes "
        f"{counts}; choose one with --class.",
    )


def _boxes_of(table: BoxTable, road_class: str, path: Path, form: str = "") -> TrackedBoxes:
    """The boxes of a class; for ground truth in KITTI's format (`form`), without boxes of its
    neighbouring types.
    """
    is_class = table.class_id == ROAD_CLASSES.index(road_class)
    if form == "kitti":
        is_class &= ~np.isin(
            table.class_name, [name.lower() for name in KITTI_IGNORED if name != "Person"]
        )
    table = table.select(is_class)
    if (table.track_id < 0).any():
        raise LabelFileError(
            f"{path}: expected a track id for each box, found boxes without track ids."
        )
    try:
        return TrackedBoxes(table.frame, table.track_id, table.xyxy_px, table.class_id)
    except ValueError as error:
        raise LabelFileError(f"{path}: {_DUPLICATE}") from error


def _class_of_labels(tables: Iterable[BoxTable], road_class: str | None) -> str:
    """The class to evaluate: the given class, else the most frequent class."""
    if road_class is not None:
        return ROAD_CLASSES[road_class_id(road_class)]
    class_id = np.concatenate(
        [np.zeros(0, np.int64), *(table.class_id[table.class_id >= 0] for table in tables)]
    )
    return (
        ROAD_CLASSES[int(np.bincount(class_id, minlength=len(ROAD_CLASSES)).argmax())]
        if len(class_id)
        else "car"
    )


def _is_mot_challenge(path: Path) -> bool:
    """Whether rows have MOTChallenge's class numbers, or no class numbers, so that its rules
    apply.
    """
    return is_blank(path, "ground truth") or read_mot(path).names == MOT_CLASSES


def _class_of(form: str, road_class: str | None, paths: Iterable[Path]) -> str:
    """The class to evaluate by the rules of KITTI or MOTChallenge; truth without classes has the
    class of `--class`.
    """
    if road_class is None:
        return "car" if form == "kitti" else "person"
    name = ROAD_CLASSES[road_class_id(road_class)]
    if form == "mot" and name != "person" and any(any(read_mot(path).class_name) for path in paths):
        raise UsageError(
            f"--class {road_class}: expected person, the only class that MOTChallenge evaluates in "
            "ground truth with its class numbers; for other numbers, write their names into "
            "labels.txt beside the file."
        )
    if form == "kitti" and name not in KITTI_TYPES:
        raise UsageError(
            f"--class {road_class}: expected a class of KITTI's tracking labels: "
            f"{', '.join(KITTI_TYPES)}."
        )
    return name


def _cleaned(
    truth: find.SequenceFile, results: find.SequenceFile, form: str, road_class: str
) -> tuple[TrackedBoxes, TrackedBoxes]:
    """The boxes of truth and results of one sequence that are evaluated by the benchmark's
    rules.
    """
    tracked = _read_results(results.path, road_class, form)
    if form == "mot":
        rows = read_mot(truth.path)
        _check_once(truth.path, rows.frame, rows.track_id)
        is_mot20 = any(
            "mot20" in part.lower() for part in (truth.name, *real_path(truth.path).parts)
        )
        return mot_cleaned(rows, tracked, is_mot20=is_mot20)
    labels = read_kitti(truth.path)
    named = labels.track_id >= 0
    _check_once(truth.path, labels.frame[named], labels.track_id[named])
    return kitti_cleaned(labels, tracked, road_class)


def _read_results(path: Path, road_class: str, truth_form: str) -> TrackedBoxes:
    """Tracks of one class with frames from 0; rows of MOTChallenge without a class all count.

    For ground truth of KITTI, rows of KITTI count by their type, so vans are not cars.
    """
    class_id = ROAD_CLASSES.index(road_class)
    if is_blank(path, "tracks"):
        return TrackedBoxes(
            np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 4)), np.zeros(0, np.int64)
        )
    form = label_format_of(path, "tracks").name
    if form == "kitti" and truth_form == "kitti":
        labels = read_kitti(path)
        labels = labels.select(of_kitti_type(labels, KITTI_TYPES[road_class][:1]))
        frame, track_id, xyxy_px = labels.frame, labels.track_id, labels.xyxy_px
    elif form == "mot":
        rows = read_mot(path)
        names = rows.class_name
        is_class = (map_to_road_classes(names) == class_id) | np.array(
            [not name for name in names], np.bool_
        )
        frame, track_id, xyxy_px = (
            rows.frame[is_class],
            rows.track_id[is_class],
            rows.xyxy_px[is_class],
        )
    else:
        table = read_labels(path, NO_FACTS, expected="tracks")
        if form == "kitti":
            table = table.select(table.track_id >= 0)
        return _boxes_of(table, road_class, path, truth_form)
    try:
        return TrackedBoxes(frame, track_id, xyxy_px, np.full(len(frame), class_id))
    except ValueError as error:
        raise LabelFileError(f"{path}: {_DUPLICATE}") from error


def _check_once(path: Path, frame: IntArray, track_id: IntArray) -> None:
    if len(np.unique(np.stack([frame, track_id]), axis=1).T) < len(frame):
        raise LabelFileError(f"{path}: {_DUPLICATE}")


def _without_nan(figures: Mapping[str, float]) -> dict[str, float | int | None]:
    """Figures for JSON: counts as integers, NaN as None."""
    return {
        key: None if math.isnan(value) else int(value) if key in COUNTS else float(value)
        for key, value in figures.items()
    }
