"""Sidecar: a format of files with telemetry beside a video; `SIDECARS` has all."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from track_range.recording.telemetry.tracks.signal_choice import SignalChoice
from track_range.recording.telemetry.tracks.track import TelemetryTrack

# telemetry of a file for the video with a name and a length in s, 0 = unknown
SidecarReader = Callable[[Path, str, float], TelemetryTrack | None]


SignalReader = Callable[[Path, SignalChoice], TelemetryTrack | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sidecar:
    """Suffixes and reader of a format."""

    suffixes: tuple[str, ...]  # of its files, in lower case
    # None = a file without telemetry, or of another format with this suffix; raises TelemetryError
    read: SidecarReader
    # of logs with many signals: the same for a signal that the user names
    read_signal: SignalReader | None = None
    file_name: str = ""  # of a file that does not have the name of the video
    # files of higher priority are looked for first, and formats with the same suffix are tried in
    # this order, see `foundation.registry.Registry`
    priority: int = 0

    def __post_init__(self) -> None:
        """ValueError: a suffix would never be found."""
        for suffix in self.suffixes:
            if not suffix.startswith(".") or suffix != suffix.lower():
                raise ValueError(
                    f"expected suffixes as a tuple, in lower case and with a dot, got {suffix!r}"
                )


def of_file(read: Callable[[Path], TelemetryTrack | None]) -> SidecarReader:
    """A reader of files that belong to one video, whatever its name and length."""
    return lambda path, _video, _duration_s: read(path)
