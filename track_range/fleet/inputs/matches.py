"""matched_clips: the clips of the files that match `--pattern`."""

from __future__ import annotations

import re
from collections.abc import Mapping

from track_range.fleet.inputs.clip import Clip, FleetInputError
from track_range.fleet.inputs.pattern import CLIP, FilePattern
from track_range.fleet.inputs.tree import FileTree, is_image_name
from track_range.fleet.storage.location import Location, shown
from track_range.foundation.files.input_files import quoted, shortened


def matched_clips(tree: FileTree, pattern: FilePattern, location: Location) -> list[Clip]:
    """One clip for each match of a pattern below a folder; one with half of a pair has a problem.

    Args:
        tree: all files.
        pattern: names of the videos.
        location: the folder or pattern of folders, for messages.

    Raises:
        FleetInputError: no file matches, or there is no complete pair.
    """
    candidates = [name for name in tree.files if not is_image_name(name)]
    candidates += tree.recorded_folders() - {""}
    matches = _Matches(tree, pattern)
    clips = [clip for name in candidates if (clip := matches.clip_of_left(name)) is not None]
    if not clips:
        example = f", such as {quoted(min(candidates))}" if candidates else ""
        raise FleetInputError(
            f"{location}: expected files named {quoted(pattern.text)}, found none among {len(candidates)} "
            f"files{example}; change --pattern."
        )
    if all(clip.problem for clip in clips):
        raise FleetInputError(
            f"{location}: expected pairs of files named {quoted(pattern.text)}, found {len(clips)} left videos without "
            f"a right one, such as {quoted(min(clips, key=lambda clip: clip.name).name)}; change --pattern."
        )
    names = {clip.name for clip in clips}
    lone = (clip for name in candidates if (clip := matches.clip_of_right(name)) is not None)
    return [*clips, *{clip.name: clip for clip in lone if clip.name not in names}.values()]


class _Matches:
    """Clips of single files of a tree."""

    def __init__(self, tree: FileTree, pattern: FilePattern) -> None:
        self._tree, self._pattern, self._recorded = tree, pattern, tree.recorded_folders()
        self._left = pattern.left.expression()
        self._right: re.Pattern[str] | None = None if pattern.right is None else pattern.right.expression()

    def clip_of_left(self, name: str) -> Clip | None:
        """The clip with this left or only video; None = the name does not match."""
        match = self._left.fullmatch(name)
        if match is None:
            return None
        values = match.groupdict()
        if self._pattern.right is None:
            return self._clip(values, name, None, "")
        right = self._pattern.right.filled(values)
        return self._clip(values, name, right, "" if right in self._tree else "right")

    def clip_of_right(self, name: str) -> Clip | None:
        """The clip with this right video without a left one; None = the name does not match, or there is a left one."""
        match = None if self._right is None else self._right.fullmatch(name)
        if match is None or self._left.fullmatch(name) is not None:
            return None
        values = match.groupdict()
        left = self._pattern.left.filled(values)
        is_recording = left in self._tree.files or left in self._recorded
        return None if is_recording else self._clip(values, left, name, "left")

    def _clip(self, values: Mapping[str, str], left: str, right: str | None, missing: str) -> Clip:
        folder = self._tree.folder
        address = folder.child(left).address
        right_address = None if right is None else folder.child(right).address
        problem = ""
        if missing:
            path = shortened(shown(address if missing == "left" else right_address or ""), 200)
            reason = "a folder without images" if left in self._tree.folders else "no such file"
            problem = f"{path}: {reason}; expected the {missing} video of the clip."
        labels = {name: value for name, value in values.items() if name != CLIP}
        return Clip(values[CLIP], address, right_address, labels=labels, problem=problem)
