"""The command line: commands, options, and errors as one sentence.

Exit status: 0 done, 1 an input or output that cannot be used (or the user stopped the run), 2 wrong usage.
"""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import cv2
import typer
from rich.console import Console

from detection.classes import ROAD_CLASSES, ClassNameError
from detection.download import DownloadError
from detection.input_format import LETTERBOXES
from detection.kitti_format import LabelFileError
from detection.labelled_images import ImageFileError
from detection.onnx_session import ModelError
from detection.training.errors import TrainingError
from ranging.size_curve import CurveError
from stereo.kitti_2015 import PairFileError
from stereo.rig import RigError
from track_range.cli_alignment import align
from track_range.cli_calibration import calibrate, rig
from track_range.cli_models import evaluation, models
from track_range.cli_tracking import track
from track_range.cli_training import anchors, simulate, train
from track_range.commands.demo import demo as run_demo
from track_range.commands.fit import fit_curves_of_kitti
from track_range.commands.run import RunStoppedError
from track_range.commands.run import run as run_video
from track_range.config import ConfigError, UsageError, settings_from
from track_range.video import VideoError
from track_range.written import OutputError
from tracking.mot_format import MotFormatError

USER_ERRORS = (
    ClassNameError,
    ConfigError,
    CurveError,
    DownloadError,
    ImageFileError,
    LabelFileError,
    ModelError,
    MotFormatError,
    OutputError,
    PairFileError,
    RigError,
    RunStoppedError,
    TrainingError,
    VideoError,
)
"""Everything that a user's input can cause; anything else is our bug and keeps its traceback."""

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Track every road user in a video and say how far it is, how sure that is, and how fast it closes.",
    epilog="Examples: track-range --stereo left.mp4 right.mp4 --rig rig.yaml  |  "
    "track-range --mono dashcam.mp4 --focal-px 1150 --detector yolov5n.onnx  |  track-range demo",
)

app.add_typer(models, name="models")
app.add_typer(evaluation, name="evaluate")
app.add_typer(rig, name="rig")
app.command("calibrate")(calibrate)
app.command("align")(align)
app.command("track")(track)
app.command("train")(train)
app.command("anchors")(anchors)
app.command("simulate")(simulate)

_console = Console()
_INPUT, _WHAT, _HOW = "Input", "What to look at", "How to run"


