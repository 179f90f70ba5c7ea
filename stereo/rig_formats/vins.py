"""Settings of VINS with cam0_calib and cam1_calib, the files of camodocal: PINHOLE, MEI (unified),
KANNALA_BRANDT.

body_T_cam0        x_body = T x_camera

The cameras are read as blocks of Kalibr. (VINS-Fusion, config/.)
"""

import contextlib
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from track_range.foundation.files.input_files import quoted, read_text
from track_range.foundation.files.structured_text import parse_yaml
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.geometry.rig_checks import RigCalibration
from track_range.stereo.rig_formats.dialects import KALIBR
from track_range.stereo.rig_formats.rig_format import format_by_pattern
from track_range.stereo.rig_formats.values.containers import yaml_of_opencv
from track_range.stereo.rig_formats.values.draft import draft_of
from track_range.stereo.rig_formats.values.partners import files_of, is_second, partner_of
from track_range.stereo.rig_formats.values.resolution import resolved

_TITLE = "VINS's settings and camera files"
_MAX_NAME = 200  # characters of the name of a file


def _content(path: Path, text: str | None = None) -> dict[str, Any]:
    text = read_text(path, RigError, "the calibration of a camera") if text is None else text
    content = parse_yaml(yaml_of_opencv(text), path, RigError, "the calibration of a camera")
    if not isinstance(content, dict):
        raise RigError(
            f"{path}: expected the calibration of a camera, found {quoted(content)}; give the "
            "complete file."
        )
    return content


def _of_blocks(blocks: dict[str, Any], path: Path, note: str, *, is_pair: bool) -> RigCalibration:
    """The cameras of blocks of Kalibr, with a note on the files."""
    calibration = resolved(draft_of(blocks, path, KALIBR), is_pair=is_pair)
    return replace(calibration, notes=(note, *calibration.notes))


def _read_vins(text: str, path: Path, *, is_pair: bool) -> RigCalibration:
    """The cameras of VINS's settings, or of one camera's file, as a pair if settings beside it name
    this file.
    """
    content = _content(path, text)
    settings = _settings_of(path) if is_pair and "model_type" in content else None
    if "model_type" in content and settings is None:
        note = f"{path}: {_TITLE}, one camera."
        return _of_blocks({"cam0": content}, path, note, is_pair=is_pair)
    files: tuple[Path, ...] = ()
    if settings is not None:
        files = _files_of_pair(path, settings[1])
        path, content = settings
    blocks = {}
    for number in (0, 1) if "cam1_calib" in content else (0,):
        named = _camera_file(path, content, number)
        file = files[number] if files else named
        pose = {"T_imu_cam": content.get(f"body_T_cam{number}")}
        blocks[f"cam{number}"] = _content(file) | pose
    note = f"{path}: {_TITLE}; lengths in metres."
    if content.get("estimate_extrinsic") in (1, 2):
        note = (
            f"{note[:-1]}; estimate_extrinsic is not 0, so body_T_cam may be only a rough initial "
            "guess."
        )
    return _of_blocks(blocks, path, note, is_pair=is_pair)


def _files_of_pair(path: Path, settings: dict[str, Any]) -> tuple[Path, ...]:
    """The files of both cameras beside settings that name files of another model; () = those of the
    settings.
    """
    partner = partner_of(path)
    if path.name in settings.values() or partner is None:
        return ()
    return (partner, path) if is_second(path) else (path, partner)


def _camera_file(path: Path, settings: dict[str, Any], number: int) -> Path:
    """The file of a camera that settings with this path name."""
    name = settings.get(f"cam{number}_calib")
    if not isinstance(name, str) or not 0 < len(name) < _MAX_NAME or not name.isprintable():
        raise RigError(
            f"{path}: expected the name of the camera's file in cam{number}_calib, found "
            f"{quoted(name)}; give the settings with the camera files beside them."
        )
    return path.parent / name


def _settings_of(path: Path) -> tuple[Path, dict[str, Any]] | None:
    """(path, content) of a pair's settings in a camera file's folder; None unless they name it or
    it has a partner.
    """
    for file in files_of(path.absolute().parent):
        with contextlib.suppress(RigError):  # of files of other kinds
            text = ""
            if file.suffix in (".yaml", ".yml"):
                text = read_text(file, RigError, "settings of VINS")
            if re.search(r"^cam1_calib\s*:", text, re.MULTILINE) and (
                path.name in text or partner_of(path)
            ):
                return path.with_name(file.name), _content(file, text)
    return None


VINS = format_by_pattern(
    "vins",
    _TITLE,
    re.compile(r"^(?:model_type|cam0_calib|body_T_cam0)\s*:", re.MULTILINE),
    partial(_read_vins, is_pair=False),
    "settings of VINS with cam0_calib, cam1_calib and body_T_cam0, body_T_cam1",
    partial(_read_vins, is_pair=True),
)
