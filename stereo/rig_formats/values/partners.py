"""Files that complete a calibration: intrinsics and extrinsics, and files of the left and of the
right camera.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from track_range.stereo.rig_formats.values.draft import RigDraft, read_draft

_SUFFIXES = (
    *(".yml", ".yaml", ".xml", ".json", ".npz", ".npy", ".txt", ".conf", ".mat", ".cameramodel"),
)
_PAIRS = (
    *(("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"), ("infra1", "infra2")),
    *(
        (f"{noun}{n}", f"{noun}{n + 1}")
        for noun in ("cam", "camera", "cam_", "camera_", "cam-", "camera-")
        for n in (0, 1)
    ),
)
_OTHERS = {
    word: [a if word == b else b for a, b in _PAIRS if word in (a, b)]
    for pair in _PAIRS
    for word in pair
}
_SIDE = re.compile("|".join(sorted(_OTHERS, key=len, reverse=True)))
_LETTER = re.compile(r"([_.-])([lLrR])(?=[_.-]|$)")  # camera_L.yml
_LETTERS = {"l": "r", "r": "l", "L": "R", "R": "L"}
# names of files with R and T
_EXTRINSIC = re.compile(r"extri|stereo|relative|rt\b|pose", re.IGNORECASE)
_MAX_FILES = 50  # files of a folder that are looked at


def other_sides(name: str) -> Iterator[str]:
    """Names of the file of the other camera; none for a name without a side."""
    if match := _SIDE.search(name):
        yield from (name.replace(match[0], word) for word in _OTHERS[match[0]])
    elif _LETTER.search(Path(name).stem):
        yield _LETTER.sub(lambda match: match[1] + _LETTERS[match[2]], name)


def partner_of(path: Path) -> Path | None:
    """The file of the other camera, with the name or the folder's name of the other side; None if
    there is none.
    """
    beside = [path.with_name(name) for name in other_sides(path.name)]
    folders = [path.parent.parent / folder for folder in other_sides(path.parent.absolute().name)]
    inside = [folder / name for folder in folders for name in (path.name, *other_sides(path.name))]
    return next(
        (
            candidate
            for candidate in (*beside, *inside)
            if candidate != path and candidate.is_file()
        ),
        None,
    )


def is_second(path: Path) -> bool:
    """Whether the name of a file, else of its folder, belongs to a right camera or a camera with a
    larger number.
    """
    word, partner = _side_word(path), partner_of(path)
    is_after_zero = partner is not None and _side_word(partner).endswith("0")
    return word.lower() in ("right", "r") or word.endswith("2") or is_after_zero


def _side_word(path: Path) -> str:
    for name in (path.stem, path.parent.absolute().name):
        if match := _SIDE.search(name):
            return match[0]
        if letter := _LETTER.search(name):
            return letter[2]
    return ""


def other_half(path: Path, *, is_intrinsic: bool) -> Path | None:
    """The file in the folder with the extrinsics for intrinsics, or the intrinsics for extrinsics;
    None if absent.
    """
    own, other = ("intri", "extri") if is_intrinsic else ("extri", "intri")
    stem = path.stem.replace(own, other) if own in path.stem else f"{other}nsics"
    for candidate in (path.with_name(stem + suffix) for suffix in (path.suffix, *_SUFFIXES)):
        if candidate != path and candidate.is_file():
            return candidate
    is_fitting = _is_extrinsic if is_intrinsic else _is_first_camera
    files = files_of(path.absolute().parent)
    fitting = [file.name for file in files if file.name != path.name and is_fitting(file)]
    return path.with_name(fitting[0]) if len(fitting) == 1 else None


def _is_extrinsic(file: Path) -> bool:
    """Whether a file has the name of R and T, and of no single camera."""
    return bool(_EXTRINSIC.search(file.stem)) and not list(other_sides(file.name))


def _is_first_camera(file: Path) -> bool:
    """Whether a file has the name of a left camera, or of one with the smaller number, and a
    partner.
    """
    is_of_one_side = bool(list(other_sides(file.name)))
    return is_of_one_side and partner_of(file) is not None and not is_second(file)


def files_of(folder: Path) -> list[Path]:
    """Files of a folder that may be calibrations, sorted by name."""
    return sorted(
        file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES and file.is_file()
    )[:_MAX_FILES]


def completed(draft: RigDraft, *, is_pair: bool) -> RigDraft:
    """The draft of a file, completed by files in its folder; by the file of the other camera only
    if `is_pair`.
    """
    path = draft.path
    has_cameras = draft.has("K", "fx")
    has_extrinsics = draft.has_extrinsics or draft.has("P", "baseline", "bf")
    is_single = has_cameras and len(draft.sides) < 2
    if has_extrinsics != has_cameras and (not is_single or "intri" in path.stem):
        return _with_other_half(draft, has_cameras=has_cameras)
    if is_pair and is_single and not has_extrinsics:
        partner = partner_of(path)
        if partner is not None:
            return _with_partner(draft, partner)
    return draft


def _with_other_half(draft: RigDraft, *, has_cameras: bool) -> RigDraft:
    """The draft with the file of extrinsics, or one or two files of intrinsics."""
    other = other_half(draft.path, is_intrinsic=has_cameras)
    if other is None:
        return draft
    merged = draft | read_draft(other)
    if has_cameras or len(merged.sides) == 2:
        return merged
    partner = partner_of(other)
    return merged if partner is None else draft | _both(other, partner)


def _with_partner(draft: RigDraft, partner: Path) -> RigDraft:
    """The draft of both cameras' files, and of a file of extrinsics."""
    path = draft.path
    left, right = (partner, path) if is_second(path) else (path, partner)
    both = replace(
        _both(left, right), path=path, keys=draft.keys, beside=(partner,), dialect=draft.dialect
    )
    other = other_half(path, is_intrinsic=True)
    return both if other is None else both | read_draft(other)


def _both(left: Path, right: Path) -> RigDraft:
    """The drafts of the files of a left and a right camera."""
    return read_draft(left).of_one_side("left") | read_draft(right).of_one_side("right")
