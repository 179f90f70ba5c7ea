"""open_video: the file, files, folder or topic of a bag with a name, as a `RecordedVideo`."""

from typing import Unpack

from track_range.recording.sources.names import VideoName, recorded
from track_range.recording.video.options import DEFAULTS, RecordingKeywords, RecordingOptions
from track_range.recording.video.recorded_video import RecordedVideo
from track_range.recording.video.video import Video


def open_video(
    name: VideoName,
    options: RecordingOptions = DEFAULTS,
    *,
    left: Video | None = None,
    **keywords: Unpack[RecordingKeywords],
) -> RecordedVideo:
    """A video file, several files that are one recording, a folder of numbered images, or a topic
    of a bag.

    Of the options, which `keywords` replace one by one, those of one video are used: the part to
    read begins `start_s` after the first frame, for the right video of a pair after the first frame
    of `left`. Raises VideoError if the path does not exist or is no video, nothing can be decoded,
    or the images are too small.
    """
    return recorded(name).open(options.replaced(keywords), left)
