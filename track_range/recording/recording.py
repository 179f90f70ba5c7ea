"""open_recording: one video or a pair as rectified frames; each video is opened and decoded once.

open the videos -> find and check the calibration -> check and align with the first frames ->
rectified frames
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Unpack

from track_range.foundation.progress import StepProgress, no_progress
from track_range.recording.cameras.auto_alignment import given_alignment
from track_range.recording.cameras.calibration import (
    LensView,
    RecordingCalibration,
    find_calibration,
    names_of,
)
from track_range.recording.cameras.camera_estimate import CameraEstimate
from track_range.recording.cameras.known_lenses import GivenLens
from track_range.recording.pairs.aligner import (
    ESTIMATION_SPAN_S,
    LIVE,
    RECORDED,
    PairAligner,
)
from track_range.recording.pairs.clock_offset import searched_offset
from track_range.recording.pairs.live_pair import LivePair
from track_range.recording.pairs.packed_pair import PackedPair, pair_in
from track_range.recording.pairs.recorded_pair import RecordedPair
from track_range.recording.pairs.stereo_layout import find_layout, mono_notes
from track_range.recording.pairs.sync_monitor import SyncMonitor
from track_range.recording.sources.live.live_video import LiveVideo
from track_range.recording.sources.names import VideoName, source_of, video_name
from track_range.recording.video.frame import VideoError
from track_range.recording.video.options import DEFAULTS, RecordingKeywords, RecordingOptions
from track_range.recording.video.recorded_video import RecordedVideo
from track_range.recording.video.source_name import SourceName
from track_range.recording.video.utc import UtcStart, parsed_utc
from track_range.recording.video.video import Video
from track_range.stereo.alignment.common_moment import ClockOffset
from track_range.stereo.alignment.pair_finding import PairFinding
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import RigError, StereoRig

PairedVideos = RecordedPair | LivePair | PackedPair


@dataclass(frozen=True, slots=True)
class Recording:
    """An opened recording."""

    # rectified (one camera: undistorted) frames, to be iterated once; closing it closes the videos
    frames: Generator[Frame, None, None]
    videos: tuple[Video, ...]  # the left or only video, and the right one
    pair: PairedVideos | None  # the two, paired by time; None = one camera
    opened: RecordingCalibration  # the camera models, with the alignment of the first frame
    options: RecordingOptions = DEFAULTS
    # aligns and checks a pair while its frames are iterated; None = one camera
    aligner: PairAligner | None = None
    layout_notes: tuple[str, ...] = ()  # about images of two cameras in one recording
    # UTC of the first frame as given by the user; None = that of the video
    start_utc: UtcStart | None = None

    @property
    def calibration(self) -> RecordingCalibration:
        """The camera models; the history of the alignment is that of the frames so far."""
        if self.aligner is None:
            return self.opened
        return replace(self.opened, alignment=self.aligner.calibration.alignment)

    def with_camera(self, estimate: CameraEstimate) -> Recording:
        """An uncalibrated recording, of which no frame was read, with an estimated camera."""
        opened = self.opened.with_estimate(estimate)
        source = self.pair or self.videos[0]
        frames = _frames(
            source, self.videos[0], opened, self.aligner, self.start_utc, self.options.every
        )
        self.frames.close()
        return replace(self, opened=opened, frames=frames)

    def near_keyframes(self, burst_s: float) -> Recording:
        """The recording, of which no frame was read, with the images up to a time after each
        keyframe alone; see `Video.burst_s`.
        """
        self.videos[0].whole.burst_s = burst_s
        return self

    @property
    def camera(self) -> PinholeCamera:
        """Model of the left or only camera of the rectified frames."""
        return self.opened.camera

    @property
    def rig(self) -> StereoRig | None:
        """The rectified pair with the alignment of its first frame, of which a pair without a
        calibration has an assumed baseline; None = one camera, or images that do not match.
        """
        return self.opened.rig

    @property
    def calibrated_rig(self) -> StereoRig | None:
        """The rig, if its baseline is calibrated."""
        return None if self.rig is None or self.rig.is_assumed else self.rig

    @property
    def alignment(self) -> Alignment | None:
        """The correction of the disparities of the first frame; None = no rig.

        Each frame holds its own one (`Frame.alignment`).
        """
        return None if self.rig is None else self.rig.alignment

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the rectified frames."""
        return self.camera.width_px, self.camera.height_px

    @property
    def fps(self) -> float:
        """Nominal frame rate."""
        return self.videos[0].fps / self.options.every

    @property
    def n_frames(self) -> int | None:
        """Estimated number of frames; None = unknown."""
        n_frames = self.videos[0].n_frames
        return None if n_frames is None else math.ceil(n_frames / self.options.every)

    @property
    def n_total(self) -> int | None:
        """Estimated number of frames of the whole video, also where only a part is read; None =
        unknown.
        """
        return self.videos[0].n_total

    @property
    def live(self) -> LiveVideo | None:
        """The left video, or the video of both cameras, if it is a camera or a stream, else
        None.
        """
        whole = self.videos[0].whole
        return whole if isinstance(whole, LiveVideo) else None

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
            () if self.pair is None else self.pair.notes,
            (utc.note(),) if utc is not None else (),
            () if self.aligner is None else self.aligner.notes,
        )
        # depth is that of the left images
        others = {note for video in self.videos[1:] for note in video.depth_notes}
        others -= set(self.videos[0].depth_notes)
        return tuple(note for notes in sources for note in notes if note and note not in others)

    def close(self) -> None:
        """Close the videos."""
        self.frames.close()
        (self.pair or self.videos[0]).close()


