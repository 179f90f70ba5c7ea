"""SegmentedVideo: the frames of several video files that form one recording, as a dashcam writes
them.

headers of all files -> order and times (`segment_times`) -> one file open at a time -> frames with
continuous numbers
"""

from __future__ import annotations

import filecmp
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from track_range.foundation.files.atomic_files import describe
from track_range.foundation.files.images import IMAGE_SUFFIXES
from track_range.foundation.files.input_files import counted, quoted, readable
from track_range.recording.sources.bags.bag import is_bag
from track_range.recording.sources.files.file_state import FileState
from track_range.recording.sources.files.video_file import (
    VideoFile,
    VideoHeader,
    compressed_frames,
    count_packets,
)
from track_range.recording.sources.segments.segment_times import (
    SegmentFacts,
    arranged,
    paired_starts_s,
)
from track_range.recording.sources.segments.segments import Segments
from track_range.recording.video.file_names import VIDEO_SUFFIXES, is_pattern, matching_files
from track_range.recording.video.frame import TIME_EPSILON_S, VideoError, VideoFrame
from track_range.recording.video.recorded_video import RecordedVideo
from track_range.recording.video.utc import UtcStart
from track_range.recording.video.video import Video, VideoPart

_MAX_FILES = 20_000  # of a recording: two weeks in files of a minute
_N_NOTES = 5  # messages about single files
_RESULT_VIDEOS = ("overlay.mp4", "disparity.mp4")  # names of the videos that a run writes
# frames of two files closer than this are one: more than the rounding of time stamps, 1/90000 s
_CUT_STEP_S = 1e-4
_RATE_DIFFERENCE = 0.01  # relative difference up to which frame rates count as equal
_MAX_OVERLAP_S = 5.0  # longest overlap that is searched; dashcams repeat 1 to 3 s

# of messages about other sizes
_LIKE, _ADVICE = " as in other files", "select files of one camera and setting"
# fewer bytes of equal frames may belong to an empty picture, equal by chance
_MIN_REPEATED_BYTES = 2000


