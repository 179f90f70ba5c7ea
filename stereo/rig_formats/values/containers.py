"""Containers of calibrations: YAML, XML, JSON, INI, assignments, NumPy's and MATLAB's files, as text or plain values.

    file -> text (`calibration_text`; arrays of .npy, .npz and .mat as JSON) -> values by key (`plain_values`)

Pickles are never loaded, archives never unpacked beyond the sizes of calibrations, and large arrays (remap tables,
chessboard corners) are left out.
"""

import contextlib
import io
import json
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from track_range.foundation.files.array_files import parse_array
from track_range.foundation.files.input_files import (
    MAX_TEXT_BYTES,
    open_regular,
    quoted,
    read_bytes,
    read_text,
    shortened,
)
from track_range.foundation.files.structured_text import parse_json, parse_yaml
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.values.mat_file import MARK, MatFile
from track_range.stereo.rig_formats.values.tables import (
    BASALT,
    MRCAL,
    MRCAL_INPUTS,
    TABLES,
    of_basalt,
    of_mrcal,
)

EXPECTED = "a calibration"
MAX_NUMBERS = 196  # largest number of numbers in a matrix of a calibration: 14 x 14
_MAX_ARRAYS = 200  # arrays of an .npz
_MAX_BYTES = 64_000_000  # of a file with remap tables
_MAX_ARRAY_BYTES = 8 * MAX_NUMBERS + 10_000  # of a small array with its header
_PICKLE = re.compile(rb"\x80[\x02-\x05]")  # the protocols 2 to 5
_PICKLE_ADVICE = (
    "which can run programs and is not opened; save its matrices with numpy.savez('calib.npz', K1=K1, D1=D1, K2=K2, "
    "D2=D2, R=R, T=T)"
)
_MATLAB_ADVICE = (
    "in MATLAB: s = toStruct(stereoParams); save('stereo.mat', 's', '-v7'), or write K1, D1, K2, D2, R and T with "
    "jsonencode to a .json"
)
_BINARY = (  # begins of the content, what it is, what to do
    ((b"\x89HDF", b"MATLAB 7.3"), "a MATLAB file of version 7.3 (HDF5)", _MATLAB_ADVICE),
    ((b"\x89PNG", b"\xff\xd8\xff"), "a picture",
     "give the file of the calibration, or calibrate with these pictures: calibrate --stereo"),
    ((b"SVO",), "a recording of a ZED", "give its factory calibration, SN followed by the serial number, .conf"),
    ((b"\x89MCAP", b"#ROSBAG"), "a bag", "give the bag as the recording; its camera_info is read from there"),
    ((b"\x1f\x8b",), "a gzip archive", "unpack it first"),
    ((b"ARROW1", b"PAR1"), "a table of Arrow or Parquet, such as Argoverse 2's intrinsics.feather",
     "write its rows as JSON with pandas: "
     "read_feather(FILE).set_index('sensor_name').to_json(OUT, orient='index')"),
    ((b"%PDF",), "a document", "type its numbers into a rig.yaml (track-range rig template FILE)"),
)  # fmt: skip
# marks in the text of kinds whose conventions differ between versions, what they are, what to do
_REFUSED = (
    (re.compile(r'"pxInitialFocalLength"|"intrinsicId"'), "the sfmData of AliceVision (Meshroom), whose "
     "principal points and focal lengths have other meanings in each version",
     "export the scene to COLMAP and give cameras.txt, or type its numbers into a rig.yaml"),
    (re.compile(r"<document\b[^>]*>\s*<chunk"), "the cameras of a project of Agisoft Metashape",
     "save the calibration of one camera as XML (Tools, Camera Calibration, Adjusted)"),
    (re.compile(r"ocam_model\.|MappingCoefficients|poly_parameters"), "the polynomial of OCamCalib (Scaramuzza), which "
     "MATLAB's fisheye cameras have, too",
     "calibrate with OpenCV's fisheye model, or undistort the video and give the pinhole of its "
     "images"),
)  # fmt: skip
_LARGE = re.compile(r"(data:\s*\[|<data>|\"data\":\s*\[)[^\]<]{4000,}")  # numbers of large matrices
_YAML_HEAD = re.compile(r"\A\s*%YAML[^\n]*\n|!!opencv-[a-z-]+|^(?:---|\.\.\.)[ \t]*$", re.MULTILINE)
# OpenCV allows it, YAML does not
_NO_SPACE = re.compile(r"^([ \t]*[A-Za-z][\w.]*):(?=[-\[\d.])", re.MULTILINE)
_SECTION = re.compile(r"^[^\S\n]*\[([A-Za-z][\w ./-]*)\]\s*$", re.MULTILINE)
_KEY = re.compile(r"^[^\S\n]*\w+:", re.MULTILINE)
# texts that are no YAML: name = ..., and rows of matrices as NumPy and MATLAB print them
_EQUALS = re.compile(r"^[ \t]*[\w.]+[ \t]*=", re.MULTILINE)
_ROWS_BELOW = re.compile(r":(?=[^\S\n]*\n)\s*+\[\[")
_SPACED_ROW = re.compile(r"\[[^\[\]\n,]*\d[ \t]+[-\d]")
_ASSIGNMENT = re.compile(
    r"^[ \t]*(?:self\.)?([A-Za-z_][\w. ]{0,40}?)[ \t]*[:=]\s*+(?:np\.|numpy\.)?(?:array|matrix|mat)?\(?\s*+"
    r"(\[[-+\d.eE,;\s\[\]]*\]|[-+]?\d[\d.]*(?:[eE][-+]?\d+)?)",
    re.MULTILINE,
)
_NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?")