@app.callback(invoke_without_command=True)
def _root(
    is_version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if is_version:
        typer.echo(f"track-range {version('track-range')}")
        raise typer.Exit


@app.command("run", help="Track and range one video, or a stereo pair (the word 'run' may be left out).")
def _run(
    stereo: Annotated[
        tuple[Path, Path] | None,
        typer.Option(metavar="LEFT RIGHT", help="Two videos, or folders of numbered images.", rich_help_panel=_INPUT),
    ] = None,
    mono: Annotated[Path | None, typer.Option(help="The video of one camera.", rich_help_panel=_INPUT)] = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            help="rig.yaml, KITTI's calib.txt, or OpenCV's stereo calibration. Without it, rig.yaml or calib.txt "
            "beside the left video is used; two cameras without any give uncalibrated distances.",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    focal_px: Annotated[
        float | None,
        typer.Option(help="Focal length in pixels, where there is no rig file.", rich_help_panel=_INPUT),
    ] = None,
    detector: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|NAME",
            help="A YOLO network: an ONNX file, or a name of `models list` (default: road, the packaged one).",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    names: Annotated[
        str | None,
        typer.Option(help="The network's class names, a,b,c or a file with one per line.", rich_help_panel=_INPUT),
    ] = None,
    anchors: Annotated[
        str | None,
        typer.Option(
            metavar="'W,H ... / W,H ...'",
            help="Anchors of raw YOLO heads, a group per output (default: the model's own, or YOLOv4-tiny's).",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    letterbox: Annotated[
        str | None,
        typer.Option(
            metavar="WORD",
            help=f"How the network wants images: {LETTERBOXES} (default: as its family does).",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    detections: Annotated[
        Path | None,
        typer.Option(
            help="Boxes of your own detector: MOT det.txt, KITTI labels or detections, or a tracks.csv.",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    curves: Annotated[
        Path | None,
        typer.Option(
            help="Size curves for the monocular distance, made by `track-range fit` (default: the packaged ones).",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    truth: Annotated[
        Path | None, typer.Option(help="KITTI tracking labels to measure against.", rich_help_panel=_INPUT)
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(help="Repeat a run from its settings.yaml; other options win over it.", rich_help_panel=_INPUT),
    ] = None,
    folder_fps: Annotated[
        float | None, typer.Option(help="Frame rate of folders of images (default: 10).", rich_help_panel=_INPUT)
    ] = None,
    classes: Annotated[
        str | None,
        typer.Option(metavar="A,B,...", help=f"Of: {', '.join(ROAD_CLASSES)} (default: all).", rich_help_panel=_WHAT),
    ] = None,
    min_score: Annotated[
        str | None,
        typer.Option(
            metavar="S[,CLASS=S...]",
            help="Weakest boxes taken from the detector, such as 0.1,car=0.3 (default: 0.1).",
            rich_help_panel=_WHAT,
        ),
    ] = None,
    start: Annotated[float | None, typer.Option(metavar="S", help="Start, in seconds.", rich_help_panel=_WHAT)] = None,
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="Stop after so many seconds.", rich_help_panel=_WHAT)
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Results (default: LEFT-track-range, in this folder).", rich_help_panel=_HOW),
    ] = None,
    overlay: Annotated[
        bool | None, typer.Option("--overlay/--no-overlay", help="Write overlay.mp4.", rich_help_panel=_HOW)
    ] = None,
    sgbm: Annotated[
        bool | None,
        typer.Option("--sgbm/--no-sgbm", help="Dense stereo beside the patch matcher (slow).", rich_help_panel=_HOW),
    ] = None,
    align: Annotated[
        str | None,
        typer.Option(
            metavar="auto|off|FILE",
            help="Correction of the disparities: estimated from the drive (default), none, or what `align` wrote.",
            rich_help_panel=_HOW,
        ),
    ] = None,
    disparity: Annotated[
        bool | None,
        typer.Option("--disparity/--no-disparity", help="Write disparity.mp4, dense stereo's.", rich_help_panel=_HOW),
    ] = None,
    size: Annotated[
        int | None,
        typer.Option(
            metavar="PX",
            help="Network input's longer side, if free (default: the model's own, else 640).",
            rich_help_panel=_HOW,
        ),
    ] = None,
    tracker: Annotated[
        str | None,
        typer.Option(
            metavar="deepsort|sort",
            help="deepsort, the default, tells boxes apart by their looks too; sort does not.",
            rich_help_panel=_HOW,
        ),
    ] = None,
    reid: Annotated[
        Path | None,
        typer.Option(
            help="A re-identification network (ONNX) for looks (default: a built-in description of colours).",
            rich_help_panel=_HOW,
        ),
    ] = None,
    threads: Annotated[
        int | None, typer.Option(metavar="N", help="Threads of the network (default: all).", rich_help_panel=_HOW)
    ] = None,
    device: Annotated[
        str | None, typer.Option(metavar="auto|cpu|cuda|tensorrt", help="Where it runs.", rich_help_panel=_HOW)
    ] = None,
) -> None:
    given: dict[str, Any] = dict(locals())
    given["classes"] = tuple(classes.split(",")) if classes else None
    for option, field in (("start", "start_s"), ("duration", "duration_s"), ("size", "size_px")):
        given[field] = given.pop(option)
    del given["settings"]
    run_video(settings_from(given, settings), _console)


@app.command("demo", help="Simulate a short stereo drive, run the main job on it, and print the tables.")
def _demo(
    out: Annotated[Path, typer.Option(help="Where the drive and the results go.")] = Path("track-range-demo"),
    seed: Annotated[int, typer.Option(min=0, help="Another seed is another drive.")] = 0,
    seconds: Annotated[float, typer.Option(min=0.5, max=60, help="Length of the drive.")] = 6.0,
    playback: Annotated[
        bool,
        typer.Option("--playback", help="Boxes from the truth, jittered, in place of the packaged detector's."),
    ] = False,
) -> None:
    run_demo(out, _console, seed=seed, seconds=seconds, is_played_back=playback)


@app.command("fit", help="Fit the monocular size curves on KITTI tracking labels of your own camera.")
def _fit(
    labels: Annotated[Path, typer.Option(help="Folder of label files, one per sequence.")],
    calib: Annotated[Path, typer.Option(help="Folder of calib files of the same names.")],
    out: Annotated[Path, typer.Option(help="The curve file to write.")],
    leave_out: Annotated[str, typer.Option(help="Sequences kept for testing, such as 0005,0009.")] = "",
    source: Annotated[str, typer.Option(help="What the labels are; kept in the file.")] = "",
) -> None:
    fit_curves_of_kitti(labels, calib, out, console=_console, leave_out=leave_out, source=source)


def main() -> None:
    """Entry point of `track-range`."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # our own sentence says what is wrong
    arguments = sys.argv[1:]
    if arguments in ([], ["-h"], ["--help"]):  # the main job needs no command word
        app(["--help"], standalone_mode=False)
        arguments = ["run", "--help"]
    elif arguments and arguments[0].startswith("-") and arguments[0] != "--version":
        arguments = ["run", *arguments]
    try:
        app(arguments)
    except SystemExit as ended:
        if ended.code != 130:  # the shell's word for Ctrl-C
            raise
        Console(stderr=True).print("track-range: stopped by the user.", style="red")
        raise SystemExit(1) from None
    except USER_ERRORS as error:
        told = Console(stderr=True)
        told.print(f"track-range: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        raise SystemExit(2 if isinstance(error, UsageError) else 1) from None
