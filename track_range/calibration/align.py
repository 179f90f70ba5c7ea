"""Estimation of the disparity error of a rig from a drive, or from objects of known distance."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from track_range.calibration.reference_pairs import LEFT, RIGHT, open_pair, reference_pairs
from track_range.calibration.settings import AlignmentSettings, RigCheckSettings
from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import real_path
from track_range.foundation.files.output_files import check_outputs, write_json
from track_range.foundation.progress import StepProgress, no_progress
from track_range.recording.recording import Recording, open_recording
from track_range.stereo.alignment.feature_tracks import row_offset_px
from track_range.stereo.alignment.file import save_alignment
from track_range.stereo.alignment.from_drive import NOT_MEASURED, DriveAlignment
from track_range.stereo.alignment.from_reference import fit_reference
from track_range.stereo.alignment.health import UNSEEN, RigHealth, Window
from track_range.stereo.alignment.right_view import RightView
from track_range.stereo.evaluation.box_matchers import measure_pairs
from track_range.stereo.evaluation.kitti_2015 import StereoPair
from track_range.stereo.geometry.alignment import MAX_ROW_OFFSET_PX, Alignment
from track_range.stereo.geometry.frames import whole_image
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.reading import find_rig

_MATCHER = "patch"
_CORRECTION = "a run with this alignment corrects it"
# number of image pairs on which the row offset is measured; it hardly varies between pairs
_N_ROW_PAIRS = 12
_MIN_SIGMAS = 3.0  # from which a given value is excluded


@dataclass(frozen=True, slots=True)
class CheckedValue:
    """A value of a pair as it is given, and as drives show it."""

    name: str  # with its unit
    given: float
    shown: float
    sigma: float  # of the shown value
    is_doubted: bool  # whether the given value is excluded, by an error that matters


@dataclass(frozen=True, slots=True)
class BaselineCheck:
    """Evidence about the baseline from road users and the speed of the camera."""

    sentence: str  # for the user
    figures: dict[str, Any]  # as in summary.json of a run
    values: tuple[CheckedValue, ...] = ()  # lengths that the evidence shows


CheckBaseline = Callable[[tuple[Path, Path], AlignmentSettings | RigCheckSettings], BaselineCheck]
"""Checks the baseline in a drive, from its left and right video."""


@dataclass(frozen=True, slots=True)
class RigAlignment:
    """The disparity error of a rig."""

    applied: Alignment  # the alignment to apply, with insignificant terms set to 0
    measured: Alignment  # the alignment as estimated
    health: RigHealth  # what it means for distances
    notes: tuple[str, ...]  # messages for the user
    baseline: BaselineCheck | None = None  # what road users and the speed show; None = not checked
    # (3,) sigmas of row offset in px, roll in degrees and focal ratio; None = not from drives
    view_sigma: FloatArray | None = None

    @property
    def values(self) -> tuple[CheckedValue, ...]:
        """The values of the pair that were measured, against those of its rig."""
        measured, rig = self.measured, self.health.rig
        pair = CheckedValue(
            "error of all disparities px",
            0.0,
            measured.offset_px,
            measured.offset_sigma_px,
            self.health.has_disparity_error,
        )
        of_baseline = () if self.baseline is None else self.baseline.values
        if self.view_sigma is None:
            return (pair, *of_baseline)
        row_sigma_px, roll_sigma_deg, ratio_sigma = self.view_sigma.tolist()
        deg_per_px = math.degrees(1 / rig.left.fx_px)
        pitch_deg, pitch_sigma_deg = deg_per_px * measured.row_offset_px, deg_per_px * row_sigma_px
        row, roll, zoom = (
            RightView(measured.row_offset_px),
            RightView(roll_deg=measured.roll_deg),
            RightView(focal_ratio=measured.focal_ratio),
        )

        def of_rows(
            name: str, given: float, shown: float, sigma: float, error: RightView
        ) -> CheckedValue:
            is_excluded = abs(shown - given) > _MIN_SIGMAS * sigma
            matters = error.rows_px(rig.left) > MAX_ROW_OFFSET_PX
            return CheckedValue(name, given, shown, sigma, is_excluded and matters)

        return (
            of_rows("pitch of the right camera deg", 0.0, pitch_deg, pitch_sigma_deg, row),
            of_rows("roll of the right camera deg", 0.0, measured.roll_deg, roll_sigma_deg, roll),
            of_rows("focal length, right over left", 1.0, measured.focal_ratio, ratio_sigma, zoom),
            pair,
            *of_baseline,
        )

    @classmethod
    def of(
        cls,
        rig: StereoRig,
        measured: Alignment,
        notes: Iterable[str],
        windows: tuple[Window, ...] = (),
    ) -> RigAlignment:
        """The result of a measurement, with a note on the rows of left and right, if they
        differ.
        """
        health = RigHealth(rig, measured, measured.if_clear(), windows)
        if health.has_row_error:
            note = (
                f"Left and right have a vertical offset of {measured.row_offset_px:+.2f} px, roll "
                f"{measured.roll_deg:+.3f} degrees, focal length of the right camera "
                f"{100 * (measured.focal_ratio - 1):+.2f} %: a run corrects this, but the rig does "
                "not fit these images well; calibrate again."
            )
            notes = (*notes, note)
        return cls(health.applied, measured, health, tuple(notes))

    @property
    def figures(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "alignment": self.applied.to_dict(),
            "measured": self.measured.to_dict(),
            "is_clear": self.measured.is_clear,
            "sentence": self.applied.sentence(),
            "health": self.health.to_dict(),
            "notes": list(self.notes),
            "baseline": None if self.baseline is None else self.baseline.figures,
            "cameras": [asdict(value) for value in self.values],
        }

    @property
    def sentences(self) -> list[str]:
        """The alignment, its meaning for distances, and the notes, for the user."""
        baseline = UNSEEN if self.baseline is None else self.baseline.sentence
        alignment = self.applied.sentence(correction=_CORRECTION)
        sentences = (
            alignment,
            self.health.sentence(),
            self.health.move_sentence(),
            baseline,
            *self.notes,
        )
        return [sentence for sentence in sentences if sentence]

    def save(self, settings: AlignmentSettings) -> None:
        """Write the alignment file and the results, if `settings.json_file` is given; OutputError
        or RigError.
        """
        save_alignment(self.applied, settings.out)
        write_json(settings.json_file, self.figures)


def align(
    settings: AlignmentSettings,
    progress: StepProgress = no_progress,
    check_baseline: CheckBaseline | None = None,
) -> RigAlignment:
    """Estimate the disparity error of a rig; nothing is written before `RigAlignment.save`.

    Raises UsageError without a source, or with drives and a reference, RigError if the rig cannot
    be used, or there is too little data, PairFileError, LabelFileError or VideoError if videos,
    images or labels cannot be used, and OutputError if a result would overwrite an input.
    """
    check_outputs(
        [file for file in (settings.out, settings.json_file) if file is not None], _inputs(settings)
    )
    if settings.reference is None:
        return _from_drives(settings, progress, check_baseline)
    if settings.checks_baseline:
        raise UsageError(
            "--detector, --detections and --ego-speed check a drive; omit them with --reference."
        )
    if settings.drives:
        raise UsageError("--reference and --drive exclude each other; give one of them.")
    return _from_reference(settings.reference, settings, progress)


def check_rig_health(
    settings: RigCheckSettings,
    progress: StepProgress = no_progress,
    check_baseline: CheckBaseline | None = None,
) -> RigAlignment:
    """Measure the present state of a rig on drives; nothing is written except `settings.json_file`.

    Raises UsageError without a drive, and RigError, VideoError and OutputError as in `align`.
    """
    check_outputs([] if settings.json_file is None else [settings.json_file], _inputs(settings))
    checked = _from_drives(settings, progress, check_baseline)
    write_json(settings.json_file, checked.figures)
    return checked


def _inputs(settings: AlignmentSettings | RigCheckSettings) -> list[Path]:
    reference = settings.reference if isinstance(settings, AlignmentSettings) else None
    folders = [folder for folder in (*settings.drives, reference) if folder is not None]
    videos = [
        *(settings.stereo or ()),
        *(folder / name for folder in folders for name in (LEFT, RIGHT)),
    ]
    named = (settings.rig, reference, *map(find_rig, videos))
    return [*videos, *(path for path in named if path is not None)]


def _from_drives(
    settings: AlignmentSettings | RigCheckSettings,
    progress: StepProgress,
    check_baseline: CheckBaseline | None,
) -> RigAlignment:
    sources = _sources(settings)
    prior, notes = _prior(*sources[0], settings)
    with ExitStack() as opened:
        recordings, rigs = [], []
        for left, right in sources:
            recording, rig = open_pair(
                left,
                right,
                settings.rig,
                align=prior,
                has_checks=True,
                stereo_layout=settings.stereo_layout,
            )
            opened.callback(recording.close)
            recordings.append(recording)
            rigs.append(rig)
        _check_one_rig(rigs)
        # in the alignment file, "this drive" would be ambiguous
        estimator = DriveAlignment(rigs[0], prior, ", ".join(_name(left) for left, _ in sources))
        with progress("frames") as advance:
            for recording in recordings:
                estimator.start_drive()
                _add_frames(estimator, recording, advance)
                recording.close()
    measured = estimator.estimate()
    if not measured.is_measured:
        raise RigError(
            f"{sources[0][0]}: {measured.source}; use a longer drive past static objects."
        )
    for recording in recordings:
        notes += recording.calibration.file_notes
    for recording in recordings:
        notes += () if recording.sync is None else tuple(recording.sync.notes)
    aligned = RigAlignment.of(rigs[0], measured, dict.fromkeys(notes), estimator.windows())
    aligned = replace(aligned, view_sigma=estimator.view_sigma)
    if check_baseline is None or not settings.checks_baseline:
        return aligned
    return replace(aligned, baseline=check_baseline(sources[0], settings))


def _sources(settings: AlignmentSettings | RigCheckSettings) -> list[tuple[Path, Path]]:
    """The left and the right video of each drive; UsageError without a drive."""
    sources = [(folder / LEFT, folder / RIGHT) for folder in settings.drives]
    if settings.stereo:
        sources.append(settings.stereo)
    if sources:
        return sources
    if isinstance(settings, RigCheckSettings):
        raise UsageError("expected a drive: give --stereo LEFT RIGHT or --drive DIR.")
    raise UsageError(
        "expected a drive or a reference: give --stereo LEFT RIGHT, --drive DIR "
        "or --reference FILE."
    )


def _name(left: Path) -> str:
    """Name of the drive with this left video."""
    return real_path(left.parent).name if left.name == LEFT else left.name


def _check_one_rig(rigs: Sequence[StereoRig]) -> None:
    first, *others = rigs
    for rig in others:
        if rig.left != first.left or not np.isclose(rig.baseline_m, first.baseline_m):
            raise RigError(
                "the drives were recorded with different rigs; align each rig separately."
            )


def _add_frames(
    estimator: DriveAlignment, recording: Recording, advance: Callable[[int, int | None], None]
) -> None:
    """Add the frames of a drive until the estimator has enough of it."""
    for number, frame in enumerate(recording.frames):
        if estimator.is_full:
            break
        estimator.add(frame)
        advance(number + 1, max(recording.n_frames or 0, number + 1))


def _prior(
    left: Path, right: Path, settings: AlignmentSettings | RigCheckSettings
) -> tuple[Alignment, tuple[str, ...]]:
    """The correction with which the estimate starts, from the first images, and a note on how they
    fit the rig.
    """
    layout = settings.stereo_layout
    with closing(
        open_recording(left, right, rig=settings.rig, align="off", stereo_layout=layout)
    ) as recording:
        finding = recording.finding
    if finding is None:
        return NOT_MEASURED, ()
    sentence = finding.corrected().sentence
    return finding.prior, (sentence,) if sentence else ()


def _from_reference(
    reference: Path, settings: AlignmentSettings, progress: StepProgress
) -> RigAlignment:
    listed = reference_pairs(
        reference, stereo=settings.stereo, rig=settings.rig, stereo_layout=settings.stereo_layout
    )
    with progress("pairs") as advance:
        pairs = _ReferencePairs(listed, advance)
        measured = measure_pairs(pairs, (_MATCHER,))
    objects, column = measured.objects, measured.columns[_MATCHER]
    if not objects.cameras:
        raise RigError(
            f"{reference}: none of the objects refers to a frame of the videos; check "
            "the frame numbers."
        )
    fitted = fit_reference(
        column.disparity_px,
        objects.true_px,
        x_px=objects.x_px,
        camera=objects.cameras[0],
        groups=objects.group,
        sigma_px=column.sigma_px,
        seed=settings.seed,
    )
    aligned = replace(fitted, row_offset_px=pairs.row_offset_px)
    return RigAlignment.of(pairs.rigs[0], aligned, measured.notes)


class _ReferencePairs:
    """The pairs of a reference, one by one, with what is measured on the way."""

    def __init__(
        self, pairs: Iterable[StereoPair], advance: Callable[[int, int | None], None]
    ) -> None:
        self._pairs, self._advance = pairs, advance
        self._rows_px: list[float] = []
        self.rigs: list[StereoRig] = []  # the rectified rig of each pair so far

    def __iter__(self) -> Iterator[StereoPair]:
        for number, pair in enumerate(self._pairs):
            self.rigs.append(pair.rig)
            if number < _N_ROW_PAIRS:
                row_px = row_offset_px(pair.left, whole_image(pair.right))
                if row_px is not None:
                    self._rows_px.append(row_px)
            self._advance(number + 1, number + 1)
            yield pair

    @property
    def row_offset_px(self) -> float:
        """Median row offset of the first pairs; 0 = not measured."""
        return float(np.median(self._rows_px)) if self._rows_px else 0.0
