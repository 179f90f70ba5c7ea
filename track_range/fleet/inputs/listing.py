"""clips_of: the clips of a fleet, from folders, patterns of file names and manifests."""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Iterable, Mapping, Sequence, Set
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from urllib.parse import quote

from track_range.fleet.inputs.clip import CLIP_SETTINGS, Clip, FleetInputError
from track_range.fleet.inputs.manifest import manifest_clips
from track_range.fleet.inputs.pattern import CLIP, FilePattern, Template
from track_range.fleet.inputs.tree import FileTree, is_image_name, wildcard_tree, without_suffix
from track_range.fleet.storage.location import Location, shown
from track_range.foundation.files.input_files import quoted, shortened

# largest length of a clip's name in the results, percent-encoded; file systems allow 255 bytes with
# what is added
MAX_NAME_BYTES = 200

_N_CONNECTIONS = 16  # files that are looked up at a time


def clips_of(recordings: Sequence[str], pattern: str | None, rig: str | None) -> list[Clip]:
    """The clips of folders, files, patterns such as `DIR/*.mp4`, and manifests (.csv, .parquet),
    sorted by name.

    `pattern` has the names of the files of a clip, relative to a folder: `{clip}.mp4` for one
    camera, `{clip}_left.mp4,{clip}_right.mp4` for two; other placeholders become labels; None =
    every video is a clip. `rig` may contain these placeholders or the columns of the manifest.
    Raises FleetInputError if nothing is found, names are not unique, or a pattern or manifest is
    wrong; StorageError if a storage cannot be reached.
    """
    file_pattern = None if pattern is None else FilePattern.of(pattern)
    rig_template = None if rig is None else Template.of(rig, "--rig")
    clips: list[Clip] = []
    for text in recordings:
        location = Location.of(text)
        if location.name.lower().endswith((".csv", ".parquet")):
            if file_pattern is not None:
                raise FleetInputError(
                    f"{location}: --pattern is for folders; a manifest names the "
                    "files of each clip."
                )
            clips.extend(manifest_clips(location))
        else:
            clips.extend(_clips_in(location, file_pattern))
    if not clips:
        raise FleetInputError("expected at least one folder, pattern or manifest, found none.")
    return _checked(clips if rig_template is None else _with_rigs(clips, rig_template))


def label_note(clips: Sequence[Clip]) -> str:
    """Sentence with the labels of the clips, and the settings whose names are similar; "" without
    labels.
    """
    labels = dict.fromkeys(name for clip in clips for name in clip.labels)
    near = {
        name: difflib.get_close_matches(name, CLIP_SETTINGS, n=1, cutoff=0.7) for name in labels
    }
    named = ", ".join(
        f"{shown(name)} (did you mean {near[name][0]}?)" if near[name] else shown(name)
        for name in labels
    )
    if not labels:
        return ""
    return f"Labels of the clips, which are no options of a run: {named}."


def _clips_in(location: Location, pattern: FilePattern | None) -> list[Clip]:
    tree = wildcard_tree(location)
    if tree is not None and not (tree.files or tree.folders):
        raise FleetInputError(f"{location}: no file matches this pattern; check the pattern.")
    if tree is None:
        if not _is_folder(location):
            if pattern is not None:
                raise FleetInputError(
                    f"{location}: expected a folder with --pattern, found a file."
                )
            return [Clip(without_suffix(location.name), location.address)]
        tree = FileTree.of_entries(location, location.list(recursive=True))
    if pattern is not None:
        return matched_clips(tree, pattern, location)
    names = tree.recordings()
    if not names:
        raise FleetInputError(
            f"{location}: expected videos, folders of numbered images or bags, found none among "
            f"{len(tree.files)} files; check the folder, or give --pattern."
        )
    return [
        Clip(
            (without_suffix(name) if name in tree.files else name) or location.name,
            (tree.folder.child(name) if name else tree.folder).address,
        )
        for name in names
    ]


def _is_folder(location: Location) -> bool:
    """Whether it is a folder; FleetInputError: there is nothing.

    On a web server, an address without a suffix is a folder.
    """
    has_suffix = location.parent is not None and without_suffix(location.name) != location.name
    if location.is_web and not has_suffix:
        return True
    status = location.stat()
    if status is None:
        raise FleetInputError(f"{location}: no such file, folder or bucket; expected recordings.")
    return status.is_folder


def matched_clips(tree: FileTree, pattern: FilePattern, location: Location) -> list[Clip]:
    """One clip for each match of a pattern below a folder (`location` in messages); half of a pair
    has a problem.

    Raises FleetInputError if no file matches, or there is no complete pair.
    """
    recorded = tree.recorded_folders()
    candidates = [*(name for name in tree.files if not is_image_name(name)), *(recorded - {""})]
    left_names, clips = pattern.left.expression(), []
    for name in candidates:
        match = left_names.fullmatch(name)
        if match is not None:
            clips.append(_clip_of_left(tree, pattern, match.groupdict(), name))
    if not clips:
        example = f", such as {quoted(min(candidates))}" if candidates else ""
        raise FleetInputError(
            f"{location}: expected files named {quoted(pattern.text)}, found none among "
            f"{len(candidates)} files{example}; change --pattern."
        )
    if all(clip.problem for clip in clips):
        raise FleetInputError(
            f"{location}: expected pairs of files named {quoted(pattern.text)}, found {len(clips)} "
            f"left videos without a right one, such as {quoted(min(clip.name for clip in clips))}; "
            "change --pattern."
        )
    return [*clips, *_lone_right(tree, pattern, candidates, {clip.name for clip in clips})]


