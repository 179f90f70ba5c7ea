"""open_recording: one video or a pair as rectified frames; each video is opened and decoded once.

open the videos -> find and check the calibration -> check and align with the first frames ->
rectified frames
"""

import math
from collections.abc import Generator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from track_range.foundation.progress import StepProgress, no_progress
from track_range.recording.bags.bag import is_bag
from track_range.recording.cameras.calibration import (
    LensView,
    RecordingCalibration,
    Video,
    assumed_rig,
    find_calibration,
)
from track_range.recording.files.image_names import stereo_images
from track_range.recording.frame import VideoError
from track_range.recording.live.address import LiveAddress
from track_range.recording.live.live_video import LiveVideo
from track_range.recording.names import (
    BagTopic,
    Bayer,
    Half,
    LayoutOption,
    Segments,
    VideoName,
    VideoTrack,
    video_name,
)
from track_range.recording.open_video import open_video
from track_range.recording.pairs.auto_alignment import (
    ESTIMATION_SPAN_S,
    PairAlignment,
    find_alignment,
    given_alignment,
)
from track_range.recording.pairs.live_pair import LivePair
from track_range.recording.pairs.packed_pair import PackedPair, pair_in
from track_range.recording.pairs.pair_monitor import PairMonitor
from track_range.recording.pairs.recorded_pair import RecordedPair
from track_range.recording.pairs.stereo_layout import find_layout, mono_notes
from track_range.recording.pairs.sync_monitor import PERIOD, SyncMonitor
from track_range.recording.pairs.video_pair import VideoPair
from track_range.recording.recorded_video import RecordedVideo
from track_range.recording.threads import FRAMES_AHEAD
from track_range.recording.utc import UtcStart, parsed_utc
from track_range.stereo.alignment.drift import DriftMonitor
from track_range.stereo.alignment.from_drive import MIN_STEP_S
from track_range.stereo.alignment.model import Alignment, AlignmentSource
from track_range.stereo.alignment.pair_finding import LATER, PairFinding
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig

PairedVideos = RecordedPair | LivePair | PackedPair
# a check that receives each frame once, in order of time
Monitor = PairMonitor | SyncMonitor | DriftMonitor

_UNSTEADY = (
    "not measured, since the vertical offset between left and right changes, as in images of "
    "different times"
)

# frames between two checks of the synchronisation of those from which the alignment is estimated
_FIRST_PERIOD = 2


