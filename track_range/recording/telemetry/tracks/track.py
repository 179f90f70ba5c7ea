"""TelemetryTrack: the samples of speed and position of a recording."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, check_shape
from track_range.foundation.errors import UserError
from track_range.foundation.files.output_files import write_text

Clock = Literal["video", "utc", "local"]  # seconds from the first frame of the video, or since 1970
# Doppler: 0.05 in u-blox's datasheets (median); dashcams round to 1 km/h or 0.1 kn
GPS_SPEED_SIGMA_MPS = 0.2
# per sample
COLUMNS = ("time_s", "speed_mps", "course_rad", "latitude_deg", "longitude_deg", "utc_s")
# positions, speeds and courses in the folder of a run, written only with --keep-gps
TELEMETRY_FILE = "telemetry.csv"
# size limit of a file beside a video; a day of NMEA sentences at 10 Hz has 60 MB
MAX_SIDECAR_BYTES = 100_000_000
_MARGIN_S = 1.0  # time before the first and after the last frame of which samples are written, s


class TelemetryError(UserError):
    """Telemetry that cannot be used, and why; a note of the run for a file that was found
    automatically.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class TelemetryTrack:
    """Samples of a recording in the order and form of the file, neither checked nor filtered.

    A sample without a fix stays in the track, with NaN as speed, course and position.
    """

    time_s: FloatArray  # (N,) finite times in seconds, by the clock `clock`
    speed_mps: FloatArray  # (N,) horizontal speed, negative = backwards; NaN = no fix
    source: str  # origin of the samples, for notes, such as "GoPro GPMF" or "drive.gpx"
    clock: Clock
    # (N,) clockwise from north; NaN = unknown
    course_rad: FloatArray = field(default_factory=lambda: np.empty(0))
    latitude_deg: FloatArray = field(default_factory=lambda: np.empty(0))  # (N,) NaN = unknown
    longitude_deg: FloatArray = field(default_factory=lambda: np.empty(0))  # (N,) NaN = unknown
    # (N,) date and time of each sample in seconds since 1970, NaN = unknown. Equal to `time_s` if
    # `clock` is "utc" or "local"; with `clock` "video" it is the receiver's clock, which the checks
    # use
    utc_s: FloatArray = field(default_factory=lambda: np.empty(0))
    speed_sigma_mps: float = GPS_SPEED_SIGMA_MPS  # standard deviation of the speed
    # whether the file states speeds; False if they are derived from positions
    has_own_speed: bool = True
    # unit of the speeds in the file, from which they were converted; None = not stated
    unit: str | None = "m/s"
    notes: tuple[str, ...] = ()  # messages for the user from the reader

    def __post_init__(self) -> None:
        n = len(self.time_s)
        for name in COLUMNS:
            if n and name != "speed_mps" and not len(getattr(self, name)):
                is_clock = name == "utc_s" and self.clock != "video"
                object.__setattr__(
                    self, name, self.time_s.copy() if is_clock else np.full(n, np.nan)
                )
            check_shape(name, getattr(self, name), (n,))

    def __len__(self) -> int:
        return len(self.time_s)

    def selected(self, index: FloatArray | BoolArray) -> TelemetryTrack:
        """The samples with the given indices, in their order."""
        return replace(self, **{name: getattr(self, name)[index] for name in COLUMNS})


def write_positions(path: Path, track: TelemetryTrack, *, first_s: float, last_s: float) -> None:
    """Write the samples between two times of a recording; an empty cell = unknown. See `write_text`
    for the errors.
    """
    during = (track.time_s >= first_s - _MARGIN_S) & (track.time_s <= last_s + _MARGIN_S)
    columns = {
        "time_s": (track.time_s, 3),
        "latitude_deg": (track.latitude_deg, 7),
        "longitude_deg": (track.longitude_deg, 7),
        "speed_mps": (track.speed_mps, 3),
        "course_deg": (np.degrees(track.course_rad), 2),
    }
    cells = [
        ["" if math.isnan(value) else f"{value:.{decimals}f}" for value in values[during].tolist()]
        for values, decimals in columns.values()
    ]
    write_text(path, "\n".join(map(",".join, (columns, *zip(*cells, strict=True)))) + "\n")


def optional_package(package: str, source: str, extra: str = "telemetry") -> Any:
    """A package of an extra; raises TelemetryError, which names the file `source`, if it is
    missing.
    """
    try:
        return import_module(package)
    except ImportError as error:
        raise TelemetryError(
            f"{source}: this file requires the package {package}; install it with: pip install "
            f'"track-range[{extra}]"'
        ) from error
