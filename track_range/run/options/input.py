"""Options of a run for its input: the videos, their calibration, and known facts about the
recording.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import InstanceOf, field_serializer, field_validator

from track_range.foundation.errors import ConfigError
from track_range.foundation.schemas.options import Options, option
from track_range.recording.sources.names import VideoName, source_of, video_name
from track_range.recording.telemetry.tracks.signal_choice import SignalChoice
from track_range.recording.video.layouts import Bayer, LayoutOption
from track_range.recording.video.source_name import SourceName
from track_range.recording.video.utc import parsed_utc

# a path, or a name of another kind that is already read
_SourceName = Path | InstanceOf[SourceName]
_clip_option = partial(option, is_per_clip=True)
# of the camera and of the recording, which the detector does not know: if an image is undistorted
# in another way, it is another one, in which the detector finds the boxes again
_fact_option = partial(option, stage="tracks")


class InputOptions(Options):
    """The recording of a run, and how it is read."""

    panel: ClassVar = "Input"
    stage: ClassVar = "detections"

    stereo: Annotated[
        tuple[_SourceName, _SourceName] | None,
        option(
            "Left and right video: files, folders of numbered images, camera numbers (0 1) or "
            "streams (rtsp://...); for recordings in several files, folders of videos, patterns "
            "such as 'DIR/*_L.mp4', or the option repeated for each pair of files. Or one "
            "recording with the images of both cameras, as ZED, OAK and other stereo cameras "
            "record (--stereo-layout).",
            metavar="LEFT RIGHT|BOTH",
            is_repeated=True,
            is_shared=True,
            instead="the recordings are arguments: `track-range fleet run DIR --pattern "
            "'{clip}_left.mp4,{clip}_right.mp4'`",
        ),
    ] = None
    stereo_layout: Annotated[
        LayoutOption | None,
        _clip_option(
            "With one recording of both cameras, where their images are: beside each other with "
            "the left camera's on the left (side-by-side) or right (right-left), below each other "
            "with the left camera's at the top (top-bottom) or bottom (bottom-top), or in two "
            "video tracks of a file (tracks). By default (auto), the layout follows from the file, "
            "its name or the images; images squeezed to half their width or height are recognised "
            "by the size in --rig.",
        ),
    ] = None
    mono: Annotated[
        _SourceName | None,
        option(
            "Video of a single camera: a file, a folder of numbered images, a camera number or a "
            "stream; for a recording in several files, a folder of videos, a pattern such as "
            "'DIR/*_F.mp4', or the option repeated for each file.",
            metavar="VIDEO",
            is_repeated=True,
            is_shared=True,
            instead="the recordings are arguments: `track-range fleet run DIR`",
        ),
    ] = None
    track: Annotated[
        int | None,
        _clip_option(
            "With --mono, video track of a file with several tracks, counted from 0 (default: the "
            "largest track).",
            metavar="N",
            ge=0,
            le=99,
        ),
    ] = None
    topics: Annotated[
        tuple[str, ...],
        _clip_option(
            "Topics of the images in an MCAP file or ROS bag: one for --mono, two for --stereo "
            "BAG, or one with the images of both cameras (--stereo-layout); without --rig, the "
            "calibration is read from the corresponding topics camera_info.",
            metavar="LEFT,RIGHT",
        ),
    ] = ()
    rig: Annotated[
        Path | None,
        _fact_option(
            "Calibration file, recognised by its content: rig.yaml, ZED's SN*.conf, DepthAI's "
            "(OAK) JSON, RealSense's, OpenCV's, MATLAB's, NumPy's, Kalibr's, EuRoC's, ROS's, "
            "KITTI's and others, or a folder of such files (default: NAME.rig.yaml of the left "
            "video, else rig.yaml or calib.txt in its folder; without such a file, distances are uncalibrated).",
            is_per_clip=True,
        ),
    ] = None
    camera: Annotated[
        tuple[str, ...],
        _fact_option(
            "With a calibration file of several cameras, the name of the camera of --mono, or the "
            "names of the left and the right one of --stereo (default: by the size of the images, "
            "or the only pair; rig show FILE lists the names).",
            metavar="NAME|LEFT,RIGHT",
        ),
    ] = ()
    focal_px: Annotated[
        float | None,
        _fact_option(
            "Focal length in pixels of a camera without a calibration file; the principal point is "
            "the image centre.",
            is_per_clip=True,
            metavar="PX",
            gt=0,
        ),
    ] = None
    known_distance: Annotated[
        tuple[str, ...],
        _fact_option(
            "Known distance of an object in the video of a camera without a calibration, which "
            "corrects the estimated focal length: along the camera's axis to its nearest surface, "
            "with its box in pixels T_S seconds after the start: 'T_S,X1,Y1,X2,Y2=12.4', or with a "
            "class, 'T_S,X1,Y1,X2,Y2,van=12.4'. Repeat the option for further objects.",
            metavar="BOX=M",
            is_repeated=True,
            instead="a known distance belongs to one recording; give --rig with the file that "
            "`track-range calibrate drive VIDEO --known-distance ... --out rig.yaml` writes",
        ),
    ] = ()
    fov_deg: Annotated[
        float | None,
        option(
            "Horizontal field of view in degrees to which the images of a wide lens are "
            "undistorted (default: the field of view of the lens, at most 120).",
            metavar="DEG",
            ge=20,
            le=120,
        ),
    ] = None
    yaw_deg: Annotated[
        float,
        option(
            "With --mono, direction in degrees to the right of the camera's axis to which the "
            "images of a wide lens are undistorted, beside the direction of the camera in its "
            "vehicle (--mount, whose yaw is to the left).",
            metavar="DEG",
            ge=-120,
            le=120,
        ),
    ] = 0.0
    start_s: Annotated[
        float,
        _clip_option(
            "Time in the video, in seconds, at which the run starts.",
            flag="--start",
            metavar="S",
            ge=0,
        ),
    ] = 0.0
    duration_s: Annotated[
        float | None,
        _clip_option(
            "Length of the run in seconds (default: to the end of the video).",
            flag="--duration",
            metavar="S",
            gt=0,
        ),
    ] = None
    every: Annotated[
        int,
        option(
            "Only every N-th frame is processed; time steps are those between processed frames.",
            metavar="N",
            ge=1,
            le=1000,
            is_shared=True,
        ),
    ] = 1
    realtime: Annotated[
        bool,
        option(
            "A file is read at the pace of a camera: no frame is read before its time, and "
            "frames are dropped if the machine is too slow.",
            instead="clips of a fleet are recordings, which are processed as fast as possible",
        ),
    ] = False
    fps: Annotated[
        float | None,
        _clip_option(
            "Frame rate of images without times: folders of images, MJPEG and H.264 streams "
            "without a container, and AVI files whose rate is wrong (default: the rate that the "
            "stream states, else 10 for folders and 25 for streams, with a note).",
            metavar="FPS",
            ge=0.01,
            le=1000,
            old_names=("folder_fps",),
        ),
    ] = None
    bayer: Annotated[
        Bayer | None,
        _clip_option(
            "Bayer filter of raw images in a folder (.pgm, .png, .tiff), given by the colours of "
            "the first two pixels in the first two rows: rggb, bggr, gbrg or grbg."
        ),
    ] = None
    start_utc: Annotated[
        str | None,
        _fact_option(
            "Date and time (UTC) of the video's first frame, for the column utc (default: from the "
            "video's header, its name or its timestamps, if they state a date).",
            is_per_clip=True,
            metavar="2026-01-31T14:25:30Z",
            instead="the start of a recording belongs to a clip; give it in the column start_utc "
            "of a manifest",
        ),
    ] = None
    ego_speed: Annotated[
        str,
        _fact_option(
            "Speed of the camera along its axis, with --mount that of the vehicle, for the absolute "
            "speeds of objects: from GPS records in the "
            "video or in a file beside it, else from the images (auto), unknown (off), a constant "
            "in km/h, a file (CSV, GPX, NMEA, SRT, MF4, BLF, ...), or KITTI's oxts folder.",
            is_per_clip=True,
            words=("auto", "off"),
            metavar="KMH|FILE|DIR",
            is_file=True,
        ),
    ] = "auto"

    speed_channel: Annotated[
        str | None,
        _fact_option(
            "With a log of many signals (MF4, BLF, ASC), the name of the speed, perhaps after that of "
            "its group or message: 'ESP.VehicleSpeed', 'VehicleSpeed [km/h]' where the log states no "
            "unit (default: the only signal with a unit of speed).",
            metavar="NAME",
        ),
    ] = None
    dbc: Annotated[
        Path | None,
        _fact_option(
            "Database (DBC) of the messages in a log of a CAN bus (BLF, ASC, MF4); J1939's vehicle "
            "speed needs none.",
            metavar="FILE",
        ),
    ] = None

    @property
    def speed_signal(self) -> SignalChoice:
        """The signal of the speed in a log of many."""
        return SignalChoice(name=self.speed_channel or "", database=self.dbc)

    @field_validator("stereo", mode="before")
    @classmethod
    def _pair_of_names(cls, pair: Any) -> Any:
        """Convert names to paths, several files, or addresses of cameras and streams; a single name
        is for both.
        """
        if isinstance(pair, str | Path):
            pair = (pair,)
        if isinstance(pair, list | tuple) and len(pair) == 1:
            pair = (pair[0], pair[0])
        return (
            tuple(_source_name(name) for name in pair) if isinstance(pair, list | tuple) else pair
        )

    @field_validator("mono", mode="before")
    @classmethod
    def _name(cls, video: Any) -> Any:
        return _source_name(video)

    @field_serializer("stereo", "mono")
    def _named(self, video: VideoName | tuple[VideoName, VideoName] | None) -> Any:
        """Names as text, several files as a list; addresses without passwords."""
        if isinstance(video, tuple):
            return [plain_name(name) for name in video]
        return None if video is None else plain_name(video)

    @field_validator("start_utc", mode="before")
    @classmethod
    def _date_and_time(cls, value: Any) -> Any:
        """Check the date and time; YAML reads an unquoted date as a datetime."""
        if isinstance(value, datetime):
            value = value.isoformat()
        if isinstance(value, str):
            parsed_utc(value)
        return value

    @property
    def has_both_in_one(self) -> bool:
        """Whether one recording has the images of both cameras, if it is not a bag with two
        topics.
        """
        return self.stereo is not None and self.stereo[0] == self.stereo[1] and len(self.topics) < 2

    @property
    def videos(self) -> tuple[VideoName, ...]:
        """The videos, left before right."""
        return self.stereo or (() if self.mono is None else (self.mono,))

    @property
    def left(self) -> VideoName:
        """The left or only video; it gives the output folder its name."""
        if not self.videos:
            raise ConfigError(
                "expected a video, got none: give --stereo LEFT RIGHT or --mono VIDEO."
            )
        return self.videos[0]


def _source_name(value: Any) -> Any:
    """A recording or live source from text or a list of texts; other values are left to the
    validation.
    """
    is_list = isinstance(value, list | tuple) and all(
        isinstance(part, str | Path) for part in value
    )
    return video_name(value) if isinstance(value, str) or is_list else value


def plain_name(video: VideoName, text: Callable[[Path], str] = str) -> str | list[str]:
    """The name of a recording as text, several files as a list; addresses without passwords."""
    source = source_of(video)
    texts = [text(path) for path in source.paths] or [str(source)]
    return texts[0] if len(texts) == 1 else texts
