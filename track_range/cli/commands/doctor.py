"""`track-range doctor`: versions, devices, codecs and folders of this installation, and a short run
as a test; or what is understood of a network.
"""

from __future__ import annotations

import json
import math
import os
import platform
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib import import_module
from importlib.metadata import requires
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, get_args

import numpy as np

from track_range.cli.shared.console import console, print_line
from track_range.cli.shared.parameters import command
from track_range.detection.models.devices import Device
from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import ConfigError, UsageError, UserError
from track_range.foundation.files.images import read_image
from track_range.foundation.installed import conflicts, installed_versions
from track_range.foundation.processes import n_usable_cores
from track_range.foundation.schemas.options import Options, option
from track_range.foundation.schemas.validation import PositiveNumber

if TYPE_CHECKING:  # the simulation takes long to import
    from track_range.simulation.drive import Drive

PACKAGES = (
    *(
        "track-range",
        "numpy",
        "opencv-python-headless",
        "onnxruntime",
        "onnx",
        "av",
        "scipy",
        "pyarrow",
        "pydantic",
    ),
    *("typer", "rich", "jinja2", "matplotlib"),
)
ENCODERS = ("libx264",)  # those that track-range needs
# of common videos; a run needs only that of its input
DECODERS = ("h264", "hevc", "av1", "vp9", "mpeg4", "mjpeg")
MIN_FREE_BYTES = 500_000_000  # results of an hour of 1242x375 px take about this much
# the short run finds 4 tracks with a median error of 0.3 %
MIN_TRACKS, MAX_MEDIAN_ERROR_PCT = 2, 5.0
# runs of a device that are timed, and minimum score of the boxes that are compared
N_TIMED, CLEAR_SCORE = 7, 0.5
# of a device's boxes in px and score: INT8 and float differ by 1.5 and 0.05
MAX_DIFFERENCES = 3.0, 0.1
OK, _NOT_INSTALLED = "ok", "not installed"
_EXTRA = re.compile(r"^([\w.-]++).*extra\s*==\s*['\"]([\w-]+)['\"]")


class DoctorError(UserError):
    """At least one check failed; the message names each."""


class DoctorOptions(Options):
    """Options of `doctor`."""

    model: Annotated[
        Path | None,
        option(
            "ONNX file: print what is understood of this depth network, stereo network "
            "or detector, "
            "its size and its time, in place of the installation.",
            metavar="[MODEL]",
            is_argument=True,
        ),
    ] = None
    image: Annotated[
        tuple[Path, ...],
        option(
            "Image for MODEL, whose values are printed; twice for a stereo network, "
            "left and right.",
            metavar="FILE",
            is_repeated=True,
        ),
    ] = ()
    focal_px: Annotated[
        PositiveNumber | None,
        option("Focal length of the image in pixels (default: its width).", metavar="PX"),
    ] = None
    json_format: Annotated[bool, option("Output as JSON, for scripts.", flag="--json")] = False


_IMAGE_HW = 720, 1280  # of the size and time of a network without --image


def _doctor(options: DoctorOptions) -> None:
    if options.model is not None:
        _print_model(options.model, options)
        return
    if options.image or options.focal_px is not None:
        raise UsageError("--image and --focal-px: expected a MODEL, for which they are.")
    checks = {name: _outcome(check) for name, check in CHECKS.items()}
    failures = [f"{name}: {text}" for name, text in checks.items() if text != OK]
    groups = {**installation(), "checks": checks}
    if options.json_format:
        print_line(console, json.dumps({"ok": not failures, **groups}, indent=2))
    else:
        for title, rows in groups.items():
            print_line(
                console,
                title.capitalize(),
                *(f"  {name:<24}{value}" for name, value in rows.items()),
            )
    if failures:
        raise DoctorError(
            f"doctor: {len(failures)} of {len(checks)} checks failed: {'; '.join(failures)}"
        )


def _print_model(path: Path, options: DoctorOptions) -> None:
    from track_range.cli.commands.models.networks import model_rows

    images = [read_image(file, ConfigError) for file in options.image]
    image_hw = images[0].shape[:2] if images else _IMAGE_HW
    rows = model_rows(path, (image_hw[0], image_hw[1]), images, options.focal_px)
    if options.json_format:
        values = {name: {"value": value, "source": source} for name, value, source in rows}
        print_line(console, json.dumps({"ok": True, "model": values}, indent=2))
        return
    width = max(len(name) for name, _, _ in rows) + 2
    texts = [f"{value} ({source})" if source else value for _, value, source in rows]
    lines = [f"  {row[0]:<{width}}{text}" for row, text in zip(rows, texts, strict=True)]
    print_line(console, str(path), *lines)