def calibration_text(path: Path) -> str:
    """Text of a calibration file; NumPy's and MATLAB's files as JSON, without large arrays.

    Raises RigError if the file cannot be read, is too large, or is another kind of file, which the
    message names.
    """
    with open_regular(path, RigError, EXPECTED) as file:
        start = file.read(512) or b""
    if start.startswith((b"PK\x03\x04", b"\x93NUMPY")):
        return _numpy_text(path)
    if start.startswith(MARK):
        return _matlab_text(path)
    if _PICKLE.match(start):
        raise RigError(f"{path}: expected {EXPECTED}, found a Python pickle, {_PICKLE_ADVICE}.")
    for marks, noun, advice in _BINARY:
        if start.startswith(marks):
            raise RigError(f"{path}: expected {EXPECTED}, found {noun}; {advice}.")
    if path.name == "cameras.bin":  # without a mark at its start
        raise RigError(
            f"{path}: expected {EXPECTED} as text, found COLMAP's binary cameras; write "
            "cameras.txt: colmap model_converter --output_type TXT."
        )
    is_storage = start.lstrip().startswith((b"%YAML", b"<?xml", b"<opencv_storage"))
    text = read_text(
        path, RigError, EXPECTED, max_bytes=_MAX_BYTES if is_storage else MAX_TEXT_BYTES
    )
    text = _LARGE.sub(r"\1", text) if is_storage else text
    if len(text) > MAX_TEXT_BYTES:
        raise RigError(
            f"{path}: expected {EXPECTED} of at most {MAX_TEXT_BYTES // 1_000_000} MB, found more."
        )
    for pattern, noun, advice in _REFUSED:
        if pattern.search(text):
            raise RigError(f"{path}: expected {EXPECTED}, found {noun}; {advice}.")
    return text


def plain_values(text: str, path: Path, expected: str = EXPECTED) -> dict[str, Any]:
    """Values by key of a calibration's text, numbers of matrices also as texts; raises RigError for
    broken syntax.
    """
    start = text.lstrip()[:1]
    for pattern, named in TABLES:
        if pattern.search(text):
            return named(text)
    if start == "<":
        return _xml_values(text, path, expected)
    if MRCAL.search(text):
        values = parse_yaml(MRCAL_INPUTS.sub("", text), path, RigError, expected)
        return _of_places(of_mrcal, values, path, expected)
    if re.match(r"\s*(?:\[\s*)?\{", text):
        values = parse_json(text, path, RigError, expected)
        if isinstance(values, list):  # OpenSfM's reconstruction.json, tables of nuScenes
            values = values[0] if len(values) == 1 else {"cameras": values}
        if BASALT.search(text):
            return _of_places(of_basalt, values, path, expected)
    elif _SECTION.search(text) and not _KEY.search(text):
        return _section_values(text)
    elif not text.lstrip().startswith("%YAML") and (values := _assigned_values(text)):
        return values
    else:
        values = parse_yaml(yaml_of_opencv(text), path, RigError, expected)
    if not isinstance(values, dict):
        raise RigError(
            f"{path}: expected {expected} in a known format (with a key track_range_rig, or matrices by name such as "
            f"K1 and D1), found {quoted(values)}; track-range rig template FILE writes a rig.yaml with blanks."
        )
    return values


