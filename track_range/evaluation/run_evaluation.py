"""Evaluation of a finished run against ground truth, from the files in its folder, without images."""

import os
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from track_range.evaluation.motion.cuboid_errors import (
    cuboid_errors,
    cuboid_figures,
    distance_cells,
    labelled_cuboids,
    view_cells,
)
from track_range.foundation.bootstrap import Resamples
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import real_path
from track_range.foundation.files.output_files import write_json
from track_range.foundation.schemas.options import option
from track_range.results.folder import EVALUATION_FILE, read_run_folder, truth_of
from track_range.results.replay import cuboids_of
from track_range.results.rows.rows import Rows
from track_range.results.summary import MatchedTruth, matched_truth, truth_figures
from track_range.run.export.source import processed_frames
from track_range.run.options.truth import TruthOptions


class RunEvaluationSettings(TruthOptions):
    """The run and the ground truth of `track-range evaluate run`."""

    folder: Annotated[
        Path,
        option("Result folder of a run.", metavar="DIR", is_argument=True),
    ]
    seed: Annotated[int, option("Random seed of the 95 % intervals.", ge=0)] = 0
    store: Annotated[
        bool,
        option(
            f"Figures and ground truth also in the folder, as {EVALUATION_FILE}, which `report` and "
            "`check` then use in place of those of the run."
        ),
    ] = False


def evaluate_run(settings: RunEvaluationSettings) -> dict[str, Any]:
    """Sections `methods`, `common`, `closing` and `tracks` as in summary.json, with the ground truth
    and notes, as JSON values.

    Without a ground truth in the settings, it is that of the run. Raises OutputError: the folder has
    no run, or cannot be written to; LabelFileError, RigError: the ground truth or its calibration
    cannot be used; UsageError: there is no ground truth.
    """
    run = read_run_folder(settings.folder, has_events=False)
    names = TruthOptions.model_fields
    chosen = settings.model_dump(mode="json", include=set(names), exclude_defaults=True)
    for name in {"truth", "truth_calib", "truth_poses"} & chosen.keys():
        chosen[name] = os.fspath(real_path(Path(chosen[name])))
    given = chosen if settings.truth else {**run.settings, **chosen}
    if not given.get("truth"):
        raise UsageError("--truth: expected the file of the ground truth, since the run had none.")
    truth = truth_of(given, run.detected)
    frames = np.array(processed_frames(run, is_live=False), np.int64)
    matched = matched_truth(run.rows, truth)
    methods = tuple(run.summary.get("methods") or run.rows.methods_measured)
    figures = {
        "run": str(settings.folder),
        "settings": {name: given[name] for name in names if name in given},
        "frames": len(frames),
        **truth_figures(run.rows, matched, methods, frames, settings.seed),
        **_cuboids(run.rows, matched, settings.seed),
        "notes": [*run.missing, *matched.truth.notes],
    }
    if settings.store:
        write_json(settings.folder / EVALUATION_FILE, figures)
    return figures


def _cuboids(rows: Rows, matched: MatchedTruth, seed: int) -> dict[str, Any]:
    """Section `cuboids`, of a run and labels that have them: headings modulo 180 degrees where the
    front is not stated.
    """
    truth = matched.truth
    if truth.kitti is None or truth.location_m is None or "yaw_deg" not in rows:
        return {}
    own = np.flatnonzero(np.isfinite(matched.of_scored(matched.distance_m)))
    labels = labelled_cuboids(truth.location_m, truth.kitti.size_hwl_m, truth.kitti.rotation_y_rad)
    true, measured = labels.select(matched.row[own]), cuboids_of(rows).select(own)
    every = np.ones(len(own), np.bool_)
    cells = {"all": every, **view_cells(true, {"all": every}), **distance_cells(true, every)}
    errors = cuboid_errors(measured, true, is_moving=measured.front_known)
    resamples = Resamples.of(truth.track_id[matched.row[own]], seed=seed, rows=every)
    return {"cuboids": cuboid_figures(errors, cells, measured, true, resamples)}