class SegmentedVideo(RecordedVideo):
    """Several video files as one video; frame numbers and times continue from file to file.

    Files that cannot be read are skipped with a note, unless no file can be read. A file that is
    named repeatedly, or copied, is used once.

    If this is the right video of a pair whose left one has several files, too, its files give the
    times. `is_listed`: the user named each file, in the order of the recording.

    Raises VideoError if a named file does not exist, no file can be read, the files belong to
    several cameras, or their images differ in size; while iterating, if a file was deleted or
    changed in the meantime.
    """

    def __init__(
        self,
        name: Path | Segments,
        paths: Sequence[Path],
        *,
        left: Video | None = None,
        track: int | None = None,
        fps: float | None = None,
        is_listed: bool = False,
    ) -> None:
        self.path, self._is_listed = name, is_listed
        self._track, self._given_hz = track, fps
        self._setup_notes: list[str] = []
        self._reading_notes: list[str] = []
        if len(paths) > _MAX_FILES:
            raise VideoError(
                f"{name}: expected at most {_MAX_FILES} files, found {len(paths)}; "
                "select fewer files."
            )
        self._headers = self._readable(paths)
        facts = [
            SegmentFacts(
                path,
                header.first_s,
                header.duration_s or count_packets(path, fps)[1],
                *header.stamps,
            )
            for path, header in self._headers.items()
        ]
        self.plan = plan = arranged(facts, is_given_order=is_listed, repeated_s=_repeated_s)
        self._segments = plan.facts
        self._starts_s = plan.starts_s
        if isinstance(left, SegmentedVideo):
            self._starts_s = paired_starts_s(plan, left.plan)
        self._planned_first_s = self._starts_s[0]
        self._setup_notes += [f"{name}: {note}" for note in plan.notes]
        self._setup_notes += self._rate_notes()
        self._n_frames: dict[Path, int] = {}
        self._n_notes = 0
        self._current: VideoFile | None = self._first_file()
        first = self._current
        self.width_px, self.height_px = first.width_px, first.height_px
        self.pixel_aspect = first.pixel_aspect
        self.is_grey, self.fps, self.has_origin = first.is_grey, first.fps, first.has_origin
        self.tracks_px, self.depth_tracks = first.tracks_px, first.depth_tracks
        self.stated_layout, self.first_image = first.stated_layout, first.first_image
        self.first_time_s = self._starts_s[0]
        counts = [
            self._headers[s.path].n_frames or round(s.duration_s * self.fps) for s in self._segments
        ]
        self.n_total = sum(counts) or None

    @property
    def parts(self) -> tuple[VideoPart, ...]:
        """See `RecordedVideo`."""
        utc = self.utc
        starts_s = [start_s - self.first_time_s for start_s in self._starts_s]
        return tuple(
            VideoPart(
                segment.path,
                start_s,
                segment.duration_s,
                None if utc is None else utc.shifted(start_s),
            )
            for segment, start_s in zip(self._segments, starts_s, strict=True)
        )

    @property
    def utc(self) -> UtcStart | None:
        """See `RecordedVideo`."""
        return (
            None
            if self.plan.utc is None
            else self.plan.utc.shifted(self.first_time_s - self._planned_first_s)
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """See `RecordedVideo`."""
        notes = [*self._setup_notes, *self._reading_notes]
        if self._n_notes > _N_NOTES:
            notes.append(
                f"{self.path}: {self._n_notes - _N_NOTES} more messages concern single files."
            )
        return tuple(notes)

    def close(self) -> None:
        """See `RecordedVideo`."""
        if self._current is not None:
            self._current.close()
            self._current = None

    def frames(self, from_s: float, until_s: float) -> Generator[VideoFrame, None, None]:
        """See `RecordedVideo.frames`; files before `from_s` are not decoded."""
        self._reading_notes, self._n_notes = [], 0
        n_before, last_s = 0, -float("inf")
        for number, (segment, start_s) in enumerate(
            zip(self._segments, self._starts_s, strict=True)
        ):
            if start_s >= until_s - TIME_EPSILON_S:
                return
            is_last = number == len(self._segments) - 1
            if not is_last and start_s + segment.duration_s + 1 / self.fps <= from_s:
                n_before += self._counted_frames(segment)
                continue
            video, n_read, earliest_s = self._opened(segment), 0, last_s + _CUT_STEP_S
            if video is not None:
                video.burst_s = self.burst_s
                later_s = start_s - video.first_time_s
                with closing(video.frames(from_s - later_s, until_s - later_s)) as frames:
                    for frame in frames:
                        n_read = frame.index + 1
                        time_s = frame.time_s + later_s
                        if time_s > earliest_s:
                            last_s = time_s
                            yield VideoFrame(
                                n_before + frame.index, time_s, frame.image, frame.decoded
                            )
                self._add_notes(video.notes)
            n_before += max(self._counted_frames(segment), n_read)

    def check_unchanged(self) -> None:
        """See `RecordedVideo`."""
        for segment in self._segments:
            self._headers[segment.path].state.check_unchanged(segment.path)

    def _readable(self, paths: Sequence[Path]) -> dict[Path, VideoHeader]:
        """The headers of the readable files, each once."""
        headers: dict[Path, VideoHeader] = {}
        errors: list[VideoError] = []
        copies: list[tuple[Path, Path]] = []
        known: dict[tuple[int, tuple[bytes, ...]], Path] = {}
        for path in paths:
            if self._is_listed and not path.is_file():
                FileState.of(path)  # raises the error: a named file is missing
            try:
                header = VideoHeader.read(path, self._track, self._given_hz)
            except VideoError as error:
                errors.append(error)
                continue
            other = known.setdefault((header.state.n_bytes, header.state.samples), path)
            with suppress(OSError):
                if other in headers and filecmp.cmp(path, other, shallow=False):
                    copies.append((path, other))
                    continue
            headers[path] = header
        if copies:
            path, other = copies[0]
            self._setup_notes.append(
                f"{self.path}: skipped {counted(len(copies), 'copy', 'copies')} of other files, "
                f"such as {path.name}, which has the same content as {other.name}."
            )
        if not headers:
            raise (
                errors[0]
                if errors
                else VideoError(f"{self.path}: expected video files, found none.")
            )
        self._setup_notes += [f"Skipped: {error}" for error in errors[:_N_NOTES]]
        if len(errors) > _N_NOTES:
            self._setup_notes.append(
                f"{self.path}: skipped {counted(len(errors), 'file')} that cannot be read."
            )
        # one may be rotated
        sizes = Counter(tuple(sorted(header.size_px)) for header in headers.values())
        usual = max(sizes, key=lambda size: sizes[size])
        first = {tuple(sorted(header.size_px)): path for path, header in reversed(headers.items())}
        self.width_px, self.height_px = headers[first[usual]].size_px
        for size, path in first.items():
            if size != usual:
                self.check_size(headers[path].size_px, _LIKE, _ADVICE, path)
        return headers

    def _first_file(self) -> VideoFile:
        """The first file that can be decoded; earlier files are left out."""
        while True:
            try:
                return VideoFile(self._segments[0].path, self._track, self._given_hz)
            except VideoError as error:
                if len(self._segments) == 1:
                    raise
                self._setup_notes.append(f"Skipped: {error}")
                self._segments, self._starts_s = self._segments[1:], self._starts_s[1:]

    def _opened(self, segment: SegmentFacts) -> VideoFile | None:
        """The file, ready to read; None = it cannot be decoded, which is noted."""
        current, self._current = self._current, None
        if current is not None and current.path == segment.path:
            return current
        if current is not None:
            current.close()
        if not segment.path.exists():
            raise VideoError(
                f"{segment.path}: the file was deleted or moved while the recording was read; "
                "repeat the run."
            )
        self._headers[segment.path].state.check_unchanged(segment.path)
        try:
            video = VideoFile(segment.path, self._track, self._given_hz)
        except VideoError as error:
            self._add_notes([f"Skipped: {error}"])
            return None
        if (video.width_px, video.height_px) != (self.width_px, self.height_px):
            video.close()
            self.check_size((video.width_px, video.height_px), _LIKE, _ADVICE, segment.path)
        return video

    def _counted_frames(self, segment: SegmentFacts) -> int:
        if segment.path not in self._n_frames:
            self._n_frames[segment.path] = (
                self._headers[segment.path].n_frames or count_packets(segment.path)[0]
            )
        return self._n_frames[segment.path]

    def _add_notes(self, notes: Sequence[str]) -> None:
        self._n_notes += len(notes)
        self._reading_notes += notes[: max(0, _N_NOTES - len(self._reading_notes))]

    def _rate_notes(self) -> Iterator[str]:
        first_hz = self._headers[self._segments[0].path].fps
        for segment in self._segments:
            fps = self._headers[segment.path].fps
            if abs(fps - first_hz) > _RATE_DIFFERENCE * first_hz:
                yield (
                    f"{segment.path} has {fps:.4g} frames/s instead of {first_hz:.4g} as in "
                    f"{self._segments[0].path.name}; the time stamps are used."
                )
                return


def files_of_parts(name: Segments) -> list[Path]:
    """The video files of several names, each of which may be a folder or pattern. Errors as of
    `segment_files`.
    """
    with _checked_name(name):
        bag = next((part for part in name.paths if is_bag(part)), None)
        if bag is not None:
            raise VideoError(
                f"{bag}: expected video files, found an MCAP file or ROS bag; give one bag, or the "
                "folder of the files of one bag, such as drive_0.bag and drive_1.bag."
            )
        return [path for part in name.paths for path in (_files_in(part) or [part])]


def segment_files(name: Path) -> list[Path] | None:
    """The video files of a folder or pattern; None = a single file or a folder of images.

    Raises VideoError if no file matches a pattern, a folder contains both images and videos, or it
    cannot be read.
    """
    with _checked_name(name):
        return _files_in(name)


@contextmanager
def _checked_name(name: Path | Segments) -> Iterator[None]:
    """Raises VideoError for a name that the file system does not accept."""
    try:
        yield
    except ValueError as error:  # a null character
        raise VideoError(
            f"{quoted(str(name))}: cannot be read (invalid name); check the name."
        ) from error
    except OSError as error:
        raise VideoError(
            f"{name}: cannot be read ({describe(error)}); check its permissions."
        ) from error


def _files_in(name: Path) -> list[Path] | None:
    if is_pattern(name):
        files = [path for path in matching_files(name) if path.is_file()]
        if not files:
            raise VideoError(
                f"{name}: no such file, and no file matches this pattern; give a video, folder or "
                "pattern."
            )
        return files
    return _videos_in(name) if name.is_dir() else None


def _videos_in(name: Path) -> list[Path] | None:
    """The video files of a folder; None if there are none. See `segment_files` for the errors."""
    with readable(name, VideoError):
        files = sorted(path for path in name.iterdir() if path.name[0] != ".")
    videos = [path for path in files if path.suffix.lower() in VIDEO_SUFFIXES and path.is_file()]
    if (name / "settings.yaml").exists():  # results of a run in the folder of its input
        videos = [path for path in videos if path.name not in _RESULT_VIDEOS]
    images = [
        path
        for path in files
        if path.suffix.lower() in IMAGE_SUFFIXES and any(map(str.isdigit, path.stem))
    ]
    if videos and images:
        raise VideoError(
            f"{name}: expected videos or numbered images, found both ({videos[0].name}, "
            f"{images[0].name}); give a pattern such as '{name / ('*' + videos[0].suffix)}', or "
            "another folder."
        )
    return videos or None


def _repeated_s(before: SegmentFacts, after: SegmentFacts) -> float:
    """Time, s, from the start of `after` to the end of `before`, if its first frames are the last
    frames of `before`.

    Dashcams with an overlap write the last second of a file also to the beginning of the next file,
    without encoding it again. 0 = no compressed frame is in both, or a file cannot be read.
    """
    try:
        with closing(compressed_frames(after.path)) as beginning:
            _, first = next(beginning, (0.0, b""))
            end = list(compressed_frames(before.path, last_s=_MAX_OVERLAP_S))
            matches = [number for number, (_, content) in enumerate(end) if content == first]
            if not first or len(matches) != 1:
                return 0.0
            repeated = end[matches[0] :]
            is_equal = all(content == next(beginning, (0.0, b""))[1] for _, content in repeated[1:])
    except VideoError:
        return 0.0
    if not is_equal or sum(len(content) for _, content in repeated) < _MIN_REPEATED_BYTES:
        return 0.0
    return before.first_s + before.duration_s - repeated[0][0]
