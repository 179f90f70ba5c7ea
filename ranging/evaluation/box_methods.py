"""Methods on labelled boxes: registered ranging methods as in a run, plain curves, and fusions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.foundation.errors import UsageError
from track_range.ranging.evaluation.box_frames import (
    SequenceRangers,
    as_frames,
    ranges_in_frame,
    store,
    unmeasured,
    without_empty_systematic,
)
from track_range.ranging.evaluation.image_methods import MethodInputs, image_columns
from track_range.ranging.fitting import cross_validation
from track_range.ranging.fitting.prior_fit import fit_size_priors
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.methods.method import MethodContext, RangingMethod, Requirement
from track_range.ranging.registry import create_rangers, methods
from track_range.ranging.size_models.curve import CurveError, load_curves
from track_range.ranging.size_models.plain_curves import PLAIN_CURVES, within_range
from track_range.ranging.size_models.region import Region
from track_range.ranging.size_models.regions import in_region
from track_range.ranging.size_models.size_model import SIZE_CLASSES, SizeModel
from track_range.ranging.truth.errors import MethodColumn
from track_range.ranging.truth.labelled_boxes import BoxSet

_NO_INPUTS = MethodInputs()
# what a requirement of a method asks for; others are met by runs only
_OPTIONS: Mapping[Requirement, str] = {
    "image": "--images",
    "rig": "--images and --right-images",
    "right_image": "--images and --right-images",
    "dense_disparity": "--images and --right-images",
    "camera_height": "--camera-height",
}


def box_methods() -> tuple[RangingMethod, ...]:
    """The registered methods of distances that require only boxes and a camera."""
    return tuple(method for method in methods() if method.measures_distance and not method.needs)


def method_names(
    inputs: MethodInputs = _NO_INPUTS, camera_height_m: float | None = None
) -> tuple[str, ...]:
    """Names of all methods that can be measured, in the order of tables; the last ones are the
    fusion of the box methods and, with images, of all methods.
    """
    boxes = [method.name for method in box_methods()]
    available = inputs.available(camera_height_m)
    others = [
        method
        for method in methods()
        if method.measures_distance
        and method.needs
        and method.needs <= available
        and (method.name in inputs.networks or not method.is_optional)
    ]
    fused = [*boxes, *(method.name for method in others if method.fuses)]
    names = [*boxes, *(method.name for method in others)]
    return tuple(dict.fromkeys((*PLAIN_CURVES, *names, "+".join(boxes), "+".join(fused))))


def check_methods(
    names: Sequence[str], inputs: MethodInputs = _NO_INPUTS, camera_height_m: float | None = None
) -> None:
    """UsageError: a name is of no method of distances, or the method needs what is not given."""
    by_name = {method.name: method for method in methods() if method.measures_distance}
    available = inputs.available(camera_height_m)
    for name in names:
        for part in () if name in PLAIN_CURVES else name.split("+"):
            if part not in by_name:
                known = ", ".join((*PLAIN_CURVES, *by_name))
                raise UsageError(
                    f"--methods {part}: expected methods of distances from {known}, "
                    "joined by + for "
                    "their fusion, or package.module:OBJECT."
                )
            for need in sorted(by_name[part].needs - available):
                options = _OPTIONS.get(need)
                advice = f"; give {options}" if options else ", which only a run has"
                raise UsageError(f"--methods {part}: needs {need.replace('_', ' ')}{advice}.")


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
    names: Sequence[str],
    boxes: BoxSet,
    train: BoxSet,
    options: MethodOptions | None = None,
    inputs: MethodInputs = _NO_INPUTS,
) -> dict[str, MethodColumn]:
    """Distances and sigmas of N boxes, by method of `method_names`, or by several methods joined by
    +, which are fused.

    Curves are fitted to `train`: boxes of the same sequences, for example without noise. `inputs`
    are those of methods that need more than boxes; see `image_columns` for their errors.
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
    parts = {name: tuple(name.split("+")) for name in names if name not in columns}
    wanted = {part for of_name in parts.values() for part in of_name}
    others = [method for method in methods() if method.name in wanted and method.needs]
    if wanted - {method.name for method in others}:
        columns |= _box_columns(boxes, train, options)
    if others:
        columns |= _input_columns(boxes, others, options, inputs)
    for name, of_name in parts.items():
        if len(of_name) > 1:
            columns[name] = fused_column(boxes, {part: columns[part] for part in of_name})
    return {name: columns[name] for name in names}


def _box_columns(boxes: BoxSet, train: BoxSet, options: MethodOptions) -> dict[str, MethodColumn]:
    """Columns of all box methods; those with a size model are fitted according to `options`."""
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
    return {method.name: measured[method.name] for method in box_methods()}


def _input_columns(
    boxes: BoxSet, chosen: Sequence[RangingMethod], options: MethodOptions, inputs: MethodInputs
) -> dict[str, MethodColumn]:
    """Columns of methods that need more than boxes, which are measured together with the box
    methods, as in a run: these have the sizes of the curve file.
    """
    read = {name for method in chosen for name in method.reads}
    names = {method.name for method in (*chosen, *box_methods())}
    available = inputs.available(options.camera_height_m)
    listed = [
        method
        for method in methods()
        if method.name in names or (method.name in read and method.needs <= available)
    ]
    context = MethodContext(
        camera=boxes.camera_at(0),
        size_model=load_curves(options.curves, options.region),
        box_sigma_px=options.box_sigma_px,
        camera_height_m=options.camera_height_m,
        region=options.region,
        has_images=inputs.images is not None,
        has_dense_disparity="dense_disparity" in available,
        depth_models=inputs.depth_models,
        stereo_models=inputs.stereo_models,
    )
    return image_columns(boxes, listed, inputs, context, chosen=[method.name for method in chosen])


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
    columns = {method.name: unmeasured(len(boxes)) for method in listed}
    rangers = SequenceRangers({}, {})
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
            rangers = SequenceRangers(create_rangers(context, listed), reads)
        before = {
            name: ranges_in_frame(column, tracks, rows) for name, column in (measured or {}).items()
        }
        for name, ranges in rangers.measure(tracks, frame, before).items():
            store(columns[name], rows, ranges)
    return {name: without_empty_systematic(column) for name, column in columns.items()}


def fused_column(boxes: BoxSet, measured: Mapping[str, MethodColumn]) -> MethodColumn:
    """Fusion of the columns of several methods, frame by frame as in a run."""
    fused = MethodColumn(*np.full((2, len(boxes)), np.nan))
    fusion = Fusion(methods(measured))
    for rows, tracks, frame, is_first in as_frames(boxes, boxes.class_id):
        if is_first:
            fusion = Fusion(methods(measured))
        ranges = {name: ranges_in_frame(column, tracks, rows) for name, column in measured.items()}
        result = fusion.fuse(ranges, tracks.track_id, frame.time_s).ranges
        fused.distance_m[rows], fused.sigma_m[rows] = result.distance_m, result.sigma_m
    return fused


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
