"""FileNames: names of a clip's files in the results of a fleet, without their folders if the fleet is anonymized."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from track_range.fleet.inputs.clip import Clip
from track_range.fleet.storage.location import Location


class FileNames:
    """Names of the files of a clip.

    Args:
        clip: the clip, as it was listed.
        is_anonymized: whether the names are without folders, which may contain the name of a person.
    """

    def __init__(self, clip: Clip, *, is_anonymized: bool) -> None:
        self._clip, self._is_anonymized = clip, is_anonymized
        folders = {text for address in clip.named_files().values() for text in _folders(Location.of(address))}
        self._folders = sorted(folders, key=len, reverse=True) if is_anonymized else []

    @property
    def left(self) -> str:
        """Name of the left or only video."""
        return self._name(self._clip.left)

    @property
    def right(self) -> str:
        """Name of the right video; "" = one camera."""
        return "" if self._clip.right is None else self._name(self._clip.right)

    def text(self, text: str) -> str:
        """A message about the clip with these names."""
        if not self._is_anonymized:
            return text
        for folder in self._folders:
            text = text.replace(folder, "")
        return text.replace(str(Path.home()), "~")

    def _name(self, address: str) -> str:
        location = Location.of(address)
        return location.name if self._is_anonymized else str(location)


def _folders(location: Location) -> Iterable[str]:
    """Texts before the name of a file, as messages contain them; for folders of images, those before its last part."""
    if not location.is_local:
        return [f"{str(location).partition('?')[0].rpartition('/')[0]}/"]
    parents = (location.path.parent, Path(os.path.realpath(location.path)).parent)
    return [f"{parent}/" for parent in parents if parent != parent.parent]