def _clip_of_left(
    tree: FileTree, pattern: FilePattern, values: Mapping[str, str], left: str
) -> Clip:
    """The clip of a left video, with its values of the placeholders."""
    if pattern.right is None:
        return _clip_of(tree, values, left, None, missing="")
    right = pattern.right.filled(values)
    return _clip_of(tree, values, left, right, missing="" if right in tree else "right")


def _lone_right(
    tree: FileTree, pattern: FilePattern, candidates: Iterable[str], names: Set[str]
) -> Iterable[Clip]:
    """Clips with a problem for right videos without a left one; `names` are those with one."""
    if pattern.right is None:
        return []
    left_names, right_names = pattern.left.expression(), pattern.right.expression()
    recorded = tree.recorded_folders()
    clips: dict[str, Clip] = {}
    for name in candidates:
        match = right_names.fullmatch(name)
        if match is None or match[CLIP] in names or left_names.fullmatch(name) is not None:
            continue
        left = pattern.left.filled(match.groupdict())
        if left not in tree.files and left not in recorded:
            clips[match[CLIP]] = _clip_of(tree, match.groupdict(), left, name, missing="left")
    return clips.values()


def _clip_of(
    tree: FileTree, values: Mapping[str, str], left: str, right: str | None, *, missing: str
) -> Clip:
    """The clip with the given values of the placeholders; `missing`: the video that does not exist,
    "" = none.
    """
    addresses = {"left": tree.folder.child(left).address} if left else {}
    if right:
        addresses["right"] = tree.folder.child(right).address
    problem = ""
    if missing:
        reason = "a folder without images" if left in tree.folders else "no such file"
        problem = (
            f"{shortened(shown(addresses[missing]), 200)}: {reason}; expected the {missing} "
            "video of the clip."
        )
    labels = {name: value for name, value in values.items() if name != CLIP}
    return Clip(
        values[CLIP], addresses["left"], addresses.get("right"), labels=labels, problem=problem
    )


def _with_rigs(clips: Sequence[Clip], template: Template) -> list[Clip]:
    """The clips with the calibration file of --rig, unless they already have a calibration or a
    focal length.

    A clip without the file of its placeholders has a problem; FleetInputError: a placeholder is
    unknown, or no file exists.
    """
    locations: dict[str, Location] = {}  # by name of the clip
    for clip in clips:
        values = {CLIP: clip.name, **clip.labels}
        try:
            if not clip.settings.keys() & {"rig", "focal_px"}:
                locations[clip.name] = Location.of(template.filled(values))
        except KeyError as error:
            raise FleetInputError(
                f"--rig {quoted(template.text)}: {{{error.args[0]}}} is unknown; expected one of "
                f"{shortened(', '.join(values), 100)}."
            ) from error
    distinct = set(locations.values())
    with ThreadPoolExecutor(_N_CONNECTIONS) as threads:
        exists = dict(zip(distinct, threads.map(Location.exists, distinct), strict=True))
    if exists and not any(exists.values()):
        first = min(exists, key=lambda location: location.address)
        raise FleetInputError(f"{first}: no such file; expected the calibration of --rig.")
    result = []
    for clip in clips:
        if (location := locations.get(clip.name)) is not None:
            missing = (
                f"{shortened(str(location), 200)}: no such file; expected the calibration of the "
                "clip."
            )
            problem = clip.problem or ("" if exists[location] else missing)
            clip = replace(
                clip, settings={**clip.settings, "rig": location.address}, problem=problem
            )
        result.append(clip)
    return result


def _checked(clips: list[Clip]) -> list[Clip]:
    """The clips sorted by name; FleetInputError: two clips have the same name, or a name is too
    long.
    """
    clips = sorted((_printable(clip) for clip in clips), key=lambda clip: clip.name)
    for one, other in itertools.pairwise(clips):
        if one.name == other.name:
            first, second = (shortened(shown(clip.left), 80) for clip in (one, other))
            files = f"twice for {first}" if one.left == other.left else f"for {first} and {second}"
            raise FleetInputError(
                f"expected a different name for each clip, found {quoted(one.name)} {files}; "
                "rename one, or use --pattern or a manifest."
            )
    for clip in clips:
        if (
            len(clip.name) * 3 > MAX_NAME_BYTES
            and (n_bytes := len(quote(clip.name, safe=""))) > MAX_NAME_BYTES
        ):
            raise FleetInputError(
                f"{shortened(shown(clip.left), 100)}: expected a name of the clip of at most "
                f"{MAX_NAME_BYTES} bytes (percent-encoded), found {n_bytes}; rename it, or name it "
                "in a manifest."
            )
    return clips


def _printable(clip: Clip) -> Clip:
    """The clip; if a file name is not UTF-8, with escaped names and a problem."""
    texts = (clip.name, clip.left, clip.right or "", *clip.labels.values())
    if all(text == _escaped(text) for text in texts):
        return clip
    return replace(
        clip,
        name=_escaped(clip.name),
        left=_escaped(clip.left),
        right=None if clip.right is None else _escaped(clip.right),
        labels={name: _escaped(value) for name, value in clip.labels.items()},
        problem=f"{_escaped(clip.left)}: expected a file name in UTF-8, found other bytes; rename "
        "the file.",
    )


def _escaped(text: str) -> str:
    return text.encode("utf-8", "backslashreplace").decode()
