"""open_speed: the ego speed of a run, from its setting and from the telemetry of its recording.

--ego-speed auto    ego_speed.csv or oxts beside the video  >  inside the video  >  beside it, with its name
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import alternatives, first_line
from track_range.foundation.files.numeric_text import number
from track_range.recording.recording import Recording
from track_range.recording.sources.bags.bag import is_bag
from track_range.recording.telemetry.checks import with_unit
from track_range.recording.telemetry.companions import companions, shared_note
from track_range.recording.telemetry.found import FoundTelemetry, candidates, named_telemetry
from track_range.recording.telemetry.image_evidence import SPAN_S, contradiction, motion_of
from track_range.recording.telemetry.sidecars.reading import (
    SPEED_TABLE_SUFFIXES,
    kind_of,
    sidecar_suffixes,
    signal_suffixes,
)
from track_range.recording.telemetry.sidecars.speed_csv import (
    has_positions,
    is_telemetry_header,
    log_table,
)
from track_range.recording.telemetry.speed_files import EgoSpeedError, open_ego_speed
from track_range.recording.telemetry.time_offset import MotionSeries, TimeOffset, estimated_offset
from track_range.recording.telemetry.tracks.signal_choice import ANY_SIGNAL, SignalChoice
from track_range.recording.telemetry.tracks.track import TelemetryError, TelemetryTrack
from track_range.recording.telemetry.video_clock import check_covered
from track_range.recording.video.video import VideoPart
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.speed.ego_speed import EgoSpeed

AUTO, OFF = "auto", "off"  # values of --ego-speed that are neither a number nor a path
_MOSTLY = 0.5  # fraction of the speeds that is most of a drive: vehicles reverse for seconds
_BACKWARDS = (
    "The given speed is negative in most of the drive, as if the vehicle drove backwards: of a camera "
    "that looks to the rear or aside, give the mounting, such as --mount yaw=180, and the speed of "
    "the vehicle."
)
_MIN_SPAN_S = 10.0  # length of the video, s, from which motion is measured for a shorter run
# of a CSV with times of the video
_TABLE_COLUMNS = ({"time_s", "speed_mps"}, {"time_s", "speed_kmh"})


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedSource:
    """Ego speed of a run and its origin."""

    ego: EgoSpeed | None = None  # None = unknown
    notes: tuple[str, ...] = ()  # messages for the user
    origin: str = ""  # sentence on a source that was found; "" = it was given, or there is none
    files: tuple[Path, ...] = ()  # the files that were read, besides the videos
    # that of the telemetry, estimated from the images; None = not estimated
    offset: TimeOffset | None = None
    # telemetry on the clock of the recording; None = the speed has another source
    track: TelemetryTrack | None = None

    def note(self, last_s: float) -> str:
        """Origin, and part of the video with a known speed; `last_s`: time of the last frame; "" =
        no note.
        """
        part = None if self.ego is None else self.ego.note(last_s, self.origin and "The speed")
        return " ".join(filter(None, (self.origin, part)))

    def summary(self, ego_mps: FloatArray, odometry: str | None = None) -> dict[str, Any] | None:
        """Section `ego_speed` of summary.json from (N,) speeds and the odometry, if any; None =
        unknown speed.
        """
        known = ego_mps[np.isfinite(ego_mps)]
        if self.ego is None and (odometry is None or not len(known)):
            return None
        return {
            "source": odometry if self.ego is None else self.ego.source,
            "offset_s": None if self.offset is None else round(self.offset.offset_s, 3),
            "offset_sigma_s": None if self.offset is None else round(self.offset.sigma_s, 3),
            "is_offset_applied": self.offset is not None and self.offset.is_certain,
            "median_mps": round(float(np.median(known)), 3) if len(known) else None,
            "coverage": round(len(known) / len(ego_mps), 4) if len(ego_mps) else None,
        }


def open_speed(
    setting: str,
    recording: Recording,
    mounting: Mounting | None = None,
    choice: SignalChoice = ANY_SIGNAL,
) -> SpeedSource:
    """Ego speed of a run from a setting: "auto", "off", a number in km/h, or the path of a file or
    folder; with the `mounting` of the camera that of the vehicle, else along the camera's axis.
    `choice` is the signal of a log with many.

    The motion of the images is measured in the part of the recording that is read. Raises
    EgoSpeedError or TelemetryError if the number or the named file cannot be used.
    """
    source = _opened(setting, recording, mounting, choice)
    is_log = any(path.suffix.lower() in signal_suffixes() for path in source.files)
    if setting == AUTO and choice != ANY_SIGNAL and not is_log:
        unused = (
            "--speed-channel and --dbc are not used, since no log with signals "
            f"({alternatives(signal_suffixes())}) was found beside the video; name it with "
            "--ego-speed FILE."
        )
        source = replace(source, notes=(*source.notes, unused))
    if source.ego is None:
        return source
    ego = source.ego if mounting is None else source.ego.of_vehicle()
    is_backwards = (ego.speed_mps < 0).mean() > _MOSTLY
    notes = (*source.notes, _BACKWARDS) if is_backwards else source.notes
    ego, lost_s = ego.without_lost_fixes()
    if len(lost_s):
        notes = (
            *notes,
            f"The given speed is zero at {lost_s[0]:.1f} s, before or after a jump that no car "
            f"makes, as where a receiver has no satellites: it is not used there ({len(lost_s)} "
            "samples).",
        )
    return replace(source, ego=ego, notes=notes)


def _opened(
    setting: str, recording: Recording, mounting: Mounting | None, choice: SignalChoice
) -> SpeedSource:
    if setting == OFF:
        return SpeedSource()
    reader, options = recording.videos[0], recording.options
    start_s, duration_s = options.start_s, options.duration_s
    parts = reader.parts
    if (utc := recording.start_utc) is not None:
        parts = tuple(replace(part, utc=utc.shifted(part.start_s)) for part in parts)

    def motion() -> MotionSeries:
        if recording.live is not None:
            return _NO_MOTION
        span_s = SPAN_S if duration_s is None else min(SPAN_S, max(duration_s, _MIN_SPAN_S))
        video, part_s = _file_at(parts, start_s, span_s) or (reader.path, 0.0)
        series = motion_of(
            video,
            recording.camera,
            start_s=start_s - part_s,
            fps=options.fps,
            span_s=span_s,
            travel_from_camera=None if mounting is None else mounting.travel_from_camera,
        )
        return replace(series, time_s=series.time_s + part_s)

    if setting != AUTO:
        if not parts and recording.live is None:  # a topic of a bag
            length_s = (reader.n_total or 0) / reader.fps
            parts = (VideoPart(Path(str(reader.path)), 0.0, length_s, recording.start_utc),)
        return _named(setting, parts, motion, choice)
    if not parts:
        return SpeedSource()
    source = _table_beside(parts[0])
    if source.ego is not None:
        own = [part.path for part in parts]
        own += [Path(str(video.path)) for video in recording.videos]
        shared = shared_note(source.files[0], own)
        source = replace(source, origin=source.origin + shared)
    return source if source.ego is not None else _automatic(parts, motion, source.notes, choice)


def _file_at(
    parts: Sequence[VideoPart], start_s: float, span_s: float
) -> tuple[Path, float] | None:
    """The file that covers most of the part from `start_s` on, and its start; None = no file covers
    it.
    """
    for part in parts if len(parts) > 1 else ():
        if part.start_s <= start_s and start_s + span_s / 2 <= part.start_s + part.duration_s:
            return part.path, part.start_s
    return None


_NO_MOTION = MotionSeries(
    time_s=np.empty(0),
    yaw_rad_s=np.empty(0),
    expansion_hz=np.empty(0),
    is_still=np.empty(0, np.bool_),
)


def _named(
    setting: str,
    parts: Sequence[VideoPart],
    motion: Callable[[], MotionSeries],
    choice: SignalChoice,
) -> SpeedSource:
    path = Path(setting)
    if choice != ANY_SIGNAL and path.suffix.lower() not in signal_suffixes():
        raise EgoSpeedError(
            f"--ego-speed {setting}: expected a log with signals ({alternatives(signal_suffixes())}) "
            "with --speed-channel or --dbc; of a table, rename the column to ego_speed_mps or "
            "ego_speed_kmh."
        )
    is_log = (path.is_file() and not _is_table(path)) or (path.is_dir() and is_bag(path))
    if math.isfinite(number(setting)) or not is_log or not parts:
        ego, notes = _checked(open_ego_speed(setting), parts)
        return SpeedSource(ego=ego, notes=notes)
    source, problem = _with_images(named_telemetry(path, parts, choice), motion())
    if problem is not None:
        raise TelemetryError(f"{path}: cannot be used as ego speed: {problem}.")
    return source


def _is_table(path: Path) -> bool:
    """Whether a file is a CSV with times of the video, or a CSV without telemetry, whose error
    names these columns.
    """
    if (
        path.suffix.lower() in sidecar_suffixes()
        and path.suffix.lower() not in SPEED_TABLE_SUFFIXES
    ):
        return False
    if kind_of(path):
        return False
    is_csv = path.suffix.lower() in (".csv", ".tsv")
    try:
        cells = re.split("[,;\t]", first_line(path, EgoSpeedError, "CSV"))
    except EgoSpeedError:
        return is_csv or not path.suffix
    is_named = any(
        columns <= {cell.strip().lower() for cell in cells} for columns in _TABLE_COLUMNS
    )
    if not is_csv:
        return is_named
    table = log_table(path, EgoSpeedError)
    return not has_positions(table) if is_named else not is_telemetry_header(table.header)


def _table_beside(part: VideoPart) -> SpeedSource:
    """Ego speed from ego_speed.csv or an oxts folder beside the first file of a recording, or in a
    folder of images.
    """
    video, notes = part.path, list[str]()
    folders = [video, video.parent] if video.is_dir() else [video.parent]
    # KITTI's raw recordings: image_02/data, and oxts beside image_02
    if video.is_dir() and video.name == "data":
        folders.append(video.parent.parent)
    for path in (folder / name for folder in folders for name in companions(video.name)["speed"]):
        if path.exists():
            try:
                ego, checked = _checked(open_ego_speed(str(path)), (part,))
            except (EgoSpeedError, TelemetryError) as error:
                notes.append(f"Telemetry is not used: {error}")
                continue
            origin = (
                f"The ego speed comes from {path.name} beside the video; --ego-speed off ignores "
                "this file."
            )
            return SpeedSource(ego=ego, notes=(*notes, *checked), origin=origin, files=(path,))
    return SpeedSource(notes=tuple(notes))


def _checked(ego: EgoSpeed, parts: Sequence[VideoPart]) -> tuple[EgoSpeed, tuple[str, ...]]:
    """A speed in the unit that its positions show, and notes; raises TelemetryError if they
    contradict it.

    It also raises TelemetryError if the samples cover less than a tenth of the video.
    """
    length_s = max((part.start_s + part.duration_s for part in parts), default=0.0)
    if len(ego.time_s) > 1:
        check_covered(ego.time_s, length_s, ego.source)
    if ego.positions_deg is None:
        return ego, ()
    lat, lon = ego.positions_deg.T
    track = TelemetryTrack(
        time_s=ego.time_s,
        speed_mps=np.abs(ego.speed_mps),
        source=ego.source,
        clock="video",
        latitude_deg=lat,
        longitude_deg=lon,
    )
    try:
        track = with_unit(track)
    except TelemetryError as error:
        raise TelemetryError(f"{ego.source}: {error}") from error
    speed_mps = np.copysign(track.speed_mps, ego.speed_mps)
    notes = tuple(f"{ego.source}: {note}" for note in track.notes)
    return replace(ego, speed_mps=speed_mps, speed_sigma_mps=track.speed_sigma_mps), notes


def _automatic(
    parts: Sequence[VideoPart],
    motion: Callable[[], MotionSeries],
    notes: tuple[str, ...],
    choice: SignalChoice,
) -> SpeedSource:
    """Ego speed from the telemetry inside or beside the video files; notes on unusable files."""
    measured: MotionSeries | None = None
    for telemetry in candidates(parts, choice):
        notes = (*notes, *telemetry.notes)
        if telemetry.track is None:
            continue
        measured = motion() if measured is None else measured
        source, problem = _with_images(telemetry, measured)
        if problem is None:
            shift = ""
            if source.offset is not None and source.offset.is_certain:
                offset_s, sigma_s = source.offset.offset_s, source.offset.sigma_s
                late = "late" if offset_s >= 0 else "early"
                shift = f", {abs(offset_s):.2f} +- {sigma_s:.2f} s {late} and corrected"
            origin = (
                f"The ego speed comes from {telemetry.track.source}{shift}; --ego-speed off "
                "ignores this source."
            )
            return replace(source, notes=notes, origin=origin)
        notes = (*notes, f"Telemetry is not used: {telemetry.track.source}: {problem}.")
    return SpeedSource(notes=notes)


def _with_images(telemetry: FoundTelemetry, motion: MotionSeries) -> tuple[SpeedSource, str | None]:
    """Ego speed with the time offset that the images show, and the contradiction that they show, if
    any.
    """
    track = telemetry.track
    if track is None:
        return SpeedSource(notes=telemetry.notes), None
    known = np.isfinite(track.speed_mps)
    offset = estimated_offset(motion, track.time_s, track.speed_mps, track.course_rad)
    sigma_s = telemetry.sigma_s
    if offset is not None and offset.is_certain:
        sigma_s, track = offset.sigma_s, replace(track, time_s=track.time_s - offset.offset_s)
    ego = EgoSpeed(
        track.time_s[known], track.speed_mps[known], track.source, track.speed_sigma_mps, sigma_s
    )
    source = SpeedSource(
        ego=ego, notes=telemetry.notes, files=telemetry.files, offset=offset, track=track
    )
    return source, contradiction(motion, ego)