def _of_places(
    named: Callable[[Mapping[str, Any]], dict[str, Any]], values: Any, path: Path, expected: str
) -> dict[str, Any]:
    """The values of a file by name; RigError if some are missing, or are in other places."""
    try:
        return named(values)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise RigError(
            f"{path}: expected {expected} with all values of its kind, found an error at "
            f"{shortened(str(error), 60)}; give the complete file."
        ) from error


def yaml_of_opencv(text: str) -> str:
    """Standard YAML from OpenCV's FileStorage, whose first line, tags and spaces differ; lines keep
    their number.
    """
    if not text.lstrip().startswith("%YAML"):
        return text
    return _NO_SPACE.sub(r"\1: ", _YAML_HEAD.sub(lambda match: "\n" * match[0].count("\n"), text))


def _assigned_values(text: str) -> dict[str, Any]:
    """Numbers by name of `name = [...]` or `name: [[...]]` as NumPy, Middlebury and MATLAB print
    them; {} = YAML.
    """
    closed = text[: text.rfind("]") + 1]  # a row needs its end
    if not (_EQUALS.search(text) or _ROWS_BELOW.search(text) or _SPACED_ROW.search(closed)):
        return {}
    values = {
        name.strip(): [float(x) for x in _NUMBER.findall(value)]
        for name, value in _ASSIGNMENT.findall(text)
    }
    return {name: numbers[0] if len(numbers) == 1 else numbers for name, numbers in values.items()}


def _section_values(text: str) -> dict[str, Any]:
    """Values by section of an INI file: `key = value` lines."""
    values: dict[str, Any] = {}
    section = top = dict[str, Any]()
    for line in text.splitlines():
        if match := _SECTION.fullmatch(line):
            section = values.setdefault(match[1].strip(), {})
        elif "=" in line and not line.lstrip().startswith(("#", ";")):
            key, _, value = line.partition("//")[0].partition("=")  # MRPT's comments
            numbers = [float(word) for word in _NUMBER.findall(value)]
            if value.strip().startswith("["):
                section[key.strip()] = numbers
            else:
                is_number = _NUMBER.fullmatch(value.strip()) is not None
                section[key.strip()] = numbers[0] if is_number else value.strip()
    return top | values


def _xml_values(text: str, path: Path, expected: str) -> dict[str, Any]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise RigError(f"{path}: expected {expected}, found a document type; remove it.")
    try:
        root = ElementTree.fromstring(text)  # noqa: S314 - without entities, the file's size limits the tree
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise RigError(
            f"{path}: expected {expected} in XML, found an error: {shortened(str(error))}."
        ) from error
    counts = Counter(node.tag for node in root)
    repeated = [key for key, n in counts.items() if n > 1]
    if repeated and len(root) < MAX_NUMBERS:  # longer files list images or points
        raise RigError(
            f"{path}: expected the key {repeated[0]} once, found it {counts[repeated[0]]} times."
        )

    return {node.tag: _xml_value(node) for node in root}


def _xml_value(node: ElementTree.Element, depth: int = 0) -> Any:
    """The words of an element, a list for data and sizes; or its children by name, with their
    numbers if a name is repeated.
    """
    if len(node) and depth < 4:
        counts = Counter(part.tag for part in node)
        return {
            part.tag if counts[part.tag] == 1 else f"{part.tag}{number}": _xml_value(
                part, depth + 1
            )
            for number, part in enumerate(node[:MAX_NUMBERS], 1)
        }
    words = [word.strip('"') for word in (node.text or "").split()]
    return words[0] if len(words) == 1 and node.tag != "data" else words