def open_recording(
    left: str | VideoName | Sequence[str | Path],
    right: str | VideoName | Sequence[str | Path] | None = None,
    options: RecordingOptions = DEFAULTS,
    *,
    progress: StepProgress = no_progress,
    **keywords: Unpack[RecordingKeywords],
) -> Recording:
    """Open one video or a pair for one pass over its rectified frames.

    Args:
        left: video file, several files of one recording, folder of such files or of numbered
            images, camera (0, /dev/video0) or stream (rtsp://...).
        right: the same for the right camera; None = one camera, or with `stereo_layout` both in one
            recording.
        options: how the recording is opened, and which part of it is read.
        progress: shows the progress of the alignment's estimation.
        keywords: single options, in the place of those in `options`: `rig`, a calibration file
            (rig.yaml, or the file of a camera or a script) or the models of two cameras, by default
            a file next to `left`; `camera`, the name of the camera in a file of several, or of the
            left and the right one; `focal_px` of cameras without such a file; `fov_deg`, horizontal
            field of view to which the images of wide lenses are undistorted, and `yaw_deg`, its
            direction to the right of one camera's axis; `lens_fov_deg`, field of view on the box of
            a camera without a calibration ("140d", "120h", "70v"), or its `camera_model`; `align`,
            disparity correction of a pair: "auto" (estimated from the first frames), "off", a file
            or an alignment; `start_s` and
            `duration_s`, the part to read, in seconds; `every`, N for every N-th frame;
            `fps`, frame rate of images without times; `has_checks`, whether pairs
            are checked for swapped, misaligned and unsynchronised videos; `start_utc` of the first
            frame, in ISO 8601; `topics` of the images in bags; `stereo_layout` of two cameras in
            one recording: "side-by-side", "right-left", "top-bottom", "bottom-top", "tracks" or
            "auto"; `track`, video track of a file, counted from 0; `bayer`, filter of images in
            folders: "rggb", "bggr", "gbrg" or "grbg". Where the camera looks in its vehicle changes
            no image: it is `mount` of `Run` and `Pipeline`, or a block of rig.yaml.

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
    options = options.replaced(keywords)
    utc = None if options.start_utc is None else parsed_utc(options.start_utc)
    names, folder_notes = _names(
        source_of(video_name(left)),
        None if right is None else source_of(video_name(right)),
        options,
    )
    with ExitStack() as on_error:
        videos, pair, layout_notes = _opened(*names, options, on_error)
        rig = options.rig
        calibration = find_calibration(
            names[0],
            videos,
            rig=Path(rig) if isinstance(rig, str) else rig,
            cameras=names_of(options.camera),
            focal_px=options.focal_px,
            view=LensView(options.fov_deg, options.yaw_deg),
            lens=GivenLens(options.camera_model, options.lens_fov_deg),
        )
        calibration = replace(calibration, has_depth=videos[0].depth is not None)
        aligner = None
        if pair is not None:
            aligner = _aligner(calibration, pair, options, is_packed=names[1] is None)
            _look_ahead(aligner, pair, progress)
            calibration = aligner.calibration
        on_error.pop_all()
    return Recording(
        _frames(pair or videos[0], videos[0], calibration, aligner, utc, options.every),
        videos,
        pair,
        calibration,
        options,
        aligner,
        (*folder_notes, *layout_notes),
        utc,
    )


def _names(
    left: SourceName, right: SourceName | None, options: RecordingOptions
) -> tuple[tuple[SourceName, SourceName | None], tuple[str, ...]]:
    """The names with their topics, and both sides of a folder that contains the images of two
    cameras, with a note on these; raises VideoError if the topics do not fit.
    """
    layout, topics = options.stereo_layout, options.topics
    if right == left and layout is not None and len(topics) < 2:
        right = None  # both cameras in one recording
    if topics:
        left, right = _with_topics(left, right, topics)
    sides = left.sides() if right is None and layout == "auto" else None
    if sides is None:
        return (left, right), ()
    names = [side.files[0].name for side in sides]
    note = f"{left}: the left images are {names[0]}, the right images {names[1]}."
    return sides, (note,)


def _with_topics(
    left: SourceName, right: SourceName | None, topics: Sequence[str]
) -> tuple[SourceName, SourceName | None]:
    names = [left] if right is None else [left, right]
    if len(names) != len(topics):
        raise VideoError(
            f"{left}: expected {'one topic' if right is None else 'the topics LEFT,RIGHT'}, got "
            f"{len(topics)}; correct --topics."
        )
    tagged = [name.with_topic(topic) for name, topic in zip(names, topics, strict=True)]
    return tagged[0], None if right is None else tagged[1]


def _opened(
    left: SourceName, right: SourceName | None, options: RecordingOptions, on_error: ExitStack
) -> tuple[tuple[Video, ...], PairedVideos | None, tuple[str, ...]]:
    """The opened videos, which are one or a pair, and notes on images of two cameras in one
    recording.
    """
    video = left.open(options)
    on_error.callback(video.close)
    if video.time_question:
        raise VideoError(video.time_question)
    pair: PairedVideos | None = None
    notes: tuple[str, ...] = ()
    if right is not None:
        other = right.open(options, video)
        on_error.callback(other.close)
        pair = _paired(video, other)
    elif video.whole is video:  # not one half of a recording
        if options.stereo_layout is None:
            notes = mono_notes(video)
        else:
            chosen = find_layout(video, options.stereo_layout)
            pair = pair_in(video, left, chosen.layout, options)
            notes = (chosen.sentence(str(left)),)
    video.forget_first_image()
    if pair is None:
        return (video,), None, notes
    on_error.callback(pair.close)
    return (pair.left, pair.right), pair, notes


def _paired(left: Video, right: Video) -> RecordedPair | LivePair:
    if isinstance(left, LiveVideo) and isinstance(right, LiveVideo):
        return LivePair(left, right)
    if isinstance(left, RecordedVideo) and isinstance(right, RecordedVideo):
        return RecordedPair(left, right)
    raise VideoError(
        f"{left.path} and {right.path}: expected two recorded videos or two live streams, got one "
        "of each; both must be of the same kind."
    )


def _aligner(
    calibration: RecordingCalibration,
    pair: PairedVideos,
    options: RecordingOptions,
    *,
    is_packed: bool,
) -> PairAligner:
    policy = replace(LIVE if pair.is_live else RECORDED, has_checks=options.has_checks)
    rig = calibration.rig
    given = None if rig is None else given_alignment(options.align, rig)
    return PairAligner(calibration, policy, given, is_packed=is_packed)


def _look_ahead(aligner: PairAligner, pair: PairedVideos, progress: StepProgress) -> None:
    """Read the first frames, until the aligner can start; search the clocks' offset where they do
    not fit.
    """
    offset: ClockOffset | None = None
    while aligner.is_looking:
        shown = progress if aligner.is_estimating else no_progress
        # the aligner raises it again when it starts
        with (
            suppress(RigError),
            shown("estimating the alignment") as advance,
            closing(pair.read_ahead()) as images,
        ):
            for left, right in images:
                recorded = aligner.calibration.recorded(left, right, pair.left.first_time_s)
                if not aligner.look(recorded):
                    break
                advance(round(10 * aligner.looked_s), round(10 * ESTIMATION_SPAN_S))
        if offset is None and isinstance(pair, RecordedPair) and aligner.doubts_moments:
            offset = searched_offset(pair, aligner.calibration)
            if pair.use_offset(offset):
                aligner.look_again()
                continue
        aligner.start(offset)


def _frames(
    source: Video | PairedVideos,
    first: Video,
    calibration: RecordingCalibration,
    aligner: PairAligner | None,
    utc: UtcStart | None,
    every: int,
) -> Generator[Frame, None, None]:
    """Each `every`-th frame, after all were passed to the aligner; closing the generator closes the
    videos.
    """
    due_index = -1
    with closing(source), closing(iter(source)) as images:
        pairs = (image if isinstance(image, tuple) else (image, None) for image in images)
        recorded = (
            calibration.recorded(left, right, first.first_time_s, utc or first.utc)
            for left, right in pairs
        )
        if aligner is None:
            frames: Iterator[Frame] = map(calibration.rectified, recorded)
        else:
            frames = aligner.frames(recorded)
        for frame in frames:
            if frame.index >= due_index:
                due_index = frame.index + every
                if first.depth is not None:
                    depth_m = first.depth.at(frame.time_s + first.first_time_s)
                    frame = calibration.with_depth(frame, depth_m, first)
                yield frame