@dataclass(frozen=True, slots=True)
class Recording:
    """An opened recording."""

    # rectified (one camera: undistorted) frames, to be iterated once; closing it closes the videos
    frames: Generator[Frame, None, None]
    source: Video | PairedVideos  # the opened video, or two, paired by time
    calibration: RecordingCalibration  # the camera models
    # the checks of a pair that continue while its frames are iterated
    monitors: tuple[Monitor, ...]
    layout_notes: tuple[str, ...] = ()  # about images of two cameras in one recording
    # UTC of the first frame as given by the user; None = that of the video
    start_utc: UtcStart | None = None
    every: int = 1  # each how many frames of the videos are frames of the recording

    @property
    def videos(self) -> tuple[Video, ...]:
        """The left or only video, and the right video."""
        return (
            (self.source.left, self.source.right)
            if isinstance(self.source, VideoPair)
            else (self.source,)
        )

    @property
    def camera(self) -> PinholeCamera:
        """Model of the left or only camera of the rectified frames."""
        return self.calibration.camera

    @property
    def rig(self) -> StereoRig | None:
        """The rectified pair with its alignment; None = one camera, or a pair without a rig that
        fits its images.
        """
        return self.calibration.rig

    @property
    def alignment(self) -> AlignmentSource | None:
        """The correction of the disparities of the rectified frames; None = no rig."""
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
        return next(
            (monitor.finding for monitor in self.monitors if isinstance(monitor, PairMonitor)), None
        )

    @property
    def sync(self) -> SyncMonitor | None:
        """The check that left and right show the same moment; None = no pair, or without checks."""
        return next(
            (monitor for monitor in self.monitors if isinstance(monitor, SyncMonitor)), None
        )

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
            *(monitor.notes for monitor in self.monitors),
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
    left, right = _named(
        video_name(left), None if right is None else video_name(right), topics, track, stereo_layout
    )
    layout_notes: tuple[str, ...] = ()
    if right is None and stereo_layout == "auto" and isinstance(left, Path) and left.is_dir():
        folder, sides = left, stereo_images(left)
        if sides is not None:
            left, right = sides
            layout_notes = (
                f"{folder}: the left images are {left.name}, the right images {right.name}.",
            )
    utc = None if start_utc is None else parsed_utc(start_utc)

    recorded = partial(
        open_video, folder_fps=folder_fps, start_s=start_s, duration_s=duration_s, bayer=bayer
    )

    def opened(name: VideoName, beside: Video | None = None) -> Video:
        if isinstance(name, LiveAddress):
            return LiveVideo(
                name,
                start_s=start_s,
                duration_s=duration_s,
                every=every,
                is_partner=beside is not None,
            )
        return recorded(name, left=beside if isinstance(beside, RecordedVideo) else None)

    with ExitStack() as on_error:
        video = opened(left)
        on_error.callback(video.close)
        source: Video | PairedVideos = video
        if right is None and stereo_layout is not None and not isinstance(left, Half):
            chosen = find_layout(video, stereo_layout)
            source, layout_notes = (
                pair_in(video, left, chosen.layout, recorded),
                (chosen.sentence(str(left)),),
            )
        elif right is not None:
            other = opened(right, beside=video)
            on_error.callback(other.close)
            source = _paired(video, other)
        elif not isinstance(left, Half):
            layout_notes = mono_notes(video)
        video.first_image = None
        on_error.callback(source.close)
        videos = (source.left, source.right) if isinstance(source, VideoPair) else (source,)
        given_rig, view = Path(rig) if isinstance(rig, str) else rig, LensView(fov_deg, yaw_deg)
        calibration = find_calibration(left, videos, rig=given_rig, focal_px=focal_px, view=view)
        monitors: tuple[Monitor, ...] = ()
        if isinstance(source, VideoPair) and calibration.rig is not None:
            check = PairMonitor(calibration.rig, is_packed=right is None) if has_checks else None
            calibration = _aligned(calibration, calibration.rig, source, align, check, progress)
            monitors = () if check is None else (check,)
            if has_checks and calibration.rig is not None:
                monitors += _sync_monitors(source)
            monitors += _drift_monitors(calibration, source)
        elif isinstance(source, VideoPair):
            check = PairMonitor(assumed_rig(calibration.camera))
            with closing(_first_frames(calibration, source, check)) as first_frames:
                check.watch(first_frames)
            check.finish()
            if check.row_offset_px is not None:
                calibration = calibration.with_row_offset(check.row_offset_px)
                monitors = _sync_monitors(source)
        on_error.pop_all()
    frames = _frames(source, calibration, monitors, utc, every)
    return Recording(frames, source, calibration, monitors, layout_notes, utc, every)


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


