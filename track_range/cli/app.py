"""The command line: commands, and errors as one sentence.

Exit status: 0 done, 1 an input or output that cannot be used (or the user stopped the run), 2 wrong usage.
"""

from __future__ import annotations

import os
import sys
from collections.abc import MutableMapping
from typing import Annotated

import typer

from track_range.cli.lazy import Lazy, lazy_app
from track_range.foundation.errors import UserError

PROGRAM = "track-range"

COMMANDS = {
    "calibrate": Lazy(
        "track_range.cli.calibrate",
        "Calibrate a camera, or a pair of them, from images of a chessboard or ChArUco board.",
    ),
    "rig": Lazy("track_range.cli.rig", "Calibration files: track-range's own, KITTI's, OpenCV's, Kalibr's."),
    "align": Lazy(
        "track_range.cli.align",
        "Measure the disparity error of a calibrated pair, from a drive or from known distances.",
    ),
    "run": Lazy("track_range.cli.run", "Track and range one video, or a stereo pair (the word 'run' may be left out)."),
    "report": Lazy(
        "track_range.cli.report",
        "Rewrite a run's report.html from its folder; with several folders compare the runs side by side.",
    ),
    "track": Lazy("track_range.cli.track", "Track recorded detections: identities without distances or a video."),
    "evaluate": Lazy("track_range.cli.evaluate", "Evaluation against your own labels."),
    "fit": Lazy("track_range.cli.fit", "Fit the monocular size curves to labels of your own camera."),
    "models": Lazy("track_range.cli.models", "Detectors: inspect, list, download, import and quantize them."),
    "train": Lazy(
        "track_range.cli.training.train",
        "Train a detector on labelled images, and export it as an ONNX file for --detector.",
    ),
    "anchors": Lazy(
        "track_range.cli.training.anchors",
        "Print anchors fitted to the boxes of a data set (k-means++), and how well they fit.",
    ),
    "simulate": Lazy(
        "track_range.cli.simulate", "Simulate a stereo drive with exact truth, or labelled images to train a detector."
    ),
    "demo": Lazy("track_range.cli.demo", "Simulate a short stereo drive, run on it, and print the tables."),
}

_ROOT_OPTIONS = ("--version", "--install-completion", "--show-completion")

app = lazy_app(
    COMMANDS,
    add_completion=True,
    pretty_exceptions_enable=False,
    help="Track every road user in a video and measure its distance with uncertainty, its closing speed and its time "
    "to collision.",
    epilog="Examples: track-range --stereo left.mp4 right.mp4 --rig rig.yaml  |  "
    "track-range --mono dashcam.mp4 --focal-px 1150 --detector yolov5n.onnx  |  track-range demo",
)


@app.callback(invoke_without_command=True)
def _root(
    is_version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if is_version:
        from importlib.metadata import version

        typer.echo(f"{PROGRAM} {version(PROGRAM)}")
        raise typer.Exit


def main() -> None:
    """Entry point of `track-range`."""
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # our own sentence names the problem
    _complete_as_run(os.environ)
    arguments = sys.argv[1:]
    if arguments in ([], ["-h"], ["--help"]):  # the main command needs no name
        app(["--help"], prog_name=PROGRAM, standalone_mode=False)
        arguments = ["run", "--help"]
    elif _is_run(arguments):
        arguments = ["run", *arguments]
    try:
        app(arguments, prog_name=PROGRAM)
    except SystemExit as ended:
        if ended.code != 130:  # the shell's status for Ctrl-C
            raise
        _print_error("stopped by the user.")
        raise SystemExit(1) from None
    except UserError as error:
        _print_error(str(error))
        raise SystemExit(error.exit_status) from None


def _is_run(arguments: list[str]) -> bool:
    """Whether arguments are options of `run` without its name."""
    return bool(arguments) and arguments[0].startswith("-") and not arguments[0].startswith(_ROOT_OPTIONS)


def _print_error(message: str) -> None:
    from rich.console import Console

    # no emoji: ":X:" may be a part of the user's text
    Console(stderr=True, emoji=False).print(
        f"{PROGRAM}: {message}", style="red", highlight=False, markup=False, soft_wrap=True
    )


def _complete_as_run(environment: MutableMapping[str, str]) -> None:
    """In the words that a shell wants completed, put `run` before options of it that stand without its name."""
    for variable in ("COMP_WORDS", "_TYPER_COMPLETE_ARGS"):  # bash, and the other shells
        program, *words = environment.get(variable, "").split(maxsplit=1) or [""]
        if f"_{PROGRAM.replace('-', '_').upper()}_COMPLETE" in environment and _is_run("".join(words).split()):
            environment[variable] = f"{program} run {words[0]}"
            if "COMP_CWORD" in environment:
                environment["COMP_CWORD"] = str(int(environment["COMP_CWORD"]) + 1)
