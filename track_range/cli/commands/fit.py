"""`track-range fit`: fits size curves to labels and compares them; measures the errors of a
detector's boxes.
"""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np

from track_range.cli.shared.console import console, print_grid, print_line, print_notes
from track_range.cli.shared.parameters import command
from track_range.detection.box_errors import BoxError
from track_range.detection.catalogue.lookup import PACKAGED_FOLDER
from track_range.detection.evaluation.box_error_fit import (
    MIN_HEIGHT_PX,
    MIN_MATCHES,
    MIN_SCORE,
    BoxErrorSamples,
)
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.models.onnx_session import ModelError, Runtime
from track_range.evaluation.sequences.labelled_images import LabelledSource
from track_range.evaluation.sequences.settings import (
    LabelFormatField,
    LabelNamesField,
    ManifestField,
    SplitField,
)
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import counted
from track_range.foundation.files.output_files import write_text
from track_range.foundation.files.structured_text import read_yaml, yaml_text
from track_range.foundation.schemas.options import option
from track_range.ranging.fitting.fit import TABLE_DISTANCES_M, CurveFit, fit_sizes
from track_range.ranging.fitting.network_fit import FittedNetwork, factor_sigma
from track_range.ranging.fitting.settings import FitSettings
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.log_linear import SizeCurves
from track_range.ranging.size_models.plain_curves import TableSizes
from track_range.ranging.size_models.size_model import StoredSizeModel
from track_range.run.options.detection import SizeField, ThreadsField
from track_range.run.options.opened import DetectorOptions, class_names, open_detector
from track_range.run.progress import frame_progress, step_progress
from track_range.run.ready_model import ready_model
from track_range.views import tables

_MIN_DRIVES = 3  # of a spread that the sequences show, not what is known of networks


class FitOptions(FitSettings):
    """Options of `track-range fit`: of size curves, and of the measurement of a detector's
    boxes.
    """

    detector_boxes: Annotated[
        str | None,
        option(
            "Detector whose boxes are compared with the labels of --images, a file or a name from "
            "`track-range models list`. The mean errors of height and width by class are written "
            "to MODEL.yaml beside the model, for all later runs.",
            metavar="FILE|NAME",
        ),
    ] = None
    depth_model: Annotated[
        Path | None,
        option(
            "Depth network whose distances are compared with KITTI tracking labels (--labels, "
            "--calib) in their --images. Its factor in a drive, by class and track, its "
            "noise and its "
            "slope are written to MODEL.yaml beside the file, from which all later runs take them.",
            metavar="FILE.onnx",
        ),
    ] = None
    images: Annotated[
        Path | None,
        option(
            "Labelled images for --detector-boxes, not used for training, with YOLO, KITTI or COCO "
            "--labels: a folder, or the video of KITTI tracking labels. For "
            "--depth-model: a folder "
            "with the images or the video of each sequence, named like its labels.",
            metavar="DIR|FILE",
        ),
    ] = None
    label_format: LabelFormatField = None
    label_names: LabelNamesField = None
    manifest: ManifestField = None
    split: SplitField = "val"
    size_px: SizeField = None
    threads: ThreadsField = 0


