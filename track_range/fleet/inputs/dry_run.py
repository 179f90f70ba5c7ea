"""check_clips: what a fleet would process, from the headers of the videos."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from track_range.fleet.inputs.clip import TELEMETRY_ROLE, Clip, file_title
from track_range.fleet.storage.location import FolderListings, Location
from track_range.foundation.errors import UserError
from track_range.recording.pairs.stereo_layout import find_layout
from track_range.recording.sources.bags.bag import is_bag
from track_range.recording.sources.bags.bag_topic import BagTopic
from track_range.recording.sources.files.video_file import VideoHeader
from track_range.recording.sources.open_video import open_video
from track_range.recording.sources.video_half import half_size_px
from track_range.recording.video.layouts import LayoutOption
from track_range.stereo.rig_formats.reading import find_rig, load_camera, load_rig

_BATCH = 256  # number of clips that are handed to the threads at a time
_CODEC_CROP_PX = 2  # tolerated difference in size between left and right, px, as in a run
# difference between the lengths of left and right above which there is a note, s
_MAX_DIFFERENCE_S = 1.0
_MAX_CALIBRATION_SIDE_PX = 16_384  # largest side of an image for which a calibration is checked, px


@dataclass(frozen=True, slots=True)
class CheckedClip:
    """Properties of a clip in the headers of its files; None, "" = not known."""

    clip: Clip
    size_px: tuple[int, int] | None = None  # (width, height) of the left video
    fps: float | None = None
    duration_s: float | None = None
    n_bytes: int | None = None  # of its files
    calibration: str = ""  # "file", "focal length", "bag", "camera" or "none"
    problems: tuple[str, ...] = ()  # reasons why it cannot be processed, sentences
    notes: tuple[str, ...] = ()  # other remarks


# size, frames/s, seconds (0 = not stated), has a calibration
_Header = tuple[tuple[int, int], float, float, bool]


@dataclass(slots=True)
class _Check:
    """Check of one clip, with the problems and notes so far; see `check_clips`."""

    clip: Clip
    listings: FolderListings
    focal_px: float | None
    fps: float | None
    stereo_layout: LayoutOption | None
    has_camera: bool
    cameras: Sequence[str]  # their names in calibrations of several
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def result(self) -> CheckedClip:
        properties: dict[str, Any] = {}
        try:
            if self.clip.problem:
                self.problems.append(self.clip.problem)
            else:
                properties = self._properties()
        except UserError as error:
            self.problems.append(str(error))
        return CheckedClip(
            self.clip, **properties, problems=tuple(self.problems), notes=tuple(self.notes)
        )

    def _properties(self) -> dict[str, Any]:
        files = {
            role: Location.of(address)
            for role, address in self.clip.files(self.listings.stat).items()
        }
        properties: dict[str, Any] = {"n_bytes": self._size(files)}
        videos = [files[role] for role in ("left", "right") if role in files]
        if self.problems:
            return properties
        if not all(video.is_local for video in videos):
            self.notes.append("The videos were not opened, since they are not on this machine.")
            return properties
        headers = [self._header(video.path, index) for index, video in enumerate(videos)]
        if self._layout is not None:
            headers = [self._half(videos[0].path, self._layout, headers[0])] * 2
        size_px, fps, duration_s, _ = headers[0]
        calibration = self._calibration(headers, files.get("rig"))
        if len(headers) == 2 and self.clip.right is not None:
            self._compare(headers[0], headers[1], has_rig=calibration in ("file", "bag"))
        known = {
            "size_px": size_px,
            "fps": fps or None,
            "duration_s": duration_s or None,
            "calibration": calibration,
        }
        return properties | known

    @property
    def _layout(self) -> LayoutOption | None:
        """Layout of the images of two cameras in the only video; None = there are two videos, or
        one camera.
        """
        if self.clip.right is not None:
            return None
        return cast(
            LayoutOption | None, self.clip.settings.get("stereo_layout", self.stereo_layout)
        )

    def _half(self, path: Path, layout: LayoutOption, whole: _Header) -> _Header:
        """The properties of one camera in a video with the images of two cameras."""
        if layout == "auto":
            with closing(open_video(path)) as reader:
                layout = find_layout(reader, layout).layout
        return (whole[0] if layout == "tracks" else half_size_px(layout, whole[0])), *whole[1:]

    def _size(self, files: dict[str, Location]) -> int:
        """Size of all files; missing or empty files are problems."""
        n_bytes = 0
        for role, location in files.items():
            state = self.listings.state(location)
            if state is None:
                self.problems.append(f"{location}: no such file; expected {file_title(role)}.")
            elif state.size == 0 and not role.startswith(TELEMETRY_ROLE):
                self.problems.append(
                    f"{location}: the {'folder' if state.is_folder else 'file'} is empty."
                )
            else:
                n_bytes += max(state.size, 0)
        return n_bytes

    def _header(self, path: Path, index: int) -> _Header:
        """Properties of a video, index 1 = right."""
        bag = is_bag(path)
        given = self.clip.settings.get("fps", self.fps)
        fps = None if given is None else float(given)
        if not (bag or path.is_dir()):
            header = VideoHeader.read(path, fps=fps)
            return header.size_px, header.fps, header.duration_s, False
        topics = [topic.strip() for topic in self.clip.settings.get("topics", "").split(",")]
        topic = topics[index] if index < len(topics) else ""
        with closing(open_video(BagTopic(path, topic or None) if bag else path, fps=fps)) as reader:
            has_camera = reader.camera is not None
            return (
                (reader.width_px, reader.height_px),
                reader.fps,
                (reader.n_frames or 0) / reader.fps,
                has_camera,
            )

    def _compare(self, left: _Header, right: _Header, *, has_rig: bool) -> None:
        """Compare the videos of a pair; without a rig, they must have the same size."""
        ((lw, lh), _, left_s, _), ((rw, rh), _, right_s, _) = left, right
        if not has_rig and max(abs(lw - rw), abs(lh - rh)) > _CODEC_CROP_PX:
            self.problems.append(
                f"{self.clip.right}: expected {lw}x{lh} px like the left video, found {rw}x{rh}."
            )
        if left_s and right_s and abs(left_s - right_s) > _MAX_DIFFERENCE_S:
            self.notes.append(
                f"The left video is {left_s:.1f} s long, the right one {right_s:.1f} s; frames "
                "without a partner are not used."
            )

    def _calibration(self, headers: Sequence[_Header], rig: Location | None) -> str:
        """Kind of the calibration; an unusable calibration is a problem, a missing calibration is
        noted.
        """
        if "rig" not in self.clip.settings:
            if "focal_px" in self.clip.settings or self.focal_px is not None:
                return "focal length"
            if headers[0][3]:
                return "bag"
            neighbour = find_rig(Path(self.clip.left))
            rig = None if neighbour is None else Location.of(neighbour)
        if rig is None:
            if self.clip.right is None and self._layout is None and self.has_camera:
                return "camera"
            if self.clip.right is None and self._layout is None:
                self.notes.append(
                    "No calibration: the focal length is estimated from this clip alone; for "
                    "clips of one camera, --camera NAME estimates it once."
                )
            return "none"
        if rig.is_local and max(headers[0][0]) <= _MAX_CALIBRATION_SIDE_PX:
            self._check_rig(rig.path, headers[0][0], headers[-1][0])
        return "file"

    def _check_rig(self, path: Path, left_px: tuple[int, int], right_px: tuple[int, int]) -> None:
        errors = []
        # the second sizes belong to a video that is rotated by its metadata
        for left, right in (
            (left_px, right_px),
            ((left_px[1], left_px[0]), (right_px[1], right_px[0])),
        ):
            try:
                if self.clip.right is None and self._layout is None:
                    load_camera(path, size_px=left, cameras=self.cameras)
                else:
                    load_rig(path, size_px=left, right_size_px=right, cameras=self.cameras)
                return
            except UserError as error:
                errors.append(str(error))
        self.problems.append(errors[0])


def check_clips(
    clips: Sequence[Clip],
    *,
    focal_px: float | None = None,
    fps: float | None = None,
    stereo_layout: LayoutOption | None = None,
    has_camera: bool = False,
    cameras: Sequence[str] = (),
    threads: int = 8,
) -> Iterator[CheckedClip]:
    """The clips with the properties in their headers, in the given order.

    Videos on this machine are opened, but not decoded, except the first image of folders and bags.
    Of remote clips only the existence and size of the files are known. `focal_px` and `fps` are
    as in a run, for clips without calibration and images without times,
    `stereo_layout` for single videos of two cameras; with `has_camera`, the cameras of clips without
    a calibration are estimated before the run; `cameras` are their names in calibrations of
    several; `threads` clips are checked at a time.
    """
    listings = FolderListings()

    def checked(clip: Clip) -> CheckedClip:
        return _Check(clip, listings, focal_px, fps, stereo_layout, has_camera, cameras).result()

    with ThreadPoolExecutor(threads) as pool:
        for start in range(0, len(clips), _BATCH):
            yield from pool.map(checked, clips[start : start + _BATCH])
