"""Box-only methods on labelled boxes: registered ranging methods as in a run, and plain curves."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import IntArray
from track_range.ranging.evaluation.box_evaluation import frame_rows
from track_range.ranging.fitting import cross_validation
from track_range.ranging.fitting.prior_fit import fit_size_priors
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import MethodContext, Ranger, RangingMethod, checked_ranges
from track_range.ranging.registry import create_rangers, methods
from track_range.ranging.size_models.curve import CurveError, load_curves
from track_range.ranging.size_models.drive_scale import DriveScale, ScaleEvidence
from track_range.ranging.size_models.plain_curves import PLAIN_CURVES, within_range
from track_range.ranging.size_models.region import Region
from track_range.ranging.size_models.regions import in_region
from track_range.ranging.size_models.size_model import SIZE_CLASSES, SizeModel
from track_range.ranging.truth.errors import MethodColumn
from track_range.ranging.truth.labelled_boxes import BoxSet
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks


def box_methods() -> tuple[RangingMethod, ...]:
    """The registered methods of distances that require only boxes and a camera."""
    return tuple(method for method in methods() if method.measures_distance and not method.needs)


def method_names() -> tuple[str, ...]:
    """Names of all methods that can be measured, in the order of tables; the last is the fusion of
    the box methods.
    """
    names = [method.name for method in box_methods()]
    return (*PLAIN_CURVES, *names, "+".join(names))


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodOptions:
    """Options for fitting and measuring with box-only methods."""

    curves: Path | None = None  # curve file for mono; None = the packaged one
    # mono is fitted by cross-validation instead; plain curves always are
    is_cross_validated: bool = False
    # mono and plain curves are fitted to the same drive that they measure
    is_same_drive: bool = False
    # mono and plain curves are fitted to training boxes of other drives or images
    is_held_out: bool = False
    # standard deviation of one box edge; None = the noise model of a detector
    box_sigma_px: float | None = None
    camera_height_m: float | None = None  # camera height for the ground plane; None = unknown
    region: Region = "unknown"  # of the packaged or fitted sizes

    @property
    def scheme(self) -> cross_validation.Scheme | None:
        """How mono is fitted and measured; None = it has the curves of a file."""
        if self.is_same_drive:
            return cross_validation.within_drives
        if self.is_held_out:
            return cross_validation.held_out
        return cross_validation.cross_validated if self.is_cross_validated else None


def measured_by(
    names: Sequence[str], boxes: BoxSet, train: BoxSet, options: MethodOptions | None = None
) -> dict[str, MethodColumn]:
    """Distances and sigmas of N boxes, by method of `method_names`.

    Curves are fitted to `train`: boxes of the same sequences, for example without noise.
    """
    options = options or MethodOptions()
    scheme = options.scheme or cross_validation.cross_validated
    reference = train.with_reference()
    columns = {
        name: scheme(
            boxes, reference, cross_validation.plain_fitter(within_range(PLAIN_CURVES[name]))
        )
        for name in names
        if name in PLAIN_CURVES
    }
    if set(names) <= columns.keys():
        return {name: columns[name] for name in names}

    # All box methods and their fusion; methods with a size model are fitted according to `options`.
    measured: dict[str, MethodColumn] = {}
    for method in box_methods():
        if method.uses_size_model and options.scheme is not None:
            measured[method.name] = options.scheme(boxes, train, size_fitter(method, options))
        elif method.uses_size_model:
            measured |= ranger_columns(
                boxes, [method], options, size_model=load_curves(options.curves, options.region)
            )
    others = [method for method in box_methods() if not method.uses_size_model]
    measured |= ranger_columns(boxes, others, options, measured=measured)
    measured = {method.name: measured[method.name] for method in box_methods()}
    columns |= {**measured, "+".join(measured): fused_column(boxes, measured)}
    return {name: columns[name] for name in names}


def ranger_columns(
    boxes: BoxSet,
    listed: Sequence[RangingMethod],
    options: MethodOptions,
    *,
    size_model: SizeModel | None = None,
    measured: Mapping[str, MethodColumn] | None = None,
) -> dict[str, MethodColumn]:
    """Columns of methods that need only boxes, measured frame by frame as in a run, with new
    rangers for each sequence.

    With a size model, methods get the labels' classes instead of a detector's. `measured` are
    columns of methods measured before, which the listed methods may read. MethodError: a ranger of
    another package returned no ranges, or ranges of other tracks.
    """
    class_id = boxes.class_id
    if size_model is not None:
        class_id = np.array([SIZE_CLASSES.index(str(name)) for name in boxes.class_name], np.int64)
    columns = {method.name: _unmeasured(len(boxes)) for method in listed}
    rangers = _SequenceRangers({}, {})
    for rows, tracks, frame, is_first in as_frames(boxes, class_id):
        if is_first:
            context = MethodContext(
                camera=boxes.camera_at(rows[0]),
                size_model=size_model,
                box_sigma_px=options.box_sigma_px,
                camera_height_m=options.camera_height_m,
                region=options.region,
                has_images=False,
            )
            reads = {method.name: method.reads for method in listed}
            rangers = _SequenceRangers(create_rangers(context, listed), reads)
        before = {
            name: ranges_in_frame(column, tracks, rows) for name, column in (measured or {}).items()
        }
        for name, ranges in rangers.measure(tracks, frame, before).items():
            _store(columns[name], rows, ranges)
    return {name: _without_empty_systematic(column) for name, column in columns.items()}


class _SequenceRangers:
    """Rangers of one sequence with the scale of its drive; `reads` are the names of the methods
    that each reads.
    """

    def __init__(self, rangers: Mapping[str, Ranger], reads: Mapping[str, Collection[str]]) -> None:
        self._rangers, self._reads = rangers, reads
        self._scale = DriveScale()

    def measure(
        self, tracks: Tracks, frame: Frame, before: Mapping[str, Ranges]
    ) -> dict[str, Ranges]:
        """Ranges of the next frame, by name; `before` are those of methods measured before."""
        measured: dict[str, Ranges] = {}
        evidence: list[ScaleEvidence] = []
        for name, ranger in self._rangers.items():
            known = {**before, **measured}
            others = {other: known[other] for other in self._reads[name] if other in known}
            in_frame = ranger.measure_at_scale(tracks, frame, others, self._scale)
            if in_frame.evidence:
                evidence.append(in_frame.evidence)
            measured[name] = checked_ranges(name, in_frame.ranges, tracks)
        self._scale = self._scale.after(evidence, frame.time_s)
        return measured


def _unmeasured(n: int) -> MethodColumn:
    return MethodColumn(*np.full((3, n), np.nan))


def _store(column: MethodColumn, rows: IntArray, ranges: Ranges) -> None:
    """Store the ranges of a frame in the column's rows."""
    column.distance_m[rows], column.sigma_m[rows] = ranges.distance_m, ranges.sigma_m
    if column.sigma_systematic_m is not None and ranges.sigma_systematic_m is not None:
        column.sigma_systematic_m[rows] = ranges.sigma_systematic_m


