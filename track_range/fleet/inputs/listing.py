"""clips_of: the clips of a fleet, from folders, patterns of file names and manifests."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from urllib.parse import quote

from track_range.fleet.inputs.clip import Clip, FleetInputError
from track_range.fleet.inputs.globs import matching, split_pattern
from track_range.fleet.inputs.manifest import is_manifest, manifest_clips
from track_range.fleet.inputs.matches import matched_clips
from track_range.fleet.inputs.pattern import FilePattern
from track_range.fleet.inputs.rigs import RigOption
from track_range.fleet.inputs.tree import FileTree, without_suffix
from track_range.fleet.storage.entry import Entry
from track_range.fleet.storage.location import Location, shown
from track_range.foundation.files.input_files import quoted, shortened

MAX_NAME_BYTES = 200
"""Largest length of a clip's name in the results, percent-encoded; file systems allow 255 bytes with what is added."""


def clips_of(recordings: Sequence[str], pattern: str | None, rig: str | None) -> list[Clip]:
    """The clips that a command line names, sorted by name.

    Args:
        recordings: folders, files, patterns such as `DIR/*.mp4`, and manifests (.csv, .parquet), local or remote.
        pattern: names of the files of a clip, relative to a folder: `{clip}.mp4` for one camera,
            `{clip}_left.mp4,{clip}_right.mp4` for two; other placeholders become labels. None = every video is a clip.
        rig: calibration file of all clips, which may contain the placeholders of the pattern or the columns of the
            manifest; None = as in a run.

    Raises:
        FleetInputError: nothing is found, names are not unique, or a pattern or manifest is wrong.
        StorageError: a storage cannot be reached.
    """
    file_pattern = None if pattern is None else FilePattern.of(pattern)
    rig_option = None if rig is None else RigOption.of(rig)
    clips: list[Clip] = []
    for text in recordings:
        location = Location.of(text)
        if is_manifest(location):
            if file_pattern is not None:
                raise FleetInputError(f"{location}: --pattern is for folders; a manifest names the files of each clip.")
            clips.extend(manifest_clips(location))
        else:
            clips.extend(_clips_in(location, file_pattern))
    if not clips:
        raise FleetInputError("expected at least one folder, pattern or manifest, found none.")
    if rig_option is not None:
        clips = rig_option.added(clips)
    return _checked(clips)


def _clips_in(location: Location, pattern: FilePattern | None) -> list[Clip]:
    """The clips of a folder, file or pattern of files."""
    wildcards = split_pattern(location)
    if wildcards is not None:
        tree = _expanded(*wildcards)
        if not (tree.files or tree.folders):
            raise FleetInputError(f"{location}: no file matches this pattern; check it.")
    elif _is_file(location):
        if pattern is not None:
            raise FleetInputError(f"{location}: expected a folder with --pattern, found a file.")
        return [Clip(without_suffix(location.name), location.address)]
    else:
        tree = FileTree.of(location)
    return _recordings(tree, location) if pattern is None else matched_clips(tree, pattern, location)


def _is_file(location: Location) -> bool:
    """Whether a location is a file; on a web server, an address with a suffix.

    Raises:
        FleetInputError: there is no such file or folder.
    """
    if location.is_web and (location.parent is None or without_suffix(location.name) == location.name):
        return False
    status = location.stat()
    if status is None:
        raise FleetInputError(f"{location}: no such file, folder or bucket; expected recordings.")
    return not status.is_folder


def _expanded(folder: Location, names: list[str]) -> FileTree:
    """The tree of the files that match, and of all that is in the folders that match."""
    entries: list[Entry] = []
    for entry in matching(folder, names):
        entries.append(entry)
        if entry.stat.is_folder:
            below = folder.child(entry.name).list(recursive=True)
            entries += (Entry(f"{entry.name}/{inner.name}", inner.stat) for inner in below)
    return FileTree.of_entries(folder, entries)


def _recordings(tree: FileTree, location: Location) -> list[Clip]:
    """One clip for each recording below a folder."""
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


def _checked(clips: list[Clip]) -> list[Clip]:
    """The clips sorted by name.

    Raises:
        FleetInputError: two clips have the same name, or a name is too long.
    """
    clips = sorted((_printable(clip) for clip in clips), key=lambda clip: clip.name)
    for one, other in itertools.pairwise(clips):
        if one.name == other.name:
            files = (
                f"twice for {shortened(shown(one.left), 80)}"
                if one.left == other.left
                else f"for {shortened(shown(one.left), 80)} and {shortened(shown(other.left), 80)}"
            )
            raise FleetInputError(
                f"expected a different name for each clip, found {quoted(one.name)} {files}; rename one, or use "
                "--pattern or a manifest."
            )
    for clip in clips:
        if len(clip.name) * 3 > MAX_NAME_BYTES and (n_bytes := len(quote(clip.name, safe=""))) > MAX_NAME_BYTES:
            raise FleetInputError(
                f"{shortened(shown(clip.left), 100)}: expected a name of the clip of at most {MAX_NAME_BYTES} bytes "
                f"(percent-encoded), found {n_bytes}; rename it, or name it in a manifest."
            )
    return clips


def _printable(clip: Clip) -> Clip:
    """The clip; one with a file name that is not UTF-8 has escaped names and a problem."""
    texts = (clip.name, clip.left, clip.right or "", *clip.labels.values())
    if all(map(_is_utf8, texts)):
        return clip
    return replace(
        clip,
        name=_escaped(clip.name),
        left=_escaped(clip.left),
        right=None if clip.right is None else _escaped(clip.right),
        labels={name: _escaped(value) for name, value in clip.labels.items()},
        problem=f"{_escaped(clip.left)}: expected a file name in UTF-8, found other bytes; rename the file.",
    )


def _is_utf8(text: str) -> bool:
    """Whether a text has no bytes of a file name that could not be decoded."""
    if text.isascii():
        return True
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _escaped(text: str) -> str:
    return text.encode("utf-8", "backslashreplace").decode()
