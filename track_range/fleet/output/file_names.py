"""FileNames: names of a clip's files in the results of a fleet, without their folders if the fleet is anonymized."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from track_range.fleet.inputs.clip import Clip
from track_range.fleet.storage.location import Location


class FileNames:
    """Names of the left and right video of a clip ("" = one camera); anonymized ones are without folders.

    Folders may contain the name of a person.
    """

    def __init__(self, clip: Clip, *, is_anonymized: bool) -> None:
        self._is_anonymized = is_anonymized
        left, right = Location.of(clip.left), None if clip.right is None else Location.of(clip.right)
        self.left = left.name if is_anonymized else str(left)
        self.right = "" if right is None else right.name if is_anonymized else str(right)
        folders = {text for address in clip.named_files().values() for text in _folders(Location.of(address))}
        self._folders = sorted(folders, key=len, reverse=True) if is_anonymized else []

    def text(self, text: str) -> str:
        """A message about the clip with these names."""
        if not self._is_anonymized:
            return text
        for folder in self._folders:
            text = text.replace(folder, "")
        return text.replace(str(Path.home()), "~")


def _folders(location: Location) -> Iterable[str]:
    """Texts before the name of a file, as messages contain them; for folders of images, those before its last part."""
    if not location.is_local:
        return [f"{str(location).partition('?')[0].rpartition('/')[0]}/"]
    parents = (location.path.parent, Path(os.path.realpath(location.path)).parent)
    return [f"{parent}/" for parent in parents if parent != parent.parent]