def _numpy_text(path: Path) -> str:
    """The small arrays of an .npz or .npy file by name as JSON; null for other arrays."""
    content = read_bytes(path, RigError, EXPECTED, max_bytes=_MAX_BYTES)
    try:
        if content.startswith(b"\x93NUMPY"):
            arrays = {path.stem: parse_array(io.BytesIO(content), len(content)), **_beside(path)}
        else:
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                members = [
                    info
                    for info in archive.infolist()[:_MAX_ARRAYS]
                    if info.filename.endswith(".npy")
                ]
                if not members:
                    raise RigError(
                        f"{path}: expected {EXPECTED}, found a ZIP archive without arrays of NumPy; unpack it, and "
                        "give the calibration in it."
                    )
                arrays = {info.filename[:-4]: _member(archive, info) for info in members}
    except RigError:
        raise
    except Exception as reason:  # the parsers of archives and headers raise a dozen unrelated types
        problem = shortened(str(reason).partition("\n")[0], 100)
        if "object" in problem:
            raise RigError(
                f"{path}: expected {EXPECTED}, found a pickled object, {_PICKLE_ADVICE}."
            ) from reason
        raise RigError(
            f"{path}: expected {EXPECTED} as arrays of NumPy, found an error: {problem}."
        ) from reason
    return json.dumps({name: _listed(array) for name, array in arrays.items()}, allow_nan=False)


def _beside(path: Path) -> dict[str, Any]:
    """The small arrays in the other .npy files of a folder, which form one calibration, by name."""
    arrays: dict[str, Any] = {}
    for file in sorted(path.absolute().parent.glob("*.npy"))[:_MAX_ARRAYS]:
        if file.is_file() and file.stat().st_size <= _MAX_ARRAY_BYTES:
            content = read_bytes(file, RigError, "an array", max_bytes=_MAX_ARRAY_BYTES)
            # of arrays that are not numbers, which are not needed
            with contextlib.suppress(Exception):
                arrays[file.stem] = parse_array(io.BytesIO(content), len(content))
    return arrays


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Any:
    """A small array of an .npz; None for a large array."""
    if info.file_size > _MAX_ARRAY_BYTES:
        return None
    with archive.open(info) as file:
        content = file.read(_MAX_ARRAY_BYTES)
    return parse_array(io.BytesIO(content), len(content))


def _matlab_text(path: Path) -> str:
    """The variables of a .mat file by name as JSON, with the structs of saved objects as its
    cameras.
    """
    content = read_bytes(path, RigError, EXPECTED, max_bytes=_MAX_BYTES)
    try:
        file = MatFile(content)
        values = {name: _listed(value) for name, value in file.values.items()}
    except Exception as reason:  # of damaged sizes and types
        problem = shortened(str(reason).partition("\n")[0], 100)
        raise RigError(
            f"{path}: expected {EXPECTED} as a MATLAB file, found an error: {problem}."
        ) from reason
    cameras = [content for content in file.objects if "RadialDistortion" in content]
    pair = next((content for content in file.objects if "RotationOfCamera2" in content), {})
    named = {f"CameraParameters{number}": camera for number, camera in enumerate(cameras[:2], 1)}
    if cameras or pair:
        values = {"stereoParams": _listed(pair | named)}
    if not any(values.values()):
        raise RigError(
            f"{path}: expected {EXPECTED}, found objects of MATLAB without numbers; {_MATLAB_ADVICE}."
        )
    return json.dumps(values, allow_nan=False)


def _listed(value: Any) -> Any:
    """Plain values of small arrays, structs and texts; None for other values."""
    if isinstance(value, np.ndarray):
        is_small = (
            value.size <= MAX_NUMBERS and value.dtype.kind in "iuf" and np.isfinite(value).all()
        )
        return value.tolist() if is_small else None
    if isinstance(value, dict):
        return {str(key): _listed(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_listed(part) for part in value[:MAX_NUMBERS]]
    return value if isinstance(value, str) else None