def _aligned(
    calibration: RecordingCalibration,
    rig: StereoRig,
    pair: PairedVideos,
    align: str | Path | Alignment,
    check: PairMonitor | None,
    progress: StepProgress,
) -> RecordingCalibration:
    """A calibrated pair with its alignment and the repairs of `check`; without its rig if the
    images do not fit it.
    """
    given = given_alignment(align, rig)
    started = calibration if given is None else calibration.with_alignment(given)
    with closing(_first_frames(started, pair, check)) as first_frames:
        alignment = find_alignment(given or "auto", rig, first_frames, progress)
        if given is not None and check is not None:
            check.watch(first_frames)
    finding = None if check is None else check.finish()
    if check is None or finding is None:
        return calibration.with_alignment(alignment)
    if given is not None:
        check.finding = finding = finding.uncorrected()
    if not finding.has_stereo:
        return replace(calibration, rig=None)
    if finding.fault == "turned":
        calibration = calibration.turned()
    if given is None and finding.fault == "unsteady":
        alignment = PairAlignment(measured=Alignment(source=_UNSTEADY), is_applied=False, rig=rig)
    elif given is None and finding != PairFinding("fits") and finding.fault != "unknown":
        corrected = calibration.with_alignment(
            PairAlignment(measured=finding.prior, is_applied=True, rig=rig)
        )
        with closing(_first_frames(corrected, pair, check)) as first_frames:
            alignment = find_alignment("auto", rig, first_frames, progress, prior=finding.prior)
    check.corrected_px = alignment.measured.row_correction_px
    return calibration.with_alignment(alignment)


def _drift_monitors(calibration: RecordingCalibration, pair: PairedVideos) -> tuple[Monitor, ...]:
    """The monitor of a recorded pair whose alignment was measured; none for streams, which a
    monitor would delay.
    """
    alignment = calibration.alignment
    monitor = (
        None
        if alignment is None or calibration.rig is None
        else alignment.drift_monitor(calibration.rig)
    )
    return () if monitor is None or pair.is_live else (monitor,)


def _sync_monitors(pair: PairedVideos, *, period: int = PERIOD) -> tuple[SyncMonitor]:
    """The monitor that re-pairs frames; frames of streams do not wait for later frames."""
    return (SyncMonitor(0 if pair.is_live else FRAMES_AHEAD, period),)


def _first_frames(
    calibration: RecordingCalibration, pair: PairedVideos, check: PairMonitor | None
) -> Generator[Frame, None, None]:
    """Frames of the first seconds at the interval that the alignment needs; with `check`, re-paired
    and checked.
    """
    first_s, last_s = math.nan, -math.inf
    with closing(pair.read_ahead()) as images:
        frames = (calibration.frame(left, right, pair.left.first_time_s) for left, right in images)
        for frame in (
            frames
            if check is None
            else _sync_monitors(pair, period=_FIRST_PERIOD)[0].paired(frames)
        ):
            first_s = frame.time_s if math.isnan(first_s) else first_s
            if frame.time_s - last_s >= MIN_STEP_S:
                if check is not None:
                    check.add(frame)
                last_s = frame.time_s
                yield frame
            if frame.time_s - first_s > ESTIMATION_SPAN_S:
                return


def _frames(
    source: Video | PairedVideos,
    calibration: RecordingCalibration,
    monitors: tuple[Monitor, ...],
    utc: UtcStart | None,
    every: int,
) -> Generator[Frame, None, None]:
    """Each `every`-th frame, after all were passed to the monitors; closing the generator closes
    the videos.
    """
    video = source.left if isinstance(source, VideoPair) else source
    sync = next((monitor for monitor in monitors if isinstance(monitor, SyncMonitor)), None)
    check = next((monitor for monitor in monitors if isinstance(monitor, PairMonitor)), None)
    explained, has_stereo = None if check is None else check.finding, True
    due_index = -1
    with closing(source), closing(iter(source)) as images:
        pairs = (image if isinstance(image, tuple) else (image, None) for image in images)
        frames = (
            calibration.frame(left, right, video.first_time_s, utc or video.utc)
            for left, right in pairs
        )
        for frame in frames if sync is None else sync.paired(frames):
            for monitor in monitors:
                if not isinstance(monitor, SyncMonitor):
                    monitor.add(frame)
            if check is not None and check.finding is not explained and check.finding is not None:
                check.finding = explained = check.finding.uncorrected(LATER)
                has_stereo = explained.has_stereo
            if frame.index >= due_index:
                due_index = frame.index + every
                yield frame if has_stereo else replace(frame, right=None)
