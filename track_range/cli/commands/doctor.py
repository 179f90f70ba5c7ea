"""`track-range doctor`: versions, devices, codecs and folders of this installation, and a short run as a test."""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Annotated, Literal

from track_range.cli.console import console, print_line
from track_range.cli.parameters import command
from track_range.foundation.errors import UserError
from track_range.foundation.options import Options, option

PACKAGES = (
    *("track-range", "numpy", "opencv-python-headless", "onnxruntime", "onnx", "av", "scipy", "pyarrow", "pydantic"),
    *("typer", "rich", "jinja2", "matplotlib"),
)
ENCODERS = ("libx264",)  # those that track-range needs
DECODERS = ("h264", "hevc", "av1", "vp9", "mpeg4", "mjpeg")  # of common videos; a run needs only that of its input
MIN_FREE_BYTES = 500_000_000  # results of an hour of 1242x375 px take about this much
MIN_TRACKS, MAX_MEDIAN_ERROR_PCT = 2, 5.0  # the short run finds 4 tracks with a median error of 0.3 %
OK, _NOT_INSTALLED = "ok", "not installed"
_EXTRA = re.compile(r"^([\w.-]+).*extra\s*==\s*['\"]([\w-]+)['\"]")


class DoctorError(UserError):
    """At least one check failed; the message names each."""


class DoctorOptions(Options):
    """Options of `doctor`."""

    json_format: Annotated[bool, option("Output as JSON, for scripts.", flag="--json")] = False


def _doctor(options: DoctorOptions) -> None:
    checks = {name: _outcome(check) for name, check in CHECKS.items()}
    failures = [f"{name}: {text}" for name, text in checks.items() if text != OK]
    groups = {**installation(), "checks": checks}
    if options.json_format:
        print_line(console, json.dumps({"ok": not failures, **groups}, indent=2))
    else:
        for title, rows in groups.items():
            print_line(console, title.capitalize(), *(f"  {name:<24}{value}" for name, value in rows.items()))
    if failures:
        raise DoctorError(f"doctor: {len(failures)} of {len(checks)} checks failed: {'; '.join(failures)}")


def installation() -> dict[str, dict[str, str]]:
    """Groups of names and values that describe this installation."""
    return {
        "system": {
            "platform": platform.platform(),
            "processor": f"{platform.machine()}, {os.cpu_count()} logical cores",
            "python": f"{platform.python_version()} ({sys.executable})",
        },
        "versions": {name: _version(name) for name in PACKAGES}
        | {"FFmpeg": _text(lambda: str(import_module("av").ffmpeg_version_info))},
        "inference": {
            "providers": _text(_providers),  # the import sets ORT_DISABLE_TELEMETRY
            "telemetry": "disabled" if os.environ.get("ORT_DISABLE_TELEMETRY") == "1" else "enabled",
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
            "current folder": _text(lambda: f"{Path.cwd()}, {shutil.disk_usage(Path.cwd()).free / 1e9:.1f} GB free"),
        },
    }


def extras() -> dict[str, str]:
    """The optional extras of the package: "installed", or the distributions that are missing."""
    missing: dict[str, list[str]] = {}
    for requirement in requires("track-range") or ():
        if match := _EXTRA.match(requirement):
            name, extra = match.groups()
            missing.setdefault(extra, []).extend([name] if _version(name) == _NOT_INSTALLED else [])
    return {extra: f"missing: {', '.join(names)}" if names else "installed" for extra, names in missing.items()}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return _NOT_INSTALLED


def _providers() -> str:
    from track_range.detection.models.onnx_session import available_providers

    return ", ".join(available_providers())


def _default_detector() -> str:
    from track_range.detection.models.lookup import DEFAULT_MODEL, find_model

    return str(find_model(DEFAULT_MODEL).path)


def _codecs(names: tuple[str, ...], mode: Literal["r", "w"]) -> str:
    """FFmpeg's codecs of these names, each with "yes" or "no"; mode "w" = encoders."""
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
    from track_range.detection.models.lookup import models_folder

    folder = models_folder()
    existing = next(path for path in (folder, *folder.absolute().parents) if path.is_dir())
    states = [] if existing == folder else ["not created yet"]
    states += [] if os.access(existing, os.W_OK) else [f"{existing} is not writable"]
    return f"{folder} ({', '.join(states)})" if states else str(folder)


def _text(describe: Callable[[], str]) -> str:
    """The description, or the exception that prevents it: the rest of the report is still of use."""
    try:
        return describe()
    except Exception as error:  # any: a broken installation is what doctor is for
        return f"unknown ({type(error).__name__}: {error})"


def _check_packages() -> str:
    missing = [name for name in PACKAGES if _version(name) == _NOT_INSTALLED]
    return f"not installed: {', '.join(missing)}; reinstall track-range" if missing else ""


def _check_codecs() -> str:
    missing = [name for name in ENCODERS if not _has_codec(name, "w")]
    return f"FFmpeg has no encoder {', '.join(missing)}; reinstall PyAV from its wheel" if missing else ""


def _check_disk() -> str:
    free = shutil.disk_usage(Path.cwd()).free
    enough = f"expected at least {MIN_FREE_BYTES / 1e9:.1f} GB free in the current folder, found {free / 1e9:.1f} GB"
    return "" if free >= MIN_FREE_BYTES else enough


def _check_run() -> str:
    """A run on one second of simulated video: detector, tracker, all methods, every result file."""
    from track_range.run.run import Run
    from track_range.run.settings import RunSettings
    from track_range.simulation.drive import write_drive
    from track_range.simulation.render.renderer import kitti_like_rig

    with tempfile.TemporaryDirectory(prefix="track-range-doctor-") as folder:
        rig = kitti_like_rig(width_px=620, height_px=188)
        drive = write_drive(Path(folder) / "drive", seconds=1.0, fps=6.0, rig=rig)
        pair, out = (drive.left, drive.right), Path(folder) / "run"
        settings = RunSettings(stereo=pair, rig=drive.rig, truth=drive.table, out=out)
        with Run(settings) as run:
            for _ in run:
                pass
        summary = run.summary
    n_tracks, error_pct = summary["tracks"]["n"], summary["methods"]["fused"].get("median_relative_error_pct")
    if n_tracks < MIN_TRACKS or error_pct is None or error_pct > MAX_MEDIAN_ERROR_PCT:
        return (
            f"expected at least {MIN_TRACKS} tracks and a median error of at most {MAX_MEDIAN_ERROR_PCT:g} % on a "
            f"simulated drive, found {n_tracks} tracks and {error_pct} %"
        )
    return ""


CHECKS: Mapping[str, Callable[[], str]] = {  # what is wrong and what to do; "" = no problem
    "packages": _check_packages,
    "H.264 encoder": _check_codecs,
    "disk space": _check_disk,
    "short run": _check_run,
}


def _outcome(check: Callable[[], str]) -> str:
    """The text of a check, or `OK`; an exception is a failure, too."""
    try:
        return check() or OK
    except Exception as error:  # any: the other checks are still of use
        return f"{type(error).__name__}: {error}"


app = command(DoctorOptions, _doctor)
