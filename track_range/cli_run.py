"""The main job's options, as the command line shows them."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from track_range.commands.run import run as run_video
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.csv_labels import NEEDED, OPTIONAL
from track_range.detection.yolo.input_format import LETTERBOXES
from track_range.live_view.view import open_view
from track_range.run.settings import settings_from

_console = Console()
_INPUT, _WHAT, _HOW = "Input", "What to look at", "How to run"


def run(
    stereo: Annotated[
        tuple[str, str] | None,
        typer.Option(
            metavar="LEFT RIGHT",
            help="Two videos, folders of numbered images, cameras (0 1) or streams (rtsp://...).",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    mono: Annotated[
        str | None,
        typer.Option(metavar="VIDEO", help="The video of one camera, or a camera or stream.", rich_help_panel=_INPUT),
    ] = None,
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
        Path | None,
        typer.Option(
            metavar="FILE",
            help="What to measure against: KITTI tracking labels, or a CSV (of lidar or radar, say) with the columns "
            f"{','.join(NEEDED)}, and, if known, {','.join(OPTIONAL)}; others are passed over.",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(help="Repeat a run from its settings.yaml; other options win over it.", rich_help_panel=_INPUT),
    ] = None,
    ego_speed: Annotated[
        str | None,
        typer.Option(
            metavar="KMH|FILE|DIR",
            help="How fast the camera moves: km/h, a CSV of time_s and speed_mps or speed_kmh, or KITTI's oxts folder.",
            rich_help_panel=_INPUT,
        ),
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
    table: Annotated[
        Path | None,
        typer.Option(metavar="FILE.md", help="Write the tables here too, as Markdown.", rich_help_panel=_HOW),
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
    overlay_side: Annotated[
        bool | None,
        typer.Option(
            "--overlay-side/--no-overlay-side",
            help="Below the overlay the same frame in the colours of dense stereo's disparities.",
            rich_help_panel=_HOW,
        ),
    ] = None,
    show: Annotated[
        bool, typer.Option("--show", help="Watch the overlay in a browser while it runs.", rich_help_panel=_HOW)
    ] = False,
    serve: Annotated[
        str | None,
        typer.Option(
            metavar="PORT|HOST:PORT",
            help="Serve that view on this machine's port, or where other machines see it.",
            rich_help_panel=_HOW,
        ),
    ] = None,
    lanes: Annotated[
        str | None,
        typer.Option(
            metavar="classical|off|FILE",
            help="The own lane's lines, for distances by its width: by edges (default), or by a lane network (ONNX).",
            rich_help_panel=_HOW,
        ),
    ] = None,
    lane_width_m: Annotated[
        float | None,
        typer.Option(metavar="M", help="Width of a lane (default: 3.5); stereo corrects it.", rich_help_panel=_HOW),
    ] = None,
    camera_height_m: Annotated[
        float | None,
        typer.Option(metavar="M", help="Of the camera above the road (default: estimated).", rich_help_panel=_HOW),
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
            metavar="NAME|MODULE:CLASS",
            help="deepsort, the default, compares appearance too; sort does not; or a tracker of your own.",
            rich_help_panel=_HOW,
        ),
    ] = None,
    reid: Annotated[
        Path | None,
        typer.Option(
            help="A re-identification network (ONNX) for appearance (default: a built-in description of colours).",
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
    """Track and range one video, or a stereo pair (the word 'run' may be left out)."""
    given: dict[str, Any] = dict(locals())
    given["classes"] = tuple(classes.split(",")) if classes else None
    for option, field in (("start", "start_s"), ("duration", "duration_s"), ("size", "size_px")):
        given[field] = given.pop(option)
    for option in ("settings", "show", "serve"):  # what a run is watched by is no setting of it
        del given[option]
    wanted = settings_from(given, settings)
    with open_view(show=show, serve=serve) or nullcontext() as view:
        run_video(wanted, _console, view)
