"""Frames of a video as JPEG images, named like the label files of an export."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import cv2

from track_range.detection.formats.box_table import VideoFacts
from track_range.detection.formats.video_labels.coco import image_name
from track_range.foundation.arrays import Image
from track_range.recording.open_video import open_video
from track_range.run.build import open_input
from track_range.run.settings_files import settings_from

_JPEG_QUALITY = 95
"""Quality of the images, 0 to 100: differences to the video are not visible."""


def frames_of_run(folder: Path) -> Iterator[tuple[int, Image]]:
    """Number and rectified left image of each frame of a run, from its video.

    Raises:
        ConfigError, VideoError, RigError: settings.yaml or the video cannot be read.
    """
    recording = open_input(settings_from({"align": "off"}, folder / "settings.yaml"))
    with closing(recording):
        for frame in recording.frames:
            yield frame.index, frame.left


def frames_of_video(video: Path) -> Iterator[tuple[int, Image]]:
    """Number and image of each frame of a video or folder of images.

    Raises:
        VideoError: it cannot be read.
    """
    with closing(open_video(video)) as reader:
        for frame in reader:
            yield frame.index, frame.image


def write_images(frames: Iterator[tuple[int, Image]], video: VideoFacts, folder: Path) -> list[int]:
    """Write images to a new folder, and return the numbers of their frames.

    Raises:
        OSError: an image cannot be written.
    """
    folder.mkdir()
    numbers = []
    for index, image in frames:
        _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        (folder / image_name(video, index)).write_bytes(encoded.tobytes())
        numbers.append(index)
    return numbers
