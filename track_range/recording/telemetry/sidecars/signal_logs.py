"""Logs with many signals: ASAM MDF (.mf4, .mdf), and frames of a CAN bus in MDF, BLF and ASC files.

The speed is the signal that the user names, else the only one whose unit is one of speed. Frames
are decoded with the user's DBC, without one by J1939: the wheel-based vehicle speed (SPN 84) of
CCVS1 (PGN 65265). MDF states UTC or local time; BLF and ASC files are taken to state local time.
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from traceback import walk_tb
from typing import Any, NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import (
    check_regular,
    counted,
    open_regular,
    quoted,
    shortened,
)
from track_range.recording.telemetry.sidecars.sidecar import Sidecar, of_file
from track_range.recording.telemetry.sidecars.speed_csv import NOT_SPEED
from track_range.recording.telemetry.tracks.positions import MPS_PER_UNIT
from track_range.recording.telemetry.tracks.samples import unit_in
from track_range.recording.telemetry.tracks.signal_choice import ANY_SIGNAL, SignalChoice
from track_range.recording.telemetry.tracks.track import (
    Clock,
    TelemetryError,
    TelemetryTrack,
    optional_package,
)

_READERS = {  # of python-can by suffix, what they read, and its first bytes
    ".blf": ("BLFReader", "a BLF file", (b"LOGG",)),
    ".asc": ("ASCReader", "an ASC file", (b"",)),
    ".mf4": ("MF4Reader", "an ASAM MDF file", (b"MDF ", b"UnFinMF ")),
}
# J1939-71: 1/256 km/h per bit, up to 250.996; larger values are errors, or not available
_J1939 = """VERSION ""
BO_ 2566844926 CCVS1: 8 X
 SG_ WheelBasedVehicleSpeed : 8|16@1+ (0.00390625,0) [0|250.996] "km/h" X
"""
_IDENTIFIER, _PARAMETER_GROUP = 0x1FFF_FFFF, 0x03FF_FF00  # bits of an extended identifier
_ANY_ADDRESS = 0xFE  # source address of a J1939 message in databases, which stands for any
# texts of a value 0 that is no speed, unlike "standstill"
_NO_VALUE = re.compile(r"sna|not|inv|err|fail|fault|init|undef|unkn", re.IGNORECASE)
_NAME_AND_UNIT = re.compile(r"([^\[]*+)(?:\[(.*)\])?")  # of --speed-channel
_FIRST_DATE_S = 1e8  # smaller times count from a start
_MAX_LISTED = 300  # characters of the names in an error


class _Signal(NamedTuple):
    """A signal of a log or of a database."""

    name: str
    place: str  # name of its group or message, and its name
    unit: str  # as stated
    key: Any  # by which it is read


def read_mdf(path: Path, choice: SignalChoice = ANY_SIGNAL) -> TelemetryTrack:
    """Telemetry of an MDF file of version 3 or 4; frames of a bus are read if a database is given, or
    no other signal has a unit of speed.

    Raises TelemetryError: the file cannot be read, no signal or more than one can be meant, a unit
    is missing, or asammdf is not installed.
    """
    asammdf = optional_package("asammdf", str(path), "adas")
    with _reading(path), asammdf.MDF(str(path)) as mdf:
        signals = list(_signals(mdf))
        start = mdf.header.start_time
        clock: Clock = "local" if start.tzinfo is None else "utc"
        is_meant = choice.database is not None or not (choice.name or _speeds(signals))
        if is_meant and "CAN_DataFrame" in mdf.channels_db:
            return read_frames(path, choice, clock)
        signal, unit = _chosen(path, signals, choice)
        group, index = signal.key
        raw = mdf.get(group=group, index=index, raw=True)
        bits = mdf.groups[group].channels[index].bit_count
        values = np.array([_number(value) for value in raw.physical().samples.tolist()])
        if raw.samples.dtype.kind == "u":  # all bits are set where a signal is not available
            values[raw.samples == 2**bits - 1] = np.nan
        time_s = raw.timestamps + start.replace(tzinfo=start.tzinfo or UTC).timestamp()
    return _track(path, signal, unit, clock, time_s, values)


def read_frames(
    path: Path, choice: SignalChoice = ANY_SIGNAL, clock: Clock = "local"
) -> TelemetryTrack:
    """Telemetry of the frames of a CAN bus, with a reader of python-can; see `read_mdf`."""
    reader = _form_of(path)[0]
    can, cantools = (optional_package(name, str(path), "adas") for name in ("can", "cantools"))
    signals = [
        _Signal(signal.name, f"{message.name}.{signal.name}", signal.unit or "", (message, signal))
        for message in _messages(cantools, choice.database)
        for signal in message.signals
    ]
    named, unit = _chosen(choice.database or path, signals, choice)
    options = {"relative_timestamp": False} if reader == "ASCReader" else {}
    with _reading(path), getattr(can, reader)(str(path), **options) as frames:
        streams, notes = _decoded(frames, named.key[0], named.name)
        if getattr(frames, "timestamps_format", None) == "relative":
            raise TelemetryError(f"{path}: expected absolute timestamps, found relative ones.")
        if not streams:
            advice = (
                "give the database of this bus" if choice.database else "give its DBC with --dbc"
            )
            raise TelemetryError(
                f"{path}: expected frames with {named.place}, found none; {advice}."
            )
        time_s, values = _one_stream(path, named, streams)
        # python-can takes the time zone of this machine
        if clock == "local" and reader != "BLFReader":
            zone = datetime.fromtimestamp(time_s[0], UTC).astimezone().utcoffset()
            time_s = time_s + (zone.total_seconds() if zone and time_s[0] > _FIRST_DATE_S else 0.0)
    return _track(path, named, unit, clock, time_s, values, *notes)


def _form_of(path: Path) -> tuple[str, str, tuple[bytes, ...]]:
    return _READERS.get(path.suffix.lower(), _READERS[".mf4"])


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Context in which the errors of libraries become a TelemetryError."""
    _, expected, starts = _form_of(path)
    with open_regular(path, TelemetryError, expected) as file:
        start = file.read(8)
    try:
        if not start or not start.startswith(starts):
            raise ValueError("by its first bytes")
        yield
    except TelemetryError:
        raise
    except Exception as error:  # those of the libraries, and of damaged blocks
        _close_halves(error)
        raise TelemetryError(
            f"{path}: expected {expected}, found another format or a damaged file "
            f"({shortened(str(error))})."
        ) from error


