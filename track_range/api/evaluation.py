"""Evaluations as functions: options of `track-range evaluate` as keyword arguments, results as a
dictionary.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from track_range.calibration.settings import StereoEvaluationSettings
from track_range.evaluation.events.evaluate import evaluate_events as _evaluate_events
from track_range.evaluation.events.settings import EventEvaluationSettings
from track_range.evaluation.limits import CheckSettings, check as _check
from track_range.evaluation.motion.cuboids import evaluate_cuboids as _evaluate_cuboids
from track_range.evaluation.motion.evaluate import evaluate_motion as _evaluate_motion
from track_range.evaluation.motion.settings import (
    CuboidEvaluationSettings,
    MotionEvaluationSettings,
)
from track_range.evaluation.range_evaluation import evaluate_ranges as _evaluate_ranges
from track_range.evaluation.run_evaluation import (
    RunEvaluationSettings,
    evaluate_run as _evaluate_run,
)
from track_range.evaluation.sequences.evaluation import evaluate_tracks as _evaluate_tracks
from track_range.evaluation.sequences.settings import TrackEvaluationSettings
from track_range.evaluation.stereo_evaluation import evaluate_stereo as _evaluate_stereo
from track_range.foundation.schemas.keywords import KeywordsInErrors
from track_range.ranging.evaluation.settings import RangeEvaluationSettings


@KeywordsInErrors(RangeEvaluationSettings)
def evaluate_ranges(labels: str | Path, calib: str | Path, **options: Any) -> dict[str, Any]:
    """Distance errors of ranging methods on KITTI labels, with or without their images; like
    `track-range evaluate ranges --json`.

    Args:
        labels: folder of KITTI tracking labels, NAME.txt for each sequence.
        calib: folder of KITTI calibration files with the same names.
        options: options of the command, with underscores: `noise_px=2`, `cross_validate=True`,
            `filter="default"`, `images="image_02"`, `depth_model=["network.onnx"]`.

    Raises:
        UsageError: an option is unknown or invalid.
        LabelFileError, RigError, CurveError, VideoError, LabelledImageError, MethodError: a file,
            an image or a method cannot be used.
    """
    return _evaluate_ranges(
        RangeEvaluationSettings.of({"labels": labels, "calib": calib, **options})
    )


@KeywordsInErrors(RunEvaluationSettings)
def evaluate_run(
    folder: str | Path, truth: str | Path | None = None, **options: Any
) -> dict[str, Any]:
    """Errors of the distances, closing speeds and tracks of a finished run, without its images; like
    `track-range evaluate run --json`.

    Args:
        folder: result folder of the run.
        truth: labels or a table of targets; None = the ground truth of the run.
        options: options of the command, with underscores: `truth_calib="calib.txt"`, `store=True`.

    Raises:
        UsageError: an option is unknown or invalid, or there is no ground truth.
        OutputError, LabelFileError, RigError: a file cannot be used.
    """
    given = {"folder": folder, "truth": truth, **options}
    return _evaluate_run(RunEvaluationSettings.of(given))


@KeywordsInErrors(CheckSettings)
def check(folder: str | Path | Sequence[str | Path], **options: Any) -> dict[str, Any]:
    """Whether figures of runs are within limits; like `track-range check --json`.

    Args:
        folder: result folder of a run, or local folder of a fleet; a sequence of several.
        options: options of the command: `require=["fused.median_relative_error_pct < 5"]`,
            `limits="limits.yaml"`, `min_coverage=0.5`, `junit="check.xml"`.

    Raises:
        UsageError: an option is unknown or invalid, or a limit names an unknown figure.
        ConfigError, OutputError: a file cannot be used.
    """
    return _check(CheckSettings.of({"folders": _several(folder), **options}))


@KeywordsInErrors(MotionEvaluationSettings)
def evaluate_motion(labels: str | Path, **options: Any) -> dict[str, Any]:
    """Errors of closing speeds, speeds over ground and times to collision; like `track-range
    evaluate motion --json`.

    Args:
        labels: folder of KITTI tracking labels, or the labels of another data set
            (`data="nuscenes"`).
        options: options of the command, with underscores: `calib="calib"`, `poses="poses"`,
            `noise_px=2`.

    Raises:
        UsageError: an option is unknown, invalid or missing.
        LabelFileError, RigError: a file cannot be used.
    """
    return _evaluate_motion(MotionEvaluationSettings.of({"labels": labels, **options}))


@KeywordsInErrors(CuboidEvaluationSettings)
def evaluate_cuboids(labels: str | Path, **options: Any) -> dict[str, Any]:
    """Errors of sizes, headings, centres and nearest sides of measured 3-D boxes; like `track-range
    evaluate cuboids --json`.

    Args:
        labels: folder of KITTI tracking labels, or the labels of another data set
            (`data="nuscenes"`).
        options: options of the command, with underscores: `calib="calib"`, `poses="poses"`,
            `noise_px=2`.

    Raises:
        UsageError: an option is unknown, invalid or missing.
        LabelFileError, RigError: a file cannot be used.
    """
    return _evaluate_cuboids(CuboidEvaluationSettings.of({"labels": labels, **options}))


@KeywordsInErrors(StereoEvaluationSettings)
def evaluate_stereo(pairs: str | Path, **options: Any) -> dict[str, Any]:
    """Distance errors of stereo matchers on pairs with true disparities; like `track-range evaluate
    stereo --json`.

    Example:
        >>> import track_range as tr
        >>> results = tr.evaluate.stereo("drive", matchers=("sgbm",))
        >>> results["matchers"]["sgbm"]["median_relative_error_pct"] < 10
        True

    Args:
        pairs: folder in the layout of KITTI 2015, of a drive with labels, or of single pairs.
        options: options of the command: `matchers=("patch", "sgbm")`, `align="leave-two-out"`,
            `stereo_model=["network.onnx"]`, `truth=["objects.csv"]`, `seed=0`.

    Raises:
        UsageError: an option is unknown or invalid.
        PairFileError, RigError, VideoError, LabelFileError, ModelError, NetworkError: a file cannot
            be used.
    """
    return _evaluate_stereo(StereoEvaluationSettings.of({"pairs": pairs, **options}))


@KeywordsInErrors(TrackEvaluationSettings)
def evaluate_tracks(truth: str | Path, results: str | Path, **options: Any) -> dict[str, Any]:
    """HOTA, CLEAR and identity metrics of tracks against ground truth; like `track-range evaluate
    tracks --json`.

    Args:
        truth: ground truth in MOT or KITTI format: a file, or a folder of sequences.
        results: tracks in either format.
        options: options of the command: `truth_format="kitti"`, `road_class="car"`,
            `compare="motmetrics"`.

    Raises:
        UsageError: an option is unknown or invalid.
        MotFormatError, LabelFileError: a file cannot be used.
    """
    return _evaluate_tracks(
        TrackEvaluationSettings.of({"truth": truth, "results": results, **options})
    )


@KeywordsInErrors(EventEvaluationSettings)
def evaluate_events(
    events: str | Path | Sequence[str | Path],
    truth: str | Path | Sequence[str | Path],
    **options: Any,
) -> dict[str, Any]:
    """Hits, misses, false alarms and lead times of warnings or events; like `track-range evaluate
    events --json`.

    Args:
        events: events.csv or events.parquet of a run, or its folder; a sequence for several drives
            together.
        truth: contacts (contacts.csv of a simulated drive), what happens (class, first_visible_s,
            conflict_s, nearest_s, warning), labelled events with the columns of events.csv, or
            "none"; a sequence, in the order of the runs, for several drives.
        options: options of the command: `tracks="run/tracks.csv"`, `boxes="truth.csv"`,
            `hours=2.5`, `min_lead_s=0.8`, `until_s=10.3`.

    Raises:
        UsageError: an option is unknown or invalid.
        EventFileError, OutputError, LabelFileError: a file cannot be used.
    """
    given = {"events": _several(events), "truth": _several(truth), **options}
    return _evaluate_events(EventEvaluationSettings.of(given))


def _several(paths: str | Path | Sequence[str | Path]) -> tuple[str | Path, ...]:
    return (paths,) if isinstance(paths, str | Path) else tuple(paths)
