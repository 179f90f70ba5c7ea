"""open_video: the file, files, folder or topic of a bag with a name, as a `RecordedVideo`."""

from pathlib import Path

from track_range.foundation.files.atomic_files import describe
from track_range.foundation.files.images import IMAGE_SUFFIXES
from track_range.foundation.files.input_files import quoted
from track_range.recording.sources.bags.bag import is_bag
from track_range.recording.sources.bags.bag_video import BagVideo
from track_range.recording.sources.files.image_folder import ImageFolder
from track_range.recording.sources.files.video_file import VideoFile
from track_range.recording.sources.segments.segmented_video import SegmentedVideo, segment_files
from track_range.recording.sources.video_half import VideoHalf
from track_range.recording.video.address import LiveAddress
from track_range.recording.video.frame import VideoError
from track_range.recording.video.names import (
    BagTopic,
    Bayer,
    Half,
    RecordedName,
    Segments,
    VideoTrack,
    is_pattern,
)
from track_range.recording.video.recorded_video import RecordedVideo

_MIN_SIDE_PX = 8  # smaller videos show no road users, and their headers are usually damaged


def open_video(
    name: RecordedName,
    *,
    folder_fps: float = 10.0,
    start_s: float = 0.0,
    duration_s: float | None = None,
    left: RecordedVideo | None = None,
    bayer: Bayer | None = None,
) -> RecordedVideo:
    """A video file, several files that are one recording, a folder of numbered images, or a topic
    of a bag.

    The part to read begins `start_s` after the first frame, for the right video of a pair after the
    first frame of `left`; `folder_fps` is the frame rate of a folder without times, `bayer` the
    filter of its images. Raises VideoError if the path does not exist or is no video, nothing can
    be decoded, or the images are too small.
    """
    video = _opened(name, folder_fps, left, bayer)
    if min(video.width_px, video.height_px) < _MIN_SIDE_PX:
        video.close()
        raise VideoError(
            f"{name}: expected images of at least {_MIN_SIDE_PX}x{_MIN_SIDE_PX} px, found "
            f"{video.width_px}x{video.height_px} px; check the video."
        )
    video.select(start_s, duration_s, origin_s=None if left is None else left.first_time_s)
    return video


def _opened(
    named: RecordedName | LiveAddress,
    folder_fps: float,
    left: RecordedVideo | None,
    bayer: Bayer | None,
) -> RecordedVideo:
    if isinstance(named, Half):
        return VideoHalf(_opened(named.recording, folder_fps, left, bayer), named)
    if isinstance(named, LiveAddress):
        raise VideoError(f"{named}: expected a recording, found a live source.")
    name, track = (
        (named.recording, named.number) if isinstance(named, VideoTrack) else (named, None)
    )
    if isinstance(name, Path) and is_bag(name):
        name = BagTopic(name, None)
    if isinstance(name, BagTopic):
        return BagVideo(name)
    try:
        files = segment_files(name)
    except ValueError as error:  # a null character
        raise VideoError(
            f"{quoted(str(name))}: cannot be read (invalid name); check the name."
        ) from error
    except OSError as error:
        raise VideoError(
            f"{name}: cannot be read ({describe(error)}); check its permissions."
        ) from error
    is_images = all(file.suffix.lower() in IMAGE_SUFFIXES for file in files or ())
    if files and is_images and isinstance(name, Path) and is_pattern(name):
        return ImageFolder(name, fps=folder_fps, bayer=bayer)
    if files is not None and (len(files) > 1 or isinstance(name, Segments)):
        return SegmentedVideo(
            name, files, left=left if isinstance(left, SegmentedVideo) else None, track=track
        )
    if files:
        return VideoFile(files[0], track)
    if isinstance(name, Segments):
        raise VideoError(f"{name}: expected video files, found none.")
    if name.is_fifo():
        raise VideoError(
            f"{name}: expected a video file, found a named pipe; give a stream by its address, "
            "such as udp://127.0.0.1:5000, or record it to a file first."
        )
    return (
        ImageFolder(name, fps=folder_fps, bayer=bayer) if name.is_dir() else VideoFile(name, track)
    )
