"""The command line: its commands, and the handling of errors, which are printed as one sentence.

Exit status: 0 = success, 1 = an unusable input or output, or a run stopped by the user, 2 = wrong
usage.
"""

import errno
import os
import shlex
import sys
from collections.abc import MutableMapping
from typing import Annotated

import typer

from track_range.cli.shared.lazy import Lazy, lazy_app
from track_range.foundation.errors import UserError
from track_range.foundation.processes import owned_process
from track_range.foundation.schemas.keywords import flags_in_errors

PROGRAM = "track-range"

COMMANDS = {
    "run": Lazy(
        "track_range.cli.commands.run",
        "Track road users in one video or a stereo pair and measure their distances.",
        "The word 'run' may be omitted. Writes tracks.csv, mot.txt, tracks.parquet, overlay.mp4, "
        "report.html and summary.json.",
        (
            "track-range --stereo left.mp4 right.mp4 --rig rig.yaml",
            "track-range --mono dashcam.mp4 --focal-px 1150 --out drive-1",
            "track-range --stereo 0 1 --rig rig.yaml --show",
            "track-range --settings drive-1/settings.yaml",
        ),
    ),
    "fleet": Lazy(
        "track_range.cli.commands.fleet", "Process many recordings on the workers of a Ray cluster."
    ),
    "demo": Lazy(
        "track_range.cli.commands.demo",
        "Simulate a short stereo drive, process it, and print a summary.",
        examples=("track-range demo --out demo",),
    ),
    "report": Lazy(
        "track_range.cli.commands.report",
        "Rewrite the report of a run, or compare several runs on one page.",
        examples=(
            "track-range report drive-1",
            "track-range report drive-1 drive-2 --out comparison.html",
        ),
    ),
    "export": Lazy(
        "track_range.cli.commands.export",
        "Write a finished run or a label file in another format.",
        "Labels are written as kitti, coco, cvat, mot and yolo, runs in all formats of --to. An existing "
        "file is replaced only if it has this format.",
        (
            "track-range export drive-1 --to cvat --out drive-1.xml",
            "track-range export fixed.xml --to yolo --video drive.mp4 --images --out data",
        ),
    ),
    "convert": Lazy(
        "track_range.cli.commands.convert",
        "Bring a drive of another data set into the layout that the evaluations read.",
        "Data sets: av2, pandaset, kitti360, nuscenes, and waymo-like, a layout of plain tables. "
        "Writes boxes, distances, calibration, poses and speeds, and copies the images, if any.",
        (
            "track-range convert av2 adcf7d18-0510-35b0-a2fa-b4cea13a6d76 converted",
            "track-range convert nuscenes nuscenes/ converted --camera CAM_BACK",
        ),
    ),
    "surrogate": Lazy(
        "track_range.cli.commands.surrogate",
        "Print surrogate measures of safety of a run or a fleet, by class and road user.",
        "The measures are gap, headway, time to collision (TTC, TET, TIT), required deceleration "
        "(DRAC, MDRAC) and post-encroachment time.",
        (
            "track-range surrogate drive-1 --csv measures.csv",
            "track-range surrogate results --parquet measures.parquet",
        ),
    ),
    "view": Lazy(
        "track_range.cli.commands.view",
        "Show a finished run in the Rerun viewer.",
        "Shows video, bird's-eye view and plots. Writes run.rrd to the folder of the run unless "
        "the file exists. Requires the extra rerun.",
        ("track-range view drive-1", "track-range view drive-1 --web"),
    ),
    "calibrate": Lazy(
        "track_range.cli.commands.calibrate",
        "Calibrate a camera or a stereo pair from images of a board, or a camera from its drives.",
        "The board is a chessboard or a ChArUco board. Prints the residual of every view and the "
        "standard deviation of every parameter (jackknife over views). Without a board, the focal "
        "length, height and pitch of one camera are fitted to distances and sizes that you know, "
        "and to the road users in its video.",
        (
            "track-range calibrate --stereo 'left*.jpg' 'right*.jpg' --board 9x6 \\\n"
            "      --square-mm 40 --out rig.yaml",
            "track-range calibrate --mono boards/ --board charuco:11x8:30:22 --out rig.yaml",
            "track-range calibrate --mono drive.mp4 \\\n"
            "      --known-distance '3.2,610,340,702,415=12.4' --out rig.yaml",
        ),
    ),
    "rig": Lazy(
        "track_range.cli.commands.rig",
        "Show, check or convert calibration files (rig.yaml, KITTI, OpenCV, Kalibr).",
    ),
    "align": Lazy(
        "track_range.cli.commands.align",
        "Estimate the disparity error of a calibrated stereo pair.",
        "The error is estimated from drives past static objects, or from objects at known "
        "distances.",
        (
            "track-range align --stereo left.mp4 right.mp4 --rig rig.yaml --out align.yaml",
            "track-range align --reference kitti2015/ --out align.yaml",
        ),
    ),
    "track": Lazy(
        "track_range.cli.commands.track",
        "Track recorded detections, without a detector and without distances.",
        examples=(
            "track-range track MOT17/train --images MOT17/train --out tracks",
            "track-range track det.txt --tracker sort --out tracks",
        ),
    ),
    "evaluate": Lazy(
        "track_range.cli.commands.evaluate",
        "Evaluate tracks, distances, events, detectors or stereo matchers.",
    ),
    "check": Lazy(
        "track_range.cli.commands.evaluate.check",
        "Check limits of the figures of runs, such as accuracy, for continuous integration.",
        "Exit status: 0 = all limits hold, 1 = a limit is broken or a folder cannot be read, 2 = a "
        "limit that cannot be understood, or of an unknown figure. A figure that was not measured "
        "breaks its limit.",
        (
            "track-range check drive-track-range \\\n"
            "      --require 'fused.median_relative_error_pct < 5' \\\n"
            "      --require 'tracks.mota >= 80'",
            "track-range check drive-track-range --limits limits.yaml --junit check.xml",
        ),
    ),
    "fit": Lazy(
        "track_range.cli.commands.fit",
        "Fit the size curves of the mono method to labels from your camera, or the errors of a "
        "detector's boxes or a depth network.",
        examples=(
            "track-range fit --labels label_02/ --calib calib/ --out curves.json",
            "track-range fit --csv boxes.csv --focal-px 1150 --out curves.json",
            "track-range fit --detector-boxes net.onnx --images left.mp4 --labels label.txt",
        ),
    ),
    "models": Lazy(
        "track_range.cli.commands.models", "List, download, inspect, import and convert detectors."
    ),
    "train": Lazy(
        "track_range.cli.commands.training.train",
        "Train a detector on labelled images and export it as an ONNX file.",
        "The file can be used with --detector. Requires PyTorch.",
        (
            "track-range train --data data.yaml --epochs 100",
            "track-range train --data data.yaml --epochs 100 --resume",
        ),
    ),
    "anchors": Lazy(
        "track_range.cli.commands.training.train:anchors_app",
        "Fit anchors to the boxes of a data set (k-means++).",
        "Prints the anchors and their mean best IoU with the boxes, compared with the networks' "
        "default anchors.",
        ("track-range anchors --data data.yaml --size 640 --clusters 9",),
    ),
    "pseudo-label": Lazy(
        "track_range.cli.commands.training.pseudo_label",
        "Label training images with an ensemble of detectors, for `train`.",
        "The boxes of the detectors, in each image and its mirror image, are fused, and their "
        "scores are calibrated to probabilities on the completely labelled classes. Prints the "
        "lines for data.yaml.",
        (
            "track-range pseudo-label --data data.yaml --model yolov5n.onnx \\\n"
            "      --model picodet_s.onnx --out labels_soft",
        ),
    ),
    "simulate": Lazy(
        "track_range.cli.commands.simulate",
        "Simulate a stereo drive with exact ground truth, or labelled images.",
        "Labelled images can be used to train detectors.",
        (
            "track-range simulate --scenario highway --seconds 20 --out drive",
            "track-range simulate --images 500 --out images",
        ),
    ),
    "doctor": Lazy(
        "track_range.cli.commands.doctor",
        "Print versions, codecs and folders of the installation and test it, or print what is "
        "understood of a network.",
        "The test uses 1 s of simulated video. Include the output in bug reports. Exit status 1 = "
        "a check failed. With MODEL, prints the format, inputs, size and time of a "
        "depth network, stereo "
        "network or detector instead.",
        (
            "track-range doctor",
            "track-range doctor --json",
            "track-range doctor depth.onnx --image frame.png --focal-px 1150",
        ),
    ),
}