def installation() -> dict[str, dict[str, str]]:
    """Groups of names and values that describe this installation."""
    return {
        "system": {
            "platform": platform.platform(),
            "processor": f"{platform.machine()}, {os.cpu_count()} logical cores, "
            f"{n_usable_cores()} of them usable",
            "python": f"{platform.python_version()} ({sys.executable})",
        },
        "versions": {name: _version(name) for name in PACKAGES}
        | {"FFmpeg": _text(lambda: str(import_module("av").ffmpeg_version_info))},
        "inference": {
            **{
                f"device {name}": _text(partial(_device_text, name))
                for name in get_args(Device)
                if name != "auto"
            },
            "telemetry": "disabled"
            if os.environ.get("ORT_DISABLE_TELEMETRY") == "1"
            else "enabled",
            "default detector": _text(_default_detector),
        },
        "codecs": {
            "encoders": _text(lambda: _codecs(ENCODERS, "w")),
            "decoders": _text(lambda: _codecs(DECODERS, "r")),
        },
        "extras": extras(),
        "folders": {
            "package": str(Path(__file__).parents[2]),
            "model cache": _text(_model_cache),
            "temporary files": _text(tempfile.gettempdir),
            "TRACK_RANGE_CACHE": os.environ.get("TRACK_RANGE_CACHE", "not set"),
            "current folder": _text(
                lambda: f"{Path.cwd()}, {shutil.disk_usage(Path.cwd()).free / 1e9:.1f} GB free"
            ),
        },
    }


def extras() -> dict[str, str]:
    """The optional extras of the package: "installed", or the distributions that are missing."""
    missing: dict[str, list[str]] = {}
    for requirement in requires("track-range") or ():
        if match := _EXTRA.match(requirement):
            name, extra = match.groups()
            missing.setdefault(extra, []).extend([name] if _version(name) == _NOT_INSTALLED else [])
    return {
        extra: f"missing: {', '.join(names)}" if names else "installed"
        for extra, names in missing.items()
    }


def _version(name: str) -> str:
    return (
        ", ".join(
            text if distribution == name else f"{text} ({distribution})"
            for distribution, text in installed_versions(name).items()
        )
        or _NOT_INSTALLED
    )


class _Tested(NamedTuple):
    """Test of a device with the packaged detector."""

    time_ms: float = math.nan  # median of the inference of an image
    boxes: FloatArray = np.zeros((0, 5))  # (N, 5) x1, y1, x2, y2 in px, score
    missing: str = ""  # why the device cannot be used; "" = it can


@cache
def tested(device: Device) -> _Tested:
    """The packaged detector's time and boxes on a device, for the first image of the simulated
    drive.
    """
    import av

    from track_range.detection.catalogue.lookup import DEFAULT_MODEL, find_model
    from track_range.detection.models.onnx_session import Runtime
    from track_range.detection.models.providers import why_missing
    from track_range.detection.yolo.detector import YoloDetector

    if device != "cpu" and (missing := why_missing(device)):
        return _Tested(missing=f"not available ({missing})")
    detector = YoloDetector(find_model(DEFAULT_MODEL).path, runtime=Runtime(device=device))
    if detector.session.device != device:
        return _Tested(missing=detector.notes[0])
    with av.open(str(_drive()[1].left)) as video:
        detector.fill(next(video.decode(video=0)).to_ndarray(format="bgr24").astype(np.uint8))
    times_ms = []
    for _ in range(N_TIMED):
        began_s = time.perf_counter()
        outputs = detector.infer()
        times_ms.append(1000 * (time.perf_counter() - began_s))
    detections = detector.decode(outputs)
    return _Tested(
        float(np.median(times_ms)), np.column_stack([detections.xyxy_px, detections.score])
    )


def _differences(device: Device) -> tuple[float, float]:
    """Largest differences of a device's boxes in px, and of their scores, from the CPU's boxes of
    clear objects.
    """
    own, cpu = tested(device).boxes, tested("cpu").boxes
    # (boxes, boxes of the CPU, 5)
    difference = np.abs(own[:, None] - cpu[cpu[:, 4] >= CLEAR_SCORE])
    if not difference.size:
        return math.inf, math.inf
    px = difference[..., :4].max(axis=2)
    return float(px.min(axis=0).max()), float(
        np.take_along_axis(difference[..., 4], px.argmin(axis=0)[None], 0).max()
    )


def _device_text(device: Device) -> str:
    if missing := tested(device).missing:
        return missing
    px, score = _differences(device)
    difference = (
        ""
        if device == "cpu"
        else f"; boxes up to {px:.1f} px and scores up to {score:.2f} off the CPU's"
    )
    return f"{tested(device).time_ms:.1f} ms per image{difference}"


