"""Reports: what a part of a run tells about it. `RunSession` has the order of the parts.

A part is an object that knows something about a run: a stage of the pipeline, the speed, the rows,
the ground truth. It forms its own sentences and figures, so that a new one is one class.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from track_range.foundation.registry import plugin_notes


class Reports(Protocol):
    """A part of a run, with its messages and figures; a subclass defines those that it has."""

    def notes(self) -> Sequence[str]:
        """Messages for the user, as far as they are known."""
        return ()

    def summary(self) -> Mapping[str, Any]:
        """Entries of summary.json, by key; asked once, after the last frame."""
        return {}


@dataclass(frozen=True, slots=True)
class Facts(Reports):
    """Given entries of summary.json, in the place of a part that forms them."""

    entries: Mapping[str, Any]

    def summary(self) -> Mapping[str, Any]:
        """The entries."""
        return self.entries


class Packages(Reports):
    """Other packages, which fail when they are imported, or only when a frame or the end of the run
    needs them.
    """

    def notes(self) -> Sequence[str]:
        """One sentence for each that was to be used and cannot be."""
        return plugin_notes()


def notes_of(parts: Iterable[Reports]) -> list[str]:
    """The messages of parts in their order, each once: networks that fall back from the same device
    have the same message.
    """
    return list(dict.fromkeys(note for part in parts for note in part.notes()))


def summary_of(parts: Iterable[Reports]) -> dict[str, Any]:
    """The entries of parts in their order."""
    return {key: value for part in parts for key, value in part.summary().items()}