def _without_empty_systematic(column: MethodColumn) -> MethodColumn:
    systematic_m = column.sigma_systematic_m
    if systematic_m is None or np.isfinite(systematic_m).any():
        return column
    return replace(column, sigma_systematic_m=None)


def fused_column(boxes: BoxSet, measured: Mapping[str, MethodColumn]) -> MethodColumn:
    """Fusion of the columns of several methods, frame by frame as in a run."""
    fused = MethodColumn(*np.full((2, len(boxes)), np.nan))
    fusion = Fusion()
    for rows, tracks, frame, is_first in as_frames(boxes, boxes.class_id):
        if is_first:
            fusion = Fusion()
        ranges = {name: ranges_in_frame(column, tracks, rows) for name, column in measured.items()}
        result = fusion.fuse(ranges, tracks.track_id, frame.time_s).ranges
        fused.distance_m[rows], fused.sigma_m[rows] = result.distance_m, result.sigma_m
    return fused


def ranges_in_frame(column: MethodColumn, tracks: Tracks, rows: IntArray) -> Ranges:
    """Ranges of the tracks of one frame, whose row indices are `rows`."""
    systematic_m = None if column.sigma_systematic_m is None else column.sigma_systematic_m[rows]
    return Ranges(tracks.track_id, column.distance_m[rows], column.sigma_m[rows], systematic_m)


def size_fitter(method: RangingMethod, options: MethodOptions) -> cross_validation.Fitter:
    """Fitter of a method that uses a size model, with priors fitted to the training boxes."""

    def fit(train: BoxSet) -> cross_validation.Predictor:
        try:
            model = in_region(fit_size_priors(train, source="cross-validation"), options.region)
        except CurveError:
            if options.is_held_out:
                raise
            return lambda boxes: MethodColumn(*np.full((2, len(boxes)), np.nan))
        return lambda boxes: ranger_columns(boxes, [method], options, size_model=model)[method.name]

    return fit


def as_frames(boxes: BoxSet, class_id: IntArray) -> Iterator[tuple[IntArray, Tracks, Frame, bool]]:
    """For each frame: row indices, tracks, blank image of the right size, and whether the frame
    starts a sequence.

    Labels without identities belong to separate images, each of which is a sequence.
    """
    sequence = -1
    for rows in frame_rows(boxes):
        n = len(rows)
        label_id = boxes.track_id[rows]
        is_image = bool((label_id < 0).any())
        track_id = np.arange(1, n + 1) if is_image else label_id + 1
        tracks = Tracks(
            track_id, boxes.xyxy_px[rows], class_id[rows], np.ones(n), np.ones(n, np.bool_)
        )
        width_px, height_px = boxes.size_px[rows[0]].tolist()
        blank = np.broadcast_to(np.zeros(1, np.uint8), (height_px, width_px, 3))
        frame = Frame(int(boxes.frame[rows[0]]), float(boxes.time_s[rows[0]]), blank, None)
        yield rows, tracks, frame, is_image or int(boxes.sequence[rows[0]]) != sequence
        sequence = int(boxes.sequence[rows[0]])