def _close_halves(error: Exception) -> None:
    """Close the files of readers that failed: python-can leaves them open, and asammdf closes one
    twice, which fails.
    """
    for frame, _ in walk_tb(error.__traceback__):
        half: Any = frame.f_locals.get("self")
        for file in filter(None, (getattr(half, name, None) for name in ("file", "_tempfile"))):
            file.close()
        if hasattr(half, "_closed"):
            half._closed = True


def _signals(mdf: Any) -> Iterator[_Signal]:
    """The channels of a file without its master channels."""
    labels = [getattr(content.channel_group, "acq_name", "") for content in mdf.groups]
    for group, content in enumerate(mdf.groups):
        is_unique = labels[group] and labels.count(labels[group]) == 1
        label = labels[group] if is_unique else str(group)
        master = mdf.masters_db.get(group)
        for index, channel in enumerate(content.channels):
            if index != master:
                unit = mdf.get_channel_unit(group=group, index=index)
                yield _Signal(channel.name, f"{label}.{channel.name}", unit, (group, index))


def _messages(cantools: Any, database: Path | None) -> Sequence[Any]:
    """The messages of a database, or those of J1939."""
    if database is None:
        return tuple(cantools.database.load_string(_J1939).messages)
    check_regular(database, TelemetryError, "a DBC file")
    try:
        return tuple(cantools.database.load_file(str(database), strict=False).messages)
    except Exception as error:  # of any of its parsers
        raise TelemetryError(
            f"{database}: expected a DBC file, found {shortened(str(error), _MAX_LISTED)}."
        ) from error


def _speeds(signals: Iterable[_Signal]) -> list[_Signal]:
    """The signals that may be the speed of the car."""
    return [one for one in signals if _unit(one.unit) and not NOT_SPEED.search(one.name.lower())]


def _unit(text: str) -> str | None:
    """The unit of speed that a text names; kN is a force."""
    return None if "kN" in text else unit_in(text)


def _chosen(path: Path, signals: Sequence[_Signal], choice: SignalChoice) -> tuple[_Signal, str]:
    """The signal of the speed, and its unit."""
    match = _NAME_AND_UNIT.fullmatch(choice.name)
    wanted, given = (match[1].strip(), match[2] or "") if match else (choice.name, "")
    meant = speeds = _speeds(signals)
    if wanted:
        meant = [one for one in signals if wanted in (one.name, one.place)]
    if len(meant) != 1:
        names = shortened(", ".join(one.place for one in meant or speeds or signals), _MAX_LISTED)
        listed = names if meant or speeds else f"none among {names or 'no signals'}"
        what = f"one signal {quoted(wanted)}" if wanted else "one signal with a unit of speed"
        raise TelemetryError(
            f"{path}: expected {what}, found {listed}; name the speed of the car with "
            "--speed-channel."
        )
    (signal,) = meant
    unit = _unit(signal.unit) or _unit(signal.name) or _unit(given)
    if unit is None:
        raise TelemetryError(
            f"{path}: expected a unit of speed of {signal.place}, found {quoted(signal.unit)}; "
            f"give it with --speed-channel '{signal.name} [km/h]'."
        )
    return signal, unit


