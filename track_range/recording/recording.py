"""open_recording: one video or a pair as rectified frames; each video is opened and decoded once.

open the videos -> find and check the calibration -> check and align with the first frames ->
rectified frames
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path

from track_range.foundation.progress import StepProgress, no_progress
from track_range.recording.cameras.auto_alignment import given_alignment
from track_range.recording.cameras.calibration import (
    LensView,
    RecordingCalibration,
    Video,
    find_calibration,
)
from track_range.recording.pairs.aligner import (
    ESTIMATION_SPAN_S,
    LIVE,
    RECORDED,
    PairAligner,
)
from track_range.recording.pairs.live_pair import LivePair
from track_range.recording.pairs.packed_pair import PackedPair, pair_in
from track_range.recording.pairs.recorded_pair import RecordedPair
from track_range.recording.pairs.stereo_layout import find_layout, mono_notes
from track_range.recording.pairs.sync_monitor import SyncMonitor
from track_range.recording.pairs.video_pair import VideoPair
from track_range.recording.sources.bags.bag import is_bag
from track_range.recording.sources.files.image_names import stereo_images
from track_range.recording.sources.live.live_video import LiveVideo
from track_range.recording.sources.open_video import open_video
from track_range.recording.video.address import LiveAddress
from track_range.recording.video.frame import VideoError
from track_range.recording.video.names import (
    BagTopic,
    Bayer,
    Half,
    LayoutOption,
    RecordedName,
    Segments,
    VideoName,
    VideoTrack,
    video_name,
)
from track_range.recording.video.recorded_video import RecordedVideo
from track_range.recording.video.utc import UtcStart, parsed_utc
from track_range.stereo.alignment.pair_finding import PairFinding
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.focal_guess import FocalGuess
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig

PairedVideos = RecordedPair | LivePair | PackedPair


@dataclass(frozen=True, slots=True)
class Recording:
    """An opened recording."""

    # rectified (one camera: undistorted) frames, to be iterated once; closing it closes the videos
    frames: Generator[Frame, None, None]
    source: Video | PairedVideos  # the opened video, or two, paired by time
    opened: RecordingCalibration  # the camera models, with the alignment of the first frame
    # aligns and checks a pair while its frames are iterated; None = one camera
    aligner: PairAligner | None = None
    layout_notes: tuple[str, ...] = ()  # about images of two cameras in one recording
    # UTC of the first frame as given by the user; None = that of the video
    start_utc: UtcStart | None = None
    every: int = 1  # each how many frames of the videos are frames of the recording

    @property
    def videos(self) -> tuple[Video, ...]:
        """The left or only video, and the right video."""
        return _videos(self.source)

    @property
    def calibration(self) -> RecordingCalibration:
        """The camera models; the history of the alignment is that of the frames so far."""
        if self.aligner is None:
            return self.opened
        return replace(self.opened, alignment=self.aligner.calibration.alignment)

    def with_focal_length(self, guess: FocalGuess) -> Recording:
        """An uncalibrated recording with another focal length."""
        return replace(self, opened=self.opened.with_focal_length(guess))

    @property
    def camera(self) -> PinholeCamera:
        """Model of the left or only camera of the rectified frames."""
        return self.opened.camera

    @property
    def rig(self) -> StereoRig | None:
        """The rectified pair with the alignment of its first frame; None = one camera, or a pair
        without a rig that fits its images.
        """
        return self.opened.rig

    @property
    def alignment(self) -> Alignment | None:
        """The correction of the disparities of the first frame; None = no rig.

        Each frame holds its own one (`Frame.alignment`), which follows the drift of the rig.
        """
        return None if self.rig is None else self.rig.alignment

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the rectified frames."""
        return self.camera.width_px, self.camera.height_px

    @property
    def fps(self) -> float:
        """Nominal frame rate."""
        return self.videos[0].fps / self.every

    @property
    def n_frames(self) -> int | None:
        """Estimated number of frames; None = unknown."""
        n_frames = self.videos[0].n_frames
        return None if n_frames is None else math.ceil(n_frames / self.every)

    @property
    def n_total(self) -> int | None:
        """Estimated number of frames of the whole video, also where only a part is read; None =
        unknown.
        """
        video = self.videos[0]
        return video.n_total if isinstance(video, RecordedVideo) else video.n_frames

    @property
    def live(self) -> LiveVideo | None:
        """The left video, or the video of both cameras, if it is a camera or a stream, else
        None.
        """
        video = self.source.whole if isinstance(self.source, PackedPair) else self.videos[0]
        return video if isinstance(video, LiveVideo) else None

    @property
    def busy_s(self) -> float:
        """Time spent reading and decoding so far, s, summed over both videos."""
        return sum(video.busy_s for video in self.videos)

    @property
    def utc(self) -> UtcStart | None:
        """UTC of the left video's first frame; None = unknown."""
        return self.start_utc or self.videos[0].utc

    @property
    def finding(self) -> PairFinding | None:
        """How the first images fit the rig; None = no pair, without checks, or not known yet."""
        return None if self.aligner is None else self.aligner.finding

    @property
    def sync(self) -> SyncMonitor | None:
        """The check that left and right show the same moment; None = no pair, or without checks."""
        return None if self.aligner is None else self.aligner.sync

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user about the recording; complete only after the last frame."""
        utc = self.utc
        sources = (
            self.layout_notes,
            self.calibration.notes,
            *(video.notes for video in self.videos),
            self.source.notes if isinstance(self.source, VideoPair) else (),
            (utc.note(),) if utc is not None else (),
            () if self.aligner is None else self.aligner.notes,
        )
        return tuple(note for notes in sources for note in notes if note)

    def close(self) -> None:
        """Close the videos."""
        self.frames.close()
        self.source.close()


def open_recording(
    left: str | VideoName | Sequence[str | Path],
    right: str | VideoName | Sequence[str | Path] | None = None,
    *,
    rig: str | Path | StereoRig | None = None,
    focal_px: float | None = None,
    fov_deg: float | None = None,
    yaw_deg: float = 0.0,
    align: str | Path | Alignment = "auto",
    start_s: float = 0.0,
    duration_s: float | None = None,
    every: int = 1,
    folder_fps: float = 10.0,
    has_checks: bool = True,
    start_utc: str | None = None,
    topics: Sequence[str] = (),
    stereo_layout: LayoutOption | None = None,
    track: int | None = None,
    bayer: Bayer | None = None,
    progress: StepProgress = no_progress,
) -> Recording:
    """Open one video or a pair for one pass over its rectified frames.

    Args:
        left: video file, several files of one recording, folder of such files or of numbered
            images, camera (0, /dev/video0) or stream (rtsp://...).
        right: the same for the right camera; None = one camera, or with `stereo_layout` both in one
            recording.
        rig: calibration file (rig.yaml, or the file of a camera or a script), or the models of two
            cameras, of which one video uses the left one; None = a file next to `left`, if any.
        focal_px: focal length of cameras without a calibration file.
        fov_deg: horizontal field of view, 20 to 120 degrees, to which the images of wide lenses are
            undistorted; None = the lens's, up to 120 degrees.
        yaw_deg: direction of the axis of the undistorted images of one camera with a wide lens, to
            the right of the lens axis.
        align: disparity correction of a calibrated pair: "auto" = estimated from its first frames
            (at most 8 s), "off", an alignment file, or an alignment.
        start_s: start of the part to read, in seconds after the left video's first frame.
        duration_s: length of the part to read; None = to the end.
        every: N = every N-th frame is read; the checks of a recorded pair use all frames.
        folder_fps: frame rate of folders of images without timestamps.txt.
        has_checks: whether calibrated pairs are checked for swapped, misaligned or unsynchronised
            videos, and frames that lag are re-paired.
        start_utc: UTC of the left video's first frame, in ISO 8601; None = from the video.
        topics: topics of the images of the left and right camera, if `left` and `right` are MCAP
            files or ROS bags.
        stereo_layout: layout of the images of two cameras in one recording: "side-by-side",
            "right-left", "top-bottom", "bottom-top", "tracks" (two video tracks), or "auto" =
            detected.
        track: video track of the files of one camera, counted from 0; None = the largest track.
        bayer: Bayer filter of images in folders: "rggb", "bggr", "gbrg" or "grbg".
        progress: shows the progress of the alignment's estimation.

    Raises:
        ValueError: `start_utc` is not a date and time, or no video is named.
        VideoError: a video cannot be used, or the two do not match.
        RigError: no usable calibration, a calibration that does not fit the images, or left and
            right are swapped.

    Example:
        >>> import track_range as tr
        >>> recording = tr.open_recording("left.mp4", "right.mp4", rig="rig.yaml", align="off")
        >>> frame = next(recording.frames)
        >>> frame.index, frame.time_s, frame.right is None
        (0, 0.0, False)
        >>> recording.close()
    """
    names = _named(
        video_name(left), None if right is None else video_name(right), topics, track, stereo_layout
    )
    names, folder_notes = _sides(*names, stereo_layout)
    utc = None if start_utc is None else parsed_utc(start_utc)
    reading = _Reading(start_s, duration_s, every, folder_fps, bayer)
    with ExitStack() as on_error:
        source, layout_notes = _opened(*names, reading, stereo_layout, on_error)
        calibration = find_calibration(
            names[0],
            _videos(source),
            rig=Path(rig) if isinstance(rig, str) else rig,
            focal_px=focal_px,
            view=LensView(fov_deg, yaw_deg),
        )
        aligner = None
        if isinstance(source, VideoPair):
            policy = replace(LIVE if source.is_live else RECORDED, has_checks=has_checks)
            given = None if calibration.rig is None else given_alignment(align, calibration.rig)
            is_packed = names[1] is None and calibration.rig is not None
            aligner = PairAligner(calibration, policy, given, is_packed=is_packed)
            _look_ahead(aligner, source, progress)
            calibration = aligner.calibration
        on_error.pop_all()
    frames = _frames(source, calibration, aligner, utc, every)
    notes = (*folder_notes, *layout_notes)
    return Recording(frames, source, calibration, aligner, notes, utc, every)


def _sides(
    left: VideoName, right: VideoName | None, layout: LayoutOption | None
) -> tuple[tuple[VideoName, VideoName | None], tuple[str, ...]]:
    """The names, with both sides of a folder that contains the images of two cameras, and a note on
    them.
    """
    if right is not None or layout != "auto" or not (isinstance(left, Path) and left.is_dir()):
        return (left, right), ()
    sides = stereo_images(left)
    if sides is None:
        return (left, right), ()
    note = f"{left}: the left images are {sides[0].name}, the right images {sides[1].name}."
    return sides, (note,)


@dataclass(frozen=True, slots=True)
class _Reading:
    """The part of a recording that is read, and how folders of images are."""

    start_s: float
    duration_s: float | None
    every: int
    folder_fps: float
    bayer: Bayer | None

    def recorded(self, name: RecordedName, left: RecordedVideo | None = None) -> RecordedVideo:
        """A recorded video, which may be the right one of a pair."""
        return open_video(
            name,
            folder_fps=self.folder_fps,
            start_s=self.start_s,
            duration_s=self.duration_s,
            left=left,
            bayer=self.bayer,
        )

    def opened(self, name: VideoName, left: Video | None = None) -> Video:
        """A recorded or live video, which may be the right one of a pair."""
        if not isinstance(name, LiveAddress):
            return self.recorded(name, left if isinstance(left, RecordedVideo) else None)
        return LiveVideo(
            name,
            start_s=self.start_s,
            duration_s=self.duration_s,
            every=self.every,
            is_partner=left is not None,
        )


def _opened(
    left: VideoName,
    right: VideoName | None,
    reading: _Reading,
    layout: LayoutOption | None,
    on_error: ExitStack,
) -> tuple[Video | PairedVideos, tuple[str, ...]]:
    """The opened video or pair, and notes on images of two cameras in one recording."""
    video = reading.opened(left)
    on_error.callback(video.close)
    source: Video | PairedVideos = video
    notes: tuple[str, ...] = ()
    if right is not None:
        other = reading.opened(right, left=video)
        on_error.callback(other.close)
        source = _paired(video, other)
    elif not isinstance(left, Half):
        if layout is None:
            notes = mono_notes(video)
        else:
            chosen = find_layout(video, layout)
            source = pair_in(video, left, chosen.layout, reading.recorded)
            notes = (chosen.sentence(str(left)),)
    video.forget_first_image()
    on_error.callback(source.close)
    return source, notes


def _videos(source: Video | PairedVideos) -> tuple[Video, ...]:
    return (source.left, source.right) if isinstance(source, VideoPair) else (source,)


def _paired(left: Video, right: Video) -> RecordedPair | LivePair:
    if isinstance(left, LiveVideo) and isinstance(right, LiveVideo):
        return LivePair(left, right)
    if isinstance(left, RecordedVideo) and isinstance(right, RecordedVideo):
        return RecordedPair(left, right)
    raise VideoError(
        f"{left.path} and {right.path}: expected two recorded videos or two live streams, got one "
        "of each; both must be of the same kind."
    )


def _named(
    left: VideoName,
    right: VideoName | None,
    topics: Sequence[str],
    track: int | None,
    layout: LayoutOption | None,
) -> tuple[VideoName, VideoName | None]:
    """The names, with topics for bags; raises VideoError if a video is no bag, or the number of
    topics does not fit.
    """
    if right == left and layout is not None and len(topics) < 2:
        right = None  # both cameras in one recording
    if track is not None and isinstance(left, Path | Segments) and right is None:
        return VideoTrack(left, track), None
    if not topics:
        return left, right
    names = [left] if right is None else [left, right]
    if len(names) != len(topics):
        raise VideoError(
            f"{left}: expected {'one topic' if right is None else 'the topics LEFT,RIGHT'}, got "
            f"{len(topics)}; correct --topics."
        )
    for name in names:
        if not (isinstance(name, Path) and is_bag(name)):
            raise VideoError(
                f"{name}: expected an MCAP file or ROS bag, since topics are given; omit --topics."
            )
    tagged = [
        BagTopic(name, topic)
        for name, topic in zip(names, topics, strict=True)
        if isinstance(name, Path)
    ]
    return tagged[0], None if right is None else tagged[1]


def _look_ahead(aligner: PairAligner, pair: PairedVideos, progress: StepProgress) -> None:
    """Read the first frames, until the aligner can start."""
    while aligner.is_looking:
        shown = progress if aligner.is_estimating else no_progress
        with shown("estimating the alignment") as advance:
            with closing(pair.read_ahead()) as images:
                for left, right in images:
                    recorded = aligner.calibration.recorded(left, right, pair.left.first_time_s)
                    if not aligner.look(recorded):
                        break
                    advance(round(10 * aligner.looked_s), round(10 * ESTIMATION_SPAN_S))
            aligner.start()


def _frames(
    source: Video | PairedVideos,
    calibration: RecordingCalibration,
    aligner: PairAligner | None,
    utc: UtcStart | None,
    every: int,
) -> Generator[Frame, None, None]:
    """Each `every`-th frame, after all were passed to the aligner; closing the generator closes the
    videos.
    """
    video, due_index = _videos(source)[0], -1
    with closing(source), closing(iter(source)) as images:
        pairs = (image if isinstance(image, tuple) else (image, None) for image in images)
        recorded = (
            calibration.recorded(left, right, video.first_time_s, utc or video.utc)
            for left, right in pairs
        )
        if aligner is None:
            frames: Iterator[Frame] = map(calibration.rectified, recorded)
        else:
            frames = aligner.frames(recorded)
        for frame in frames:
            if frame.index >= due_index:
                due_index = frame.index + every
                yield frame