OVERVIEW = f"""\
{PROGRAM} tracks road users in videos and measures their distances.

Simulated drive:  {PROGRAM} demo
One camera:       {PROGRAM} --mono drive.mp4 --focal-px 1150
Two cameras:      {PROGRAM} --stereo left.mp4 right.mp4 --rig rig.yaml

Results are files in a folder: overlay.mp4, report.html, tracks.csv and others.
All commands and options:  {PROGRAM} --help
Options of one command:    {PROGRAM} COMMAND --help
Test of the installation:  {PROGRAM} doctor
"""

_ROOT_OPTIONS = ("--version", "--install-completion", "--show-completion")

app = lazy_app(
    COMMANDS,
    add_completion=True,
    pretty_exceptions_enable=False,
    help="Track every road user in a video and measure its distance, the uncertainty of the "
    "distance, its closing speed and its time to collision.",
    examples=(
        "track-range demo",
        "track-range --stereo left.mp4 right.mp4 --rig rig.yaml",
        "track-range --mono dashcam.mp4 --focal-px 1150",
    ),
)


@app.callback(invoke_without_command=True)
def _root(
    is_version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.")
    ] = False,
) -> None:
    if is_version:
        from importlib.metadata import version

        typer.echo(f"{PROGRAM} {version(PROGRAM)}")
        raise typer.Exit


