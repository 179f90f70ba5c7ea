"""check_clips: what a fleet would process, from the headers of the videos."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from track_range.fleet.inputs.clip import Clip


@dataclass(frozen=True, slots=True)
class CheckedClip:
    """Properties of a clip in the headers of its files.

    Attributes:
        clip: the clip.
        size_px: (width, height); None = not known.
        fps: frames per second; None = not known.
        duration_s: length in seconds; None = not known.
        n_bytes: size of its files; None = not known.
        calibration: "file", "focal length", "bag" or "none".
        problems: reasons why it cannot be processed, sentences.
        notes: other remarks, sentences.
    """

    clip: Clip
    size_px: tuple[int, int] | None
    fps: float | None
    duration_s: float | None
    n_bytes: int | None
    calibration: str
    problems: tuple[str, ...]
    notes: tuple[str, ...] = ()


def check_clips(clips: Sequence[Clip], *, threads: int = 8) -> Iterator[CheckedClip]:
    """The clips with the properties in their headers, in the given order.

    Args:
        clips: the clips.
        threads: number of clips that are opened at the same time.
    """
    raise NotImplementedError
