"""The commands about detectors, `models ...` and `evaluate ...`, as the command line shows them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from track_range.commands.evaluate import evaluate_source, keep_figures, open_candidates, tell_figures
from track_range.commands.evaluate_stereo import DEFAULT_MATCHERS, StereoTest, evaluate_stereo
from track_range.commands.evaluate_tracks import Comparison, TruthFormat, evaluate_track_files, keep_track_figures
from track_range.commands.model_files import import_model, list_models, pull_model
from track_range.commands.models import tell_model
from track_range.commands.quantize import quantize_model
from track_range.detection.formats.labelled_images import LabelFormat
from track_range.detection.models.onnx_session import Device
from track_range.detection.yolo.input_format import LETTERBOXES
from track_range.run.detector_options import DetectorOptions, class_names
from track_range.sequences.labelled_images import LabelledSource
from track_range.stereo.matching.box_matchers import MATCHER_NAMES

evaluation = typer.Typer(no_args_is_help=True, help="Measure against labels of your own.")
models = typer.Typer(no_args_is_help=True, help="Detectors: what a file holds, which can be fetched, and making them.")

_console = Console()

NamesOption = Annotated[str | None, typer.Option(help="The network's class names, a,b,c or a file with one per line.")]
AnchorsOption = Annotated[
    str | None,
    typer.Option(metavar="'W,H ... / W,H ...'", help="Anchors of raw YOLO heads, a group per output."),
]
LetterboxOption = Annotated[
    str | None, typer.Option(metavar="WORD", help=f"How the network wants images: {LETTERBOXES}.")
]

SizeOption = Annotated[
    int | None,
    typer.Option(
        metavar="PX",
        min=32,
        max=4096,
        help="Network input's longer side, if free (default: the model's own, else 640).",
    ),
]
ThreadsOption = Annotated[int, typer.Option(metavar="N", min=0, max=256, help="Threads of the network; 0 = all.")]
DeviceOption = Annotated[Device, typer.Option(help="Where it runs.")]

FormatOption = Annotated[
    LabelFormat | None,
    typer.Option("--format", help="Of the labels (default: KITTI for a video, COCO for a .json file, else YOLO)."),
]
LabelNamesOption = Annotated[
    str | None,
    typer.Option(
        help="Class names of YOLO's numbers, a,b,c or a file (default: classes.txt or data.yaml beside the labels, "
        "else the 8 road classes)."
    ),
]
ManifestOption = Annotated[
    Path | None,
    typer.Option(help="CSV with columns file, split, labels_complete (8 flags): which images, and what counts."),
]
SplitOption = Annotated[str, typer.Option(help="Of the manifest.")]
JsonOption = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the figures here too.")]


@models.command("info", help="Say what a model file is, what is taken for granted of it, and what it can see.")
def _info(
    model: Annotated[str, typer.Argument(metavar="FILE|NAME", help="An ONNX file, or a name of `models list`.")],
    names: NamesOption = None,
    anchors: AnchorsOption = None,
    letterbox: LetterboxOption = None,
) -> None:
    tell_model(model, DetectorOptions(names=names, anchors=anchors, letterbox=letterbox), _console)


@models.command("list", help="Detectors that can be fetched or are here, with their licences.")
def _list() -> None:
    list_models(_console)


@models.command("pull", help="Fetch a detector from its own project's release into the cache folder, and check it.")
def _pull(name: Annotated[str, typer.Argument(metavar="NAME", help="A name of `models list`.")]) -> None:
    pull_model(name, _console)


@models.command("import", help="Turn a Darknet network (cfg and weights) into an ONNX file.")
def _import(
    cfg: Annotated[Path, typer.Argument(metavar="FILE.cfg")],
    weights: Annotated[Path, typer.Argument(metavar="FILE.weights")],
    names: Annotated[str, typer.Option(help="Class names: a,b,c or a file with one per line, such as coco.names.")],
    out: Annotated[Path, typer.Option(help="The ONNX file to write.")],
) -> None:
    import_model(cfg, weights, out, names=names, console=_console)


@models.command("quantize", help="Write INT8 and FP16 copies of a detector, and compare size, speed and accuracy.")
def _quantize(
    model: Annotated[str, typer.Argument(metavar="FILE|NAME", help="A float32 network.")],
    images: Annotated[Path, typer.Option(help="Folder of images such as the network will see: 60 are used.")],
    out: Annotated[Path | None, typer.Option(help="Folder of the copies (default: this one).")] = None,
    labels: Annotated[
        Path | None,
        typer.Option(help="Labels of the images; without, the copies are compared with the original's own boxes."),
    ] = None,
    label_format: FormatOption = None,
    label_names: LabelNamesOption = None,
    manifest: ManifestOption = None,
    split: SplitOption = "val",
    names: NamesOption = None,
    anchors: AnchorsOption = None,
    letterbox: LetterboxOption = None,
    size: SizeOption = None,
    threads: ThreadsOption = 0,
    json_file: JsonOption = None,
) -> None:
    options = DetectorOptions(
        names=names, anchors=anchors, letterbox=letterbox, size_px=size, threads=threads, device="cpu"
    )
    source = None
    if labels is not None:
        source = LabelledSource(
            images=images,
            labels=labels,
            label_format=label_format,
            label_names=class_names(label_names),
            manifest=manifest,
            split=split,
        )
    figures = quantize_model(model, images, out or Path(), source=source, options=options, console=_console)
    keep_figures(figures, json_file)
    raise typer.Exit(0 if figures["is_complete"] else 1)


@evaluation.command("tracks", help="HOTA, MOTA, IDF1 and their kin of tracks, by KITTI's or MOTChallenge's rules.")
def _tracks(
    truth: Annotated[Path, typer.Option(help="Ground truth: a file, or a folder of sequences (NAME.txt or NAME/gt).")],
    results: Annotated[
        Path, typer.Option(help="Tracks: MOT or KITTI rows, NAME.txt per sequence, or what `track` wrote.")
    ],
    truth_format: Annotated[
        TruthFormat | None, typer.Option("--format", help="Of the truth (default: told by its first line).")
    ] = None,
    road_class: Annotated[
        str | None, typer.Option("--class", metavar="NAME", help="KITTI: car (default), person or bicycle.")
    ] = None,
    compare: Annotated[
        Comparison | None, typer.Option(help="Also show this package's figures for the same boxes, and what differs.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    figures = evaluate_track_files(
        truth, results, truth_format=truth_format, road_class=road_class, console=_console, compare=compare
    )
    keep_track_figures(figures, json_file)


@evaluation.command("stereo", help="Distance error of stereo matchers on pairs with true disparities, side by side.")
def _stereo(
    pairs: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="KITTI 2015's image_2, image_3, disp_occ_0, obj_map and calib.txt, or a drive's left.mp4, right.mp4, "
            "rig.yaml and truth.csv or truth.txt.",
        ),
    ],
    rig: Annotated[Path | None, typer.Option(help="Rig file (default: the folder's own).")] = None,
    matcher: Annotated[
        str, typer.Option(metavar="A,B,...", help=f"Of: {', '.join(MATCHER_NAMES)}.")
    ] = DEFAULT_MATCHERS,
    align: Annotated[
        str,
        typer.Option(
            metavar="FILE|off|leave-two-out",
            help="What puts disparities right: align.yaml, nothing, or a fit on all pairs but two at a time.",
        ),
    ] = "off",
    seed: Annotated[int, typer.Option(min=0, help="Of the intervals.")] = 0,
    json_file: JsonOption = None,
) -> None:
    test = StereoTest(pairs=pairs, rig=rig, matchers=tuple(matcher.split(",")), align=align, seed=seed)
    keep_track_figures(evaluate_stereo(test, console=_console), json_file)


@evaluation.command("detections", help="Average precision and speed of detectors on labelled images, side by side.")
def _detections(
    model: Annotated[list[str], typer.Option(metavar="FILE|NAME", help="A detector; give it again for another.")],
    images: Annotated[Path, typer.Option(help="Folder of images, or a video.")],
    labels: Annotated[Path, typer.Option(help="Their labels: a folder, or one COCO or KITTI tracking file.")],
    label_format: FormatOption = None,
    label_names: LabelNamesOption = None,
    manifest: ManifestOption = None,
    split: SplitOption = "val",
    classes: Annotated[
        str | None, typer.Option(metavar="A,B,...", help="Road classes to measure (default: all).")
    ] = None,
    min_height: Annotated[
        float, typer.Option(metavar="PX", min=0.0, help="Lower objects are neither right nor wrong to find.")
    ] = 0.0,
    min_score: Annotated[
        str | None,
        typer.Option(metavar="S[,CLASS=S...]", help="Working score, for precision and recall (default: 0.25)."),
    ] = None,
    names: NamesOption = None,
    anchors: AnchorsOption = None,
    letterbox: LetterboxOption = None,
    size: SizeOption = None,
    threads: ThreadsOption = 0,
    device: DeviceOption = "auto",
    json_file: JsonOption = None,
) -> None:
    options = DetectorOptions(
        names=names,
        anchors=anchors,
        letterbox=letterbox,
        size_px=size,
        threads=threads,
        device=device,
    )
    source = LabelledSource(
        images=images,
        labels=labels,
        label_format=label_format,
        label_names=class_names(label_names),
        manifest=manifest,
        split=split,
        classes=tuple(classes.split(",")) if classes else (),
    )
    candidates = open_candidates(model, options, _console)
    figures = evaluate_source(candidates, source, min_score=min_score, console=_console, min_height_px=min_height)
    tell_figures(figures, _console)
    keep_figures(figures, json_file)
    raise typer.Exit(0 if figures["is_complete"] else 1)