def _fit_detector_boxes(options: FitOptions) -> None:
    if options.images is None or options.labels is None:
        raise UsageError(
            "--detector-boxes requires --images and --labels, the labelled images for "
            "the measurement."
        )
    path = ready_model(options.detector_boxes or "", console)
    out = options.out or path.with_suffix(".yaml")
    if options.out is None and path.parent == PACKAGED_FOLDER:
        raise UsageError(
            f"--detector-boxes {options.detector_boxes}: this is a packaged model; measure a copy, "
            "or give --out."
        )
    content = read_yaml(out, ModelError, "the attributes of a model") if out.is_file() else {}
    if not isinstance(content, dict) or not isinstance(content.setdefault("box_errors", {}), dict):
        raise ModelError(
            f"{out}: expected the attributes of a model, found other YAML; choose another --out."
        )
    detector = open_detector(
        path,
        DetectorOptions(min_score=str(MIN_SCORE), size_px=options.size_px, threads=options.threads),
    )
    source = LabelledSource(
        images=options.images,
        labels=options.labels,
        label_format=options.label_format,
        label_names=class_names(options.label_names),
        manifest=options.manifest,
        split=options.split,
    )
    frames = source.open()
    samples = BoxErrorSamples()
    with frame_progress(console, frames.n_images) as advance:
        for image, truth in frames:
            samples.add((image.shape[0], image.shape[1]), detector.detect(image), truth)
            advance()
    fits = samples.fit(is_drawn=source.format != "kitti")
    if not fits:
        raise LabelFileError(
            f"{options.labels}: expected at least {MIN_MATCHES} labels of one class that match a "
            f"box, are at least {MIN_HEIGHT_PX:g} px high, inside the image and not covered, in "
            f"{counted(samples.n_images, 'image')}; give more images of classes that the detector "
            "knows, and check --format and --label-names."
        )
    content["box_errors"] |= {name: list(error) for name, (error, _) in fits.items()}
    write_text(out, yaml_text(content, default_flow_style=None))
    print_grid(console, _box_error_grid(fits))
    notes = [
        "Logarithms of box / label: negative = boxes are too small. ± is the deviation to expect "
        "in another drive; it is larger for labels drawn around visible parts (all except "
        "KITTI's).",
        *(
            f"Skipped {counted(len(frames.unreadable), 'image')}; the first: {one}"
            for one in frames.unreadable[:1]
        ),
    ]
    print_notes(console, notes)
    print_line(console, f"Written: {out}")


def _box_error_grid(fits: Mapping[str, tuple[BoxError, int]]) -> tables.Grid:
    columns = [
        tables.Column(head, [error[k] for error, _ in fits.values()], scale=100)
        for k, head in enumerate(("height %", "± %", "width %", "± %"))
    ]
    columns.append(tables.Column("boxes", [float(n) for _, n in fits.values()], "{:.0f}"))
    return tables.grid_of("Systematic errors of the boxes", "class", list(fits), columns)


def _fit_depth_model(options: FitOptions, model: Path) -> None:
    if options.labels is None or options.calib is None or options.images is None:
        raise UsageError(
            "--depth-model requires --labels, --calib and --images: KITTI tracking labels of some "
            "sequences, and their images."
        )
    # onnxruntime takes long to import
    from track_range.evaluation.network_errors import fit_depth_model, write_errors

    network, fitted = fit_depth_model(
        model,
        options.labels,
        options.calib,
        options.images,
        leave_out=options.leave_out,
        runtime=Runtime(n_threads=options.threads),
        progress=partial(step_progress, console),
    )
    print_grid(console, *_depth_grids(fitted))
    notes = [
        "Factors are measured over labelled distances, ± the spread of drives, classes, tracks and "
        "frames. Left out: errors of a sequence after the mean factor of the others alone; a run "
        "also corrects the factor of its own drive.",
    ]
    if len(fitted.sequences) < _MIN_DRIVES:
        notes.append(
            f"With {counted(len(fitted.sequences), 'sequence')}, the spread between "
            "drives is mostly "
            "that of networks in general; give more sequences."
        )
    print_notes(console, notes)
    print_line(console, f"Written: {write_errors(network, fitted, options.out)}")


def _depth_grids(fitted: FittedNetwork) -> list[tables.Grid]:
    errors, drives = fitted.errors, fitted.sequences
    factors = {
        "drive": (errors.factor, errors.drive_sigma),
        **{name: (value, errors.class_sigma) for name, value in errors.class_factors.items()},
        "track": (None, errors.track_sigma),
        "frame": (None, errors.noise_sigma),
    }
    columns = [
        tables.Column("factor", [factor for factor, _ in factors.values()], "{:.3f}"),
        tables.Column("± %", [sigma for _, sigma in factors.values()], scale=100),
    ]
    scales = [drive.scale for drive in drives]
    of_drives = [
        tables.Column("boxes", [float(drive.n_boxes) for drive in drives], "{:.0f}"),
        tables.Column("factor", [math.exp(s.of_reference.mean) for s in scales], "{:.3f}"),
        tables.Column("± %", [factor_sigma(s) for s in scales], scale=100),
        tables.Column("slope", [s.slope.mean for s in scales], "{:.2f}"),
        tables.Column("track %", [s.track_sigma for s in scales], scale=100),
        tables.Column("frame %", [s.noise_sigma for s in scales], scale=100),
        tables.Column("left out %", _known([100 * d.left_out_error for d in drives])),
        tables.Column("within 1 sigma %", _known([100 * d.within[0] for d in drives]), "{:.0f}"),
        tables.Column("within 2 sigma %", _known([100 * d.within[1] for d in drives]), "{:.0f}"),
    ]
    title = f"Errors of the depth network (slope {errors.slope:.2f}; 1 = right)"
    return [
        tables.grid_of(title, "part", list(factors), columns),
        tables.grid_of("Sequences", "sequence", [drive.name for drive in drives], of_drives),
    ]


