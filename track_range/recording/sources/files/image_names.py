"""Names of the images of a folder: their order, the number or time in each, and the camera.

time      a date (2026-01-31T14-25-30.123, 260131_142530123), a time of day with a fraction (14-25-30.123, 142530123),
a decimal (1305031102.175304, 1305031102_175304), or 10 to 19 digits without leading zeros, in the
unit (s, ms, us, ns) that gives a plausible frame rate; in all names, different in each, and not as
close as numbers (142530_001)
number    the last field of digits that differs in each name, in the same order as all fields together
else      natural order: fields of digits are compared as numbers

0000000007.png (KITTI)   aachen_000000_000019_leftImg8bit.png (Cityscapes)   000003_10.png (KITTI 2015)
1403636579763555584.png (EuRoC)   n015-2018-07-24-11-22-45+0800__CAM_FRONT__1532402927612460.jpg (nuScenes)
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.images import IMAGE_SUFFIXES
from track_range.foundation.files.input_files import MAX_TEXT_BYTES, counted, read_text, readable
from track_range.recording.video.file_names import is_pattern, matching_files, natural_key
from track_range.recording.video.frame import TIME_EPSILON_S, VideoError

# 3, 6 or 9 digits; after a point also others
_FRACTION = r"[-_.,s]?(\d{9}|\d{6}|\d{3}|(?<=[.,])\d{1,9})"
_DATE = re.compile(
    r"(?<!\d)((?:19|20)\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])[-_.T ]{0,3}"
    r"([01]\d|2[0-3])[-_.:h]?([0-5]\d)[-_.:m]?([0-5]\d)"
    rf"(?:{_FRACTION})?(?!\d)"
)
# of 2010 to 2049, without separators (ApolloScape)
_SHORT_DATE = re.compile(
    r"(?<!\d)([1-4]\d)(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])[-_]"
    r"([01]\d|2[0-3])([0-5]\d)([0-5]\d)"
    rf"(?:{_FRACTION})?(?!\d)"
)
_TIME_OF_DAY = re.compile(
    rf"(?<!\d)([01]\d|2[0-3])[-_.:h]?([0-5]\d)[-_.:m]?([0-5]\d){_FRACTION}(?!\d)"
)
_MIN_HHMMSS_S = 3600.0  # earliest time of day of six digits that are no counter with zeros in front
_DAY_S = 86_400.0
_SECONDS_AND_PARTS = re.compile(r"(?<!\d)(1\d{9})_(\d{9}|\d{6})(?!\d)")
_DECIMAL = re.compile(r"(?<!\d)(\d+)\.(\d+)")
_INTEGER = re.compile(r"(?<![\d.])([1-9]\d{9,18})(?![\d.])")
_UNITS_S = (1.0, 1e-3, 1e-6, 1e-9)
# median times between frames from which the unit of numbers follows, and the longest one of others
_STEP_S, _MAX_STEP_S = (0.003, 3.0), 20.0
_EPOCH_S = (6e8, 4.2e9)  # 1989 to 2103; a time in this range is taken as one since 1970
_MIN_STEPS = 3  # number of steps from which there is a usual one
_MAX_GAP = 100  # largest mean step of numbers that count frames
# with the times of the images in a folder, in it or beside it; the first counts
TIME_FILES = ("timestamps.txt", "times.txt", "data.csv", "timestamps.csv", "times.csv", "rgb.txt")
_MAX_LINE_BYTES = 300  # of these files, per image
# words in names of the left and the right camera, between other characters than letters and digits
_SIDES = tuple(
    tuple(pair.split())
    for pair in (
        "left right,l r,cam0 cam1,cam_0 cam_1,camera0 camera1,infra1 infra2,camera_0 "
        "camera_1,image_02 image_03,image_2 image_3,image_00 image_01,image_0 image_1,cam1 "
        "cam2,leftimg8bit rightimg8bit,im0 im1"
    ).split(",")
)
_FOLDERS = (
    *_SIDES,
    ("left_images", "right_images"),
    ("left_rgb", "right_rgb"),
    ("image_left", "image_right"),
)


class NamedImages(NamedTuple):
    """Images of one camera in their order."""

    images: list[tuple[int, Path]]  # the number of each frame, and its file
    times_s: FloatArray | None  # (N,) times, seconds; None = by the numbers and a frame rate
    notes: list[str]
    clock: str = ""  # what states times, for the source of UTC
    is_local: bool = False  # whether times are dates, whose time zone is unknown


def named_images(folder: Path) -> NamedImages:
    """The images of a folder or pattern, or of the left camera of two. Raises VideoError if there
    are none.

    Times are read from a file beside the images (timestamps.txt, times.txt, data.csv), else from
    the names.
    """
    with readable(folder, VideoError):
        files = matching_files(folder) if is_pattern(folder) else list(folder.iterdir())
    files = [
        file for file in files if file.suffix.lower() in IMAGE_SUFFIXES and file.name[0] != "."
    ]
    files = [file for file in files if re.search(r"\d", file.stem)]
    if not files:
        raise VideoError(
            f"{folder}: expected numbered images (000000.png, 000001.png, ...) or videos, found "
            "none; give the folder that contains them, or a video file."
        )
    notes: list[str] = []
    if (sides := _sides_in(files)) is not None:
        files, right_files = sides.values()
        notes.append(
            f"{folder}: contains the images of two cameras; the left images are used "
            f"({files[0].name}, not {right_files[0].name}); --stereo {folder} uses both."
        )
    files = sorted(files, key=lambda file: (natural_key(file.stem), file.name))
    times_s, is_date = _times_in_names([file.stem for file in files])
    if times_s is not None:
        order = np.argsort(times_s, kind="stable")
        files, times_s = [files[i] for i in order], times_s[order]
    images = list(enumerate(files)) if times_s is not None else _numbered(files, folder, notes)
    stated = _stated_times(folder, [file for _, file in images], notes)
    if stated is not None:
        return NamedImages(images, stated[1], notes, stated[0], stated[2])
    return NamedImages(images, times_s, notes, "names of the images", is_date)


def stereo_images(folder: Path) -> tuple[Path, Path] | None:
    """The left and right folder in a folder, or the patterns of its left and right images; None =
    neither.
    """
    names = {entry.name.lower(): entry for entry in sorted(folder.iterdir()) if entry.is_dir()}
    for left, right in _FOLDERS:
        if left in names and right in names:
            pair = names[left], names[right]
            inside = pair[0] / "data", pair[1] / "data"
            return inside if all(path.is_dir() for path in inside) else pair
    files = [
        file
        for file in folder.iterdir()
        if file.suffix.lower() in IMAGE_SUFFIXES and file.name[0] != "."
    ]
    if (sides := _sides_in(files)) is None:
        return None
    left_name, right_name = sides
    return folder / left_name, folder / right_name


def _sides_in(files: Sequence[Path]) -> dict[str, list[Path]] | None:
    """Pattern and images of the left and right camera, whose names differ only in the side; None =
    one camera.
    """
    for sides in _SIDES:
        halves = [half for side in sides if (half := _Half.of(files, side)) is not None]
        if len(halves) != 2:
            continue
        left, right = halves
        n_common = len(left.remaining & right.remaining)
        if n_common > min(len(left.remaining), len(right.remaining)) / 2:
            return {left.pattern: left.files, right.pattern: right.files}
    return None


class _Half(NamedTuple):
    """Images whose names contain the word of a side."""

    pattern: str
    files: list[Path]
    remaining: set[str]  # the names without the word

    @classmethod
    def of(cls, files: Sequence[Path], side: str) -> Self | None:
        """The images of a side; None = there are none."""
        digits = "0-9" if side[-1].isdigit() else ""
        word = re.compile(rf"(?<![a-z]){side}(?![a-z{digits}])", re.IGNORECASE)
        matches = {file: match for file in sorted(files) if (match := word.search(file.stem))}
        if not matches:
            return None
        first = next(iter(matches.values()))
        start, end = "*", "*"
        if len(side) == 1:  # a letter is a word only between other characters
            start, end = "*[!a-zA-Z]" if first.start() else "", "[!a-zA-Z]*"
        remaining = {word.sub("", file.stem.lower()) for file in matches}
        return cls(f"{start}{first[0]}{end}", list(matches), remaining)


def _numbered(files: Sequence[Path], folder: Path, notes: list[str]) -> list[tuple[int, Path]]:
    """The frame number of each image, in the order of the files: in the names, else counted."""
    digits = [re.findall(r"\d+", file.stem) for file in files]
    columns = [
        [int(fields[-place]) for fields in digits if len(fields) >= place]
        for place in range(1, len(digits[-1]) + 1)
    ]
    for column in columns:
        is_number = len(column) == len(files) and bool(
            (np.diff(np.array(column, object)) > 0).all()
        )
        if is_number and column[-1] - column[0] < _MAX_GAP * len(files) and column[-1] < 2**63:
            steps = np.diff(column) / usual_step(column)
            if n_missing := int(np.maximum(np.rint(steps) - 1, 0).sum()):
                notes.append(
                    f"{folder}: {counted(n_missing, 'number is', 'numbers are')} missing between "
                    f"{files[0].name} and {files[-1].name}, and are treated as dropped frames."
                )
            return list(zip(column, files, strict=True))
    notes.append(
        f"{folder}: the numbers in the names are no frame numbers ({files[0].name}, "
        f"{files[-1].name}); the images are taken in the order of their names, at the frame rate "
        "given by --fps."
    )
    return list(enumerate(files))


def usual_step(numbers: Sequence[int]) -> int:
    """The usual difference of successive numbers, 1 where they are too few."""
    return max(1, round(float(np.median(np.diff(numbers))))) if len(numbers) > _MIN_STEPS else 1


def _times_in_names(stems: Sequence[str]) -> tuple[FloatArray | None, bool]:
    """(N,) times in seconds in the names, None if a name has no time, or two have the same time;
    and whether they are dates.
    """
    if len(stems) < 2:
        return None, False
    for pattern in (_DATE, _SHORT_DATE):
        times_s = _dates_s(_last_matches(pattern, stems))
        if times_s is not None and _are_times(times_s):
            return times_s, True
    times_s = _times_of_day_s(_last_matches(_TIME_OF_DAY, stems))
    if times_s is None:
        times_s = _numbers_s([_SECONDS_AND_PARTS.sub(r"\1.\2", stem) for stem in stems])
    return times_s, False


def _last_matches(pattern: re.Pattern[str], stems: Sequence[str]) -> list[re.Match[str]]:
    """The last match in each name; empty if a name has none."""
    matches = [list(pattern.finditer(stem)) for stem in stems]
    return [in_name[-1] for in_name in matches] if all(matches) else []


def _times_of_day_s(matches: Sequence[re.Match[str]]) -> FloatArray | None:
    """(N,) seconds since midnight, beyond a day after the next one; None for counters."""
    if not matches:
        return None
    parts = [match.groups() for match in matches]
    times_s = np.array(
        [3600 * int(h) + 60 * int(m) + int(s) + float(f"0.{part}") for h, m, s, part in parts]
    )
    if np.ptp(times_s) > _DAY_S / 2:
        times_s[times_s < _DAY_S / 2] += _DAY_S
    is_late = times_s.min() >= _MIN_HHMMSS_S
    is_clock = is_late or not any(match[0][:6].isdecimal() for match in matches)
    is_clock = is_clock and float(np.median(np.diff(np.sort(times_s)))) <= _MAX_STEP_S
    return times_s if is_clock and _are_times(times_s) else None


def _numbers_s(stems: Sequence[str]) -> FloatArray | None:
    """(N,) times in seconds of decimals or long numbers; None if there are none."""
    decimals = [_DECIMAL.findall(stem) for stem in stems]
    if all(decimals):
        readings = [_in_seconds(values) for values in _decimals([parts[-1] for parts in decimals])]
        possible = [times_s for times_s in readings if times_s is not None and _are_times(times_s)]
        if possible:
            return min(possible, key=lambda times_s: float(np.std(np.diff(np.sort(times_s)))))
    integers = [_INTEGER.findall(stem) for stem in stems]
    if not all(integers):
        return None
    times_s = _in_seconds(np.array([float(parts[-1]) for parts in integers]))
    return None if times_s is None or not _are_times(times_s) else times_s


def _dates_s(matches: Sequence[re.Match[str]]) -> FloatArray | None:
    """(N,) seconds since 1970; None = there are none, or one does not exist, such as 30 February."""
    if not matches:
        return None
    parts = [[group or "0" for group in match.groups()] for match in matches]
    texts = ["{}-{}-{}T{}:{}:{}.{}".format(f"20{year}"[-4:], *others) for year, *others in parts]
    try:
        return np.array(texts, "datetime64[ns]").astype(np.int64) / 1e9
    except ValueError:
        return None


def _decimals(parts: Sequence[tuple[str, str]]) -> list[FloatArray]:
    """Two readings, (N,) each, of the digits before and after the points.

    Some programs write sec.micro without zeros in front of the fraction: 1305031102.75304 is
    0.075304 s. The reading with the steadier steps is right.
    """
    whole = np.array([float(before) for before, _ in parts])
    fractions = [after[:18] for _, after in parts]
    padded = [text.zfill(max(map(len, fractions))) for text in fractions]
    return [whole + [float("0." + text) for text in texts] for texts in (fractions, padded)]


def _are_times(times_s: FloatArray) -> bool:
    """Whether times are different, and not as close as numbers behind a date or a point."""
    steps_s = np.diff(np.sort(times_s))
    return bool(steps_s.min() > 0) and float(np.median(steps_s)) >= _STEP_S[0] - TIME_EPSILON_S


def _in_seconds(values: FloatArray) -> FloatArray | None:
    """(N,) times in seconds of times in an unknown unit: the one in which the first is a date, else
    that of a plausible frame rate; None if there is none.
    """
    steps = np.diff(np.sort(values))
    if not (steps > 0).any():
        return None
    step = float(np.median(steps[steps > 0]))
    dated = [unit for unit in _UNITS_S if is_epoch(values[0] * unit)]
    longest_s = _MAX_STEP_S if dated else _STEP_S[1]
    possible = (unit for unit in dated or _UNITS_S if _STEP_S[0] <= step * unit < longest_s)
    unit = next(possible, None)
    return None if unit is None else np.asarray(values * unit)


def _stated_times(
    folder: Path, files: Sequence[Path], notes: list[str]
) -> tuple[str, FloatArray, bool] | None:
    """Name of a file of times in or beside the folder, (N,) times in seconds, and whether they are
    dates; or None.
    """
    parent = folder.absolute().parent
    places = (folder.parent, parent.parent) if is_pattern(folder) else (folder, parent)
    candidates = (place / name for name in TIME_FILES for place in places)
    file = next((candidate for candidate in candidates if candidate.is_file()), None)
    if file is None:
        return None
    max_bytes = max(_MAX_LINE_BYTES * (len(files) + 1), MAX_TEXT_BYTES)
    expected = "a date and time, or seconds, per image"
    rows = _rows_with_times(read_text(file, VideoError, expected, max_bytes=max_bytes))
    by_name = {Path(cell.strip()).name: row[0] for row in rows for cell in row[1:]}
    if all(image.name in by_name for image in files):
        cells = [by_name[image.name] for image in files]
    elif len(rows) == len(files):
        cells = [row[0] for row in rows]
    else:
        notes.append(
            f"{file}: ignored; it has {counted(len(rows), 'line')} for "
            f"{counted(len(files), 'image')}."
        )
        return None
    times_s = _parsed_times(cells)
    if times_s is None:
        notes.append(
            f"{file}: ignored; expected a date and time, or increasing seconds, on every line."
        )
        return None
    notes.append(f"{file}: used for the frame times of {folder}.")
    return file.name, times_s, _TIMESTAMP.match(cells[0].strip()) is not None


# between cells of a line: a comma, semicolon or tab, or spaces before a name or a last integer
_SEPARATOR = re.compile(r"[,;\t]|(?<![^\S\t])\s++(?=\S*[a-zA-Z/])|(?<=\d)\s++(?=\d+$)")
_MAX_LINE = 5000  # characters of a line that are read; a path has at most 4096
_TIMESTAMP = re.compile(r"((?:19|20|21)\d\d-\d\d-\d\d)[ T](\d\d:\d\d:\d\d(?:\.\d{1,9})?)")


def _rows_with_times(text: str) -> list[list[str]]:
    """Cells of the lines that start with a number: no comments, headings and empty lines."""
    lines = [line.strip() for line in text.split("\n") if line.strip()]
    rows = [_SEPARATOR.split(line[:_MAX_LINE]) for line in lines if line[0] not in "#%"]
    return [row for row in rows if re.match(r"[-+.\d]", row[0])]


def _parsed_times(cells: Sequence[str]) -> FloatArray | None:
    """(N,) times in seconds of dates, seconds, or whole numbers in another unit; None for other
    texts.
    """
    try:
        if all(_TIMESTAMP.fullmatch(cell.strip()) for cell in cells):
            dates = [_TIMESTAMP.sub(r"\1T\2", cell.strip()) for cell in cells]
            return np.asarray(np.array(dates, "datetime64[ns]").astype(np.int64) / 1e9)
        values = np.array([float(cell) for cell in cells])
    except ValueError:
        return None
    if not np.isfinite(values).all():
        return None
    return _in_seconds(values) if len(values) > 1 else values


def is_epoch(time_s: float) -> bool:
    """Whether a time is in seconds since 1970."""
    return _EPOCH_S[0] < time_s < _EPOCH_S[1]
