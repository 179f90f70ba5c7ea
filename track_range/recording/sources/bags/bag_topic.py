"""BagTopic: the name of a topic of a bag."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from track_range.recording.video.source_name import RecordedName

if TYPE_CHECKING:
    from track_range.recording.sources.bags.bag_video import BagVideo
    from track_range.recording.video.options import RecordingOptions
    from track_range.recording.video.video import Video


@dataclass(frozen=True, slots=True)
class BagTopic(RecordedName):
    """A topic with images (None = the only topic) of an MCAP file, ROS bag, or folder of a ROS 2
    bag.
    """

    path: Path
    topic: str | None

    def __str__(self) -> str:
        return str(self.path) if self.topic is None else f"{self.path} ({self.topic})"

    @property
    def paths(self) -> tuple[Path, ...]:
        """See `SourceName`."""
        return (self.path,)

    def open_whole(self, options: "RecordingOptions", left: "Video | None" = None) -> "BagVideo":
        """See `RecordedName`."""
        from track_range.recording.sources.bags.bag_video import BagVideo

        return BagVideo(self)