def _fit(settings: FitOptions) -> None:
    if settings.depth_model is not None:
        _fit_depth_model(settings, settings.depth_model)
        return
    if settings.detector_boxes is not None:
        _fit_detector_boxes(settings)
        return
    fitted = fit_sizes(settings)
    print_grid(console, *map(_comparison_grid, fitted.comparison.values()))
    if settings.picture is not None:
        # imports matplotlib: a third of a second
        from track_range.views.report.figures import curve_picture

        points = {
            name: fitted.boxes.select(fitted.boxes.class_name == name) for name in fitted.comparison
        }
        curve_picture(
            {
                name: (points[name].wh_over_f, points[name].distance_m, fitted.comparison[name])
                for name in points
            },
            settings.picture,
        )
        print_line(console, f"Written: {settings.picture}")
    if fitted.model is not None:
        print_grid(console, _model_grid(fitted.name, fitted.model))
        print_line(console, f"Written: {settings.out}")
    print_notes(console, fitted.notes)


def _comparison_grid(fits: Sequence[CurveFit]) -> tables.Grid:
    columns = [
        tables.Column("residual m2", [fit.residual_m2 for fit in fits], "{:.0f}", cost=abs),
        tables.Column("fitted %", [fit.fitted_error_pct for fit in fits], "{:.2f}", cost=abs),
        tables.Column(
            "other sequences %",
            _known([fit.other_drives_error_pct for fit in fits]),
            "{:.2f}",
            cost=abs,
        ),
    ]
    columns += [
        tables.Column(f"at {true_m:g} m", _known([fit.at_m[k] for fit in fits]))
        for k, true_m in enumerate(TABLE_DISTANCES_M)
    ]
    title = f"{fits[0].class_name}: {fits[0].n} boxes"
    return tables.grid_of(title, "curve", [fit.curve for fit in fits], columns)


def _known(values: Sequence[float]) -> list[float | None]:
    return [None if np.isnan(value) else value for value in values]


def _model_grid(name: str, model: StoredSizeModel) -> tables.Grid:
    if isinstance(model, CuboidSizes):
        return _prior_grid(model)
    if not isinstance(model, SizeCurves | TableSizes):
        raise TypeError(f"{name}: no table for {type(model).__name__}")
    curves = model.whole if isinstance(model, SizeCurves) else model.curves
    sigmas = [100 * curve.sigma_relative for curve in curves.values()]
    columns = [
        tables.Column(f"{tables.SIGMA} %", sigmas),
        tables.Column("boxes", [curve.n for curve in curves.values()], "{:.0f}"),
    ]
    if isinstance(model, SizeCurves):
        heads = ("intercept", "log height", "log width", "bearing")
        columns[:0] = [
            tables.Column(head, [curve.coefficients[k] for curve in model.whole.values()], "{:.3f}")
            for k, head in enumerate(heads)
        ]
    return tables.grid_of(f"Size curves: {name}", "class", list(curves), columns)


def _prior_grid(model: CuboidSizes) -> tables.Grid:
    priors = list(model.priors.values())
    columns = [
        tables.Column(f"{what} m", [prior.hwl_m[k] for prior in priors], "{:.2f}")
        for k, what in enumerate(("height", "width", "length"))
    ]
    columns += [
        tables.Column("height ± %", [100 * prior.log_sigma[0] for prior in priors]),
        tables.Column("objects", [prior.n_tracks for prior in priors], "{:.0f}"),
        tables.Column("boxes", [prior.n_boxes for prior in priors], "{:.0f}"),
    ]
    return tables.grid_of("Priors over sizes", "class", list(model.priors), columns)


app = command(FitOptions, _fit)
