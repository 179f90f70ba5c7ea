"""LiveAddress: the address of a camera or a network stream: `0`, `/dev/video0`, `rtsp://...`,
`http://...`.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from track_range.recording.video.source_name import SourceName

if TYPE_CHECKING:
    from track_range.recording.sources.live.live_video import LiveVideo
    from track_range.recording.video.options import RecordingOptions
    from track_range.recording.video.video import Video

_SCHEMES = frozenset("http https mms rtmp rtmps rtp rtsp rtsps srt tcp udp".split())
_CREDENTIALS = re.compile(r"://\S*@")
_PASSWORD = re.compile(
    r"(?<=[?&])((?:user|username|usr|password|pass|passwd|pwd)=)[^&#]*", re.IGNORECASE
)
_NUMBER = re.compile(r"\d{1,3}")

_LOW_LATENCY = {
    "fflags": "nobuffer",
    "flags": "low_delay",
    "analyzeduration": "2000000",
    "fpsprobesize": "2",
}
"""FFmpeg options that disable buffering and limit the probing of a stream to 2 s."""

# FFmpeg's protocols of a stream: without files, which a playlist of the server may name
_NETWORK = {
    "protocol_whitelist": "crypto,http,httpproxy,https,mmsh,mmst,rtmp,rtmpe,rtmps,rtmpt,rtmpte,"
    "rtmpts,ffrtmpcrypt,ffrtmphttp,rtp,srt,srtp,tcp,tls,udp"
}


@dataclass(frozen=True, slots=True)
class LiveAddress(SourceName):
    """The address of a camera (path) or stream (URL); its text form omits the user name and
    password.
    """

    is_live: ClassVar[bool] = True
    url: str

    def __str__(self) -> str:
        return (
            self.url
            if self.is_camera
            else _PASSWORD.sub(r"\1...", _CREDENTIALS.sub("://", self.url, count=1))
        )

    @property
    def is_camera(self) -> bool:
        """Whether the source is a camera of this machine."""
        return "://" not in self.url

    @property
    def stem(self) -> str:
        """Stem of file names for this source: `video0`, `10-0-0-7-stream1`."""
        name = Path(self.url).name if self.is_camera else str(self).partition("://")[2]
        return re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-")[:60] or "live"

    @property
    def paths(self) -> tuple[Path, ...]:
        """See `SourceName`."""
        return ()

    def open(self, options: "RecordingOptions", left: "Video | None" = None) -> "LiveVideo":
        """See `SourceName`."""
        from track_range.recording.sources.live.live_video import LiveVideo

        return LiveVideo(
            self,
            start_s=options.start_s,
            duration_s=options.duration_s,
            every=options.every,
            is_partner=left is not None,
        )

    @property
    def options(self) -> dict[str, str]:
        """FFmpeg's options for opening the source."""
        if self.is_camera:
            return {}
        # With UDP, RTSP's default, lost packets leave parts of an image grey.
        is_rtsp = self.url.lower().startswith("rtsp")
        return {**_LOW_LATENCY, **_NETWORK, **({"rtsp_transport": "tcp"} if is_rtsp else {})}


def live_address(name: str) -> LiveAddress | None:
    """The camera or stream with this name; None = a file or folder. Numbers are cameras unless a
    file has the name.
    """
    scheme, colon, _ = name.partition("://")
    if colon and scheme.lower() in _SCHEMES:
        return LiveAddress(name)
    path = Path(name)
    if _NUMBER.fullmatch(name) and not path.exists():
        return LiveAddress(f"/dev/video{int(name)}")
    return LiveAddress(name) if _is_device(path) else None


def _is_device(path: Path) -> bool:
    try:
        return path.is_char_device()
    except OSError:
        return False