def _decoded(frames: Any, message: Any, name: str) -> tuple[list[FloatArray], list[str]]:
    """Times and values (2, N) of a signal, by bus and identifier, and notes for the user."""
    streams: dict[tuple[object, int], list[tuple[float, float]]] = defaultdict(list)
    is_group = message.is_extended_frame and (
        message.protocol == "j1939" or message.frame_id & 0xFF == _ANY_ADDRESS
    )
    mask = _PARAMETER_GROUP if is_group else _IDENTIFIER
    wanted, is_extended, n_short = message.frame_id & mask, message.is_extended_frame, 0
    notes = []
    try:
        for frame in frames:
            is_other = frame.arbitration_id & mask != wanted or frame.is_extended_id != is_extended
            if is_other or frame.is_error_frame or frame.is_remote_frame:
                continue
            try:
                value = message.decode(bytes(frame.data)).get(name)
            except Exception:  # too few bytes, or a multiplexer that the database does not have
                n_short += 1
                continue
            # other messages of a multiplexer do not have the signal
            if value is not None and np.isfinite(frame.timestamp):
                stream = streams[frame.channel, frame.arbitration_id]
                stream.append((frame.timestamp, _number(value)))
    except Exception:  # a log that was cut off has samples up to there
        if not streams:
            raise
        notes.append("the log is damaged or cut off, and is used up to there.")
    if n_short:
        notes.append(f"{counted(n_short, 'frame')} cannot be decoded.")
    return [np.array(rows).T for rows in streams.values()], notes


def _one_stream(
    path: Path, named: _Signal, streams: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Times and values, NaN = no value, of the stream (2, N) with most values; TelemetryError: another
    one differs from it.
    """
    valid = [(time_s, _valid(named.key[1], values)) for time_s, values in streams]
    valid.sort(key=lambda stream: int(np.isfinite(stream[1]).sum()), reverse=True)
    time_s, values = valid[0]
    is_known = np.isfinite(values)
    for other_s, others in (
        (t[known], v[known]) for t, v in valid[1:] if (known := np.isfinite(v)).any()
    ):
        expected = np.interp(other_s, time_s[is_known], values[is_known])
        if np.median(np.abs(expected - others)) > 0.1 * np.median(np.abs(others)) + 1.0:
            raise TelemetryError(
                f"{path}: expected one speed of the car, found {named.place} of {len(streams)} buses "
                "or control units, which differ; cut the log to one of them."
            )
    return time_s, values


def _valid(signal: Any, values: FloatArray) -> FloatArray:
    """(N,) values, NaN where they are outside of the range of the database, or all bits are set."""
    is_wrong = np.zeros(len(values), np.bool_)
    if not signal.is_float and not signal.is_signed:
        mark = signal.offset + signal.scale * (2**signal.length - 1)
        is_wrong = np.isclose(values, mark, rtol=1e-9)
    low, high = signal.minimum, signal.maximum
    if low is not None and high is not None and low < high:
        is_wrong |= (values < low - 1e-6) | (values > high + 1e-6)
    return np.where(is_wrong, np.nan, values)


def _number(value: Any) -> float:
    """A number, NaN for a text, which stands for no value unless it names the value 0."""
    name = getattr(value, "name", value)
    if not isinstance(name, str | bytes):
        return float(value)
    is_rest = getattr(value, "value", None) == 0 and not _NO_VALUE.search(str(name))
    return 0.0 if is_rest else np.nan


def _track(
    path: Path,
    signal: _Signal,
    unit: str,
    clock: Clock,
    time_s: FloatArray,
    values: FloatArray,
    *notes: str,
) -> TelemetryTrack:
    n_missing = int(np.isnan(values).sum())
    if n_missing == len(values):
        raise TelemetryError(
            f"{path}: expected values of {signal.place}, found none that is valid in "
            f"{counted(len(values), 'sample')}."
        )
    is_own = _unit(signal.unit) or not signal.unit.strip()
    stated = "" if is_own else f", as given, not in its stated unit {quoted(signal.unit)}"
    said = [f"the speed is {signal.place} in {unit}{stated}.", *notes]
    if n_missing:
        said.append(f"{counted(n_missing, 'sample has', 'samples have')} no valid value.")
    if time_s[0] < _FIRST_DATE_S:
        clock = "video"
        said.append("it has no date; its times count from the first frame of the video.")
    return TelemetryTrack(
        time_s=time_s,
        speed_mps=values * MPS_PER_UNIT[unit],
        source=path.name,
        clock=clock,
        unit=unit,
        notes=tuple(said),
    )


MDF = Sidecar(suffixes=(".mf4", ".mdf"), read=of_file(read_mdf), read_signal=read_mdf, priority=-20)
FRAMES = Sidecar(
    suffixes=(".blf", ".asc"), read=of_file(read_frames), read_signal=read_frames, priority=-20
)
