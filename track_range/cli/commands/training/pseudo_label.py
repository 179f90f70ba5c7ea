"""`track-range pseudo-label`: labels the training images of a data set with an ensemble of
detectors.
"""

import os
import shutil
from itertools import pairwise

from track_range.cli.commands.training.options import PseudoLabelOptions
from track_range.cli.shared.console import console, print_first, print_grid, print_line, print_notes
from track_range.cli.shared.parameters import command
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.evaluation.score_calibration import Reliability
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.training.data_yaml import OwnLabels, read_own_labels
from track_range.detection.training.ensemble import data_set
from track_range.detection.training.ensemble.calibration import MIN_POSITIVES
from track_range.detection.training.ensemble.views import EnsembleMember, store_missing
from track_range.detection.training.errors import TrainingError
from track_range.foundation.files.input_files import counted, real_path
from track_range.foundation.files.output_files import OutputError, locked_output, make_folder
from track_range.run.interrupts import stop_on_interrupt
from track_range.run.progress import step_progress
from track_range.run.ready_model import ready_model
from track_range.views.tables import NOTHING, Cell, Column, Grid, grid_of


def _pseudo_label(options: PseudoLabelOptions) -> None:
    data = read_own_labels(options.data)
    print_notes(console, data.notes)
    _check_folder(options, data)
    runtime = Runtime(device=options.device, n_threads=options.threads)
    paths = dict.fromkeys(ready_model(name, console) for name in options.models)
    stored = options.out / data_set.DETECTIONS
    members = [
        EnsembleMember(path, stored, size_px=options.size_px, runtime=runtime) for path in paths
    ]
    data_set.usable_classes(data, members)
    _print_plan(data, members)
    with locked_output(options.out), stop_on_interrupt():
        try:
            make_folder(stored)
            with step_progress(console, "detection") as progress:
                unreadable = store_missing(data.image_files, members, progress)
            with step_progress(console, "fusion") as progress:
                outcome = data_set.label_training_images(
                    data,
                    members,
                    options.out,
                    unreadable=unreadable,
                    min_probability=options.min_probability,
                    progress=progress,
                )
        except KeyboardInterrupt:
            raise TrainingError(
                f"stopped by the user; continue the run in {options.out} with --resume."
            ) from None
        shutil.rmtree(stored, ignore_errors=True)
    print_first(
        console,
        f"{counted(len(unreadable), 'image')} cannot be read and are left out:",
        list(unreadable.values()),
    )
    _print_outcome(outcome, members)
    folder, root = real_path(options.out), real_path(data.root)
    print_line(
        console,
        f"Written: {options.out}. To train with these labels, write into {options.data}:",
        f"labels_pseudo: {os.path.relpath(folder, root) if root in folder.parents else folder}",
        "pseudo_scores: probabilities",
        f"pseudo_names: [{', '.join(ROAD_CLASSES[i] for i in outcome.known_class_id)}]",
    )


def _check_folder(options: PseudoLabelOptions, data: OwnLabels) -> None:
    """OutputError unless the output folder is empty, or has only files of a run of `data` to
    resume.
    """
    if options.out.exists() and not options.out.is_dir():
        raise OutputError(f"{options.out}: expected a folder, found a file; choose another --out.")
    is_started = (options.out / data_set.DETECTIONS).is_dir()
    if options.resume and not is_started:
        raise OutputError(
            f"{options.out}: expected an interrupted run to resume, found none; omit --resume."
        )
    if is_started and not options.resume:
        raise OutputError(
            f"{options.out}: this folder contains an unfinished run; continue it with --resume, "
            "delete the folder, or choose another --out."
        )
    names = {item.path.stem for item in data.train}
    if is_started and (
        others := sorted(file.name for file in options.out.glob("*.txt") if file.stem not in names)
    ):
        raise OutputError(
            f"{options.out}: expected labels of the images in {options.data}, found "
            f"{counted(len(others), 'label')} of other images, such as {others[0]}; delete these "
            "files to continue."
        )
    if not is_started and options.out.is_dir() and any(options.out.glob("*.txt")):
        raise OutputError(
            f"{options.out}: expected a folder without labels, found labels; choose another --out."
        )


def _print_plan(data: OwnLabels, members: list[EnsembleMember]) -> None:
    n_other = sum(len(labels.score) for labels in (data.labels_pseudo or {}).values())
    other = (
        ""
        if data.labels_pseudo is None
        else f", combined with {counted(n_other, 'detection')} in labels_pseudo"
    )
    print_line(
        console,
        f"{counted(len(data.train), 'training image')}, "
        f"{counted(len(data.val), 'validation image')}; "
        f"{counted(len(members), 'detector')}{other}.",
    )
    notes = [note for member in members for note in member.notes]
    if all(item.truth.is_complete[data.is_named].all() for item in data.train):
        notes.append(
            "All classes are completely labelled in all training images, so only boxes to ignore "
            "are written; list classes that are not completely labelled in a manifest."
        )
    train = {real_path(item.path) for item in data.train}
    if any(real_path(item.path) in train for item in data.val):
        notes.append(
            "Validation images are also training images, so the calibration table is not "
            "an independent test."
        )
    print_notes(console, notes)


def _print_outcome(outcome: data_set.PseudoLabelFigures, members: list[EnsembleMember]) -> None:
    print_grid(console, _label_grid(outcome))
    others = [
        ROAD_CLASSES[i] for i in outcome.known_class_id if not outcome.calibration.n_positives[i]
    ]
    if others:
        print_line(
            console,
            f"Classes with fewer than {MIN_POSITIVES} matches are calibrated as the mean of the "
            f"other classes: {', '.join(others)}.",
        )
    if outcome.validation:
        print_grid(console, _validation_grid(outcome.validation))
    else:
        print_line(
            console,
            "No validation image is labelled completely: the calibration cannot be verified.",
        )
    print_notes(console, [note for member in members for note in member.notes if "dropped" in note])


def _label_grid(outcome: data_set.PseudoLabelFigures) -> Grid:
    rows = outcome.known_class_id
    fitted = [int(n) or None for n in outcome.calibration.n_positives[rows]]
    columns = [Column("fitted to", fitted, "{:.0f}")]
    columns += [
        Column(f"p >= {minimum}", outcome.n_labels[rows, i].tolist(), "{:.0f}")
        for i, minimum in enumerate(data_set.COUNTED_PROBABILITIES)
    ]
    columns.append(Column("ignored", outcome.n_ignored[rows].tolist(), "{:.0f}"))
    return grid_of(
        "Pseudo-labels by class and minimum probability",
        "class",
        [ROAD_CLASSES[i] for i in rows],
        columns,
    )


def _validation_grid(validation: dict[int, Reliability]) -> Grid:
    """One row per class: mean probability, fraction of matches and number of boxes in each bin."""
    edges = next(iter(validation.values())).edges
    columns = [f"p {low:g}-{high:g}" for low, high in pairwise(edges)]
    rows = []
    for class_id, bins in validation.items():
        figures = zip(
            bins.n.tolist(), bins.mean_score.tolist(), bins.precision.tolist(), strict=True
        )
        texts = [
            f"{100 * p:.0f} / {100 * matched:.0f} ({n})" if n else NOTHING
            for n, p, matched in figures
        ]
        rows.append(tuple(Cell(text) for text in (ROAD_CLASSES[class_id], *texts)))
    title = "Validation images: mean probability / matched boxes % (number of boxes)"
    return Grid(title, ("class", *columns), tuple(rows))


app = command(PseudoLabelOptions, _pseudo_label)