@cache
def _drive() -> tuple[tempfile.TemporaryDirectory[str], Drive]:
    """A folder that lasts as long as the program, and one second of a simulated drive in this
    folder.
    """
    from track_range.simulation.drive import write_drive
    from track_range.simulation.render.renderer import kitti_like_rig

    folder = tempfile.TemporaryDirectory(prefix="track-range-doctor-")
    rig = kitti_like_rig(width_px=620, height_px=188)
    return folder, write_drive(Path(folder.name) / "drive", seconds=1.0, fps=6.0, rig=rig)


def _default_detector() -> str:
    from track_range.detection.catalogue.lookup import DEFAULT_MODEL, find_model

    return str(find_model(DEFAULT_MODEL).path)


def _codecs(names: tuple[str, ...], mode: Literal["r", "w"]) -> str:
    """FFmpeg's codecs of the given names, each with "yes" or "no"; mode "w" = encoders."""
    return ", ".join(f"{name} {'yes' if _has_codec(name, mode) else 'no'}" for name in names)


def _has_codec(name: str, mode: Literal["r", "w"]) -> bool:
    import av
    from av.codec.codec import UnknownCodecError

    try:
        av.Codec(name, mode)
    except UnknownCodecError:
        return False
    return True


def _model_cache() -> str:
    from track_range.detection.catalogue.lookup import models_folder

    folder = models_folder()
    existing = next(path for path in (folder, *folder.absolute().parents) if path.is_dir())
    states = [] if existing == folder else ["not created yet"]
    states += [] if os.access(existing, os.W_OK) else [f"{existing} is not writable"]
    return f"{folder} ({', '.join(states)})" if states else str(folder)


def _text(describe: Callable[[], str]) -> str:
    """The description, or the exception that prevents it: the rest of the report is still
    useful.
    """
    try:
        return describe()
    except Exception as error:  # any: a broken installation is what doctor is for
        return f"unknown ({type(error).__name__}: {error})"


def _check_packages() -> str:
    missing = [name for name in PACKAGES if _version(name) == _NOT_INSTALLED]
    return (
        f"not installed: {', '.join(missing)}; reinstall track-range"
        if missing
        else " ".join(conflicts())
    )


def _check_codecs() -> str:
    missing = [name for name in ENCODERS if not _has_codec(name, "w")]
    return (
        f"FFmpeg has no encoder {', '.join(missing)}; reinstall PyAV from its wheel"
        if missing
        else ""
    )


def _check_disk() -> str:
    free = shutil.disk_usage(Path.cwd()).free
    enough = (
        f"expected at least {MIN_FREE_BYTES / 1e9:.1f} GB free in the current folder, found "
        f"{free / 1e9:.1f} GB"
    )
    return "" if free >= MIN_FREE_BYTES else enough


def _check_run() -> str:
    """A run on one second of simulated video: detector, tracker, all methods, every result file."""
    from track_range.run.options.settings import RunSettings
    from track_range.run.run import Run

    folder, drive = _drive()
    pair, out = (drive.left, drive.right), Path(folder.name) / "run"
    settings = RunSettings(stereo=pair, rig=drive.rig, truth=drive.table, out=out)
    with Run(settings) as run:
        for _ in run:
            pass
    summary = run.summary
    n_tracks, error_pct = (
        summary["tracks"]["n"],
        summary["methods"]["fused"].get("median_relative_error_pct"),
    )
    if n_tracks < MIN_TRACKS or error_pct is None or error_pct > MAX_MEDIAN_ERROR_PCT:
        return (
            f"expected at least {MIN_TRACKS} tracks and a median error of at most "
            f"{MAX_MEDIAN_ERROR_PCT:g} % on a simulated drive, found {n_tracks} tracks and "
            f"{error_pct} %"
        )
    return ""


def _check_devices() -> str:
    """Whether the devices of this machine find the same boxes as the CPU."""
    devices = [
        name
        for name in get_args(Device)
        if name not in ("auto", "cpu") and not tested(name).missing
    ]
    wrong = [
        name for name in devices if not np.less_equal(_differences(name), MAX_DIFFERENCES).all()
    ]
    return (
        f"the boxes found on {', '.join(wrong)} differ from the boxes found on the CPU; use "
        "--device cpu"
        if wrong
        else ""
    )


CHECKS: Mapping[str, Callable[[], str]] = {  # what is wrong and what to do; "" = no problem
    "packages": _check_packages,
    "H.264 encoder": _check_codecs,
    "disk space": _check_disk,
    "devices": _check_devices,
    "short run": _check_run,
}


def _outcome(check: Callable[[], str]) -> str:
    """The text of a check, or `OK`; an exception is a failure, too."""
    try:
        return check() or OK
    except Exception as error:  # any: the other checks are still of use
        return f"{type(error).__name__}: {error}"


app = command(DoctorOptions, _doctor)