@owned_process()
@flags_in_errors()
def main() -> None:
    """Entry point of `track-range`."""
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # track-range reports the problem itself
    _complete_as_run(os.environ)
    arguments = sys.argv[1:]
    if not arguments and "_TRACK_RANGE_COMPLETE" not in os.environ:
        _print_overview()
        return
    if arguments in (["-h"], ["--help"]):  # the name of the main command may be omitted
        app(["--help"], prog_name=PROGRAM, standalone_mode=False)
        arguments = ["run", "--help"]
    elif _is_run(arguments):
        arguments = ["run", *arguments]
    try:
        if arguments and arguments[0] not in COMMANDS:
            from track_range.cli.shared.bare_recordings import run_of_recordings

            arguments = run_of_recordings(arguments, PROGRAM)
        app(arguments, prog_name=PROGRAM)
    except SystemExit as ended:
        if arguments[:1] != ["run"]:  # whose notes these are among
            _print_plugin_notes()
        if ended.code != 130:  # the shell's status for Ctrl-C
            raise
        _print_error("stopped by the user.")
        raise SystemExit(1) from None
    except UserError as error:
        _print_error(str(error))
        _print_plugin_notes()
        raise SystemExit(error.exit_status) from None
    except Exception as error:
        _exit_if_full(error)
        error.add_note(_report_note(arguments))
        raise


def _report_note(arguments: list[str]) -> str:
    """Last line of the traceback of an unexpected error; addresses are without user names and
    passwords.
    """
    from track_range.recording.sources.live.address import LiveAddress

    shown = shlex.join(str(LiveAddress(argument)) for argument in arguments)
    return (
        f"{PROGRAM}: unexpected error; please report it in the project's issue tracker with these "
        f"lines, the output of `{PROGRAM} doctor` and the command: {PROGRAM} {shown}"
    )


def _print_overview() -> None:
    """Print the overview; a reader that ends early, such as `head`, is not an error."""
    try:
        typer.echo(OVERVIEW, nl=False)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the flush at exit
    except OSError as error:
        _exit_if_full(error)
        raise


def _exit_if_full(error: Exception) -> None:
    """Exit with one sentence if a full disk is the cause of the error."""
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        _print_error(f"{error.filename or 'output'}: no space left on the device; free some space.")
        raise SystemExit(1) from None


def _is_run(arguments: list[str]) -> bool:
    """Whether the arguments are options of `run`, given without its name."""
    return (
        bool(arguments)
        and arguments[0].startswith("-")
        and not arguments[0].startswith(_ROOT_OPTIONS)
    )


def _print_error(message: str) -> None:
    from rich.console import Console

    from track_range.foundation.files.input_files import printable

    # no emoji: ":X:" may be a part of the user's text
    Console(stderr=True, emoji=False).print(
        f"{PROGRAM}: {printable(message)}",
        style="red",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


def _print_plugin_notes() -> None:
    """Print what other packages were to add to this command, and cannot."""
    from track_range.foundation.registry import plugin_notes

    for note in plugin_notes():
        _print_error(note)


def _complete_as_run(environment: MutableMapping[str, str]) -> None:
    """Insert `run` into the command line that a shell completes, where its options are given
    without its name.
    """
    for variable in ("COMP_WORDS", "_TYPER_COMPLETE_ARGS"):  # bash, and the other shells
        program, *words = environment.get(variable, "").split(maxsplit=1) or [""]
        if f"_{PROGRAM.replace('-', '_').upper()}_COMPLETE" in environment and _is_run(
            "".join(words).split()
        ):
            environment[variable] = f"{program} run {words[0]}"
            if "COMP_CWORD" in environment:
                environment["COMP_CWORD"] = str(int(environment["COMP_CWORD"]) + 1)
