"""One drive in the forms in which people record both cameras: one row per kind, which writes its
files to a folder.

Images are those of a pair, whose times are a tenth of a second apart unless a row states another
rate.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from functools import partial
from io import BytesIO
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import av
import cv2
import numpy as np
import numpy.typing as npt

from tests.support.recordings.live_servers import Camera
from tests.track_range.recording.bag_writers import write_foxglove, write_ros1, write_ros2

Image = npt.NDArray[Any]


class Pair(NamedTuple):
    """The images of both cameras, (H, W, 3) BGR."""

    left: list[Image]
    right: list[Image]


class Written(NamedTuple):
    """Arguments of `open_recording` without the rig."""

    names: tuple[Any, ...]
    options: dict[str, Any]


Write = Callable[[Path, Pair], Written]

PACKED: dict[str, Callable[[Image, Image], Image]] = {
    "side-by-side": lambda left, right: np.hstack((left, right)),
    "right-left": lambda left, right: np.hstack((right, left)),
    "top-bottom": lambda left, right: np.vstack((left, right)),
    "bottom-top": lambda left, right: np.vstack((right, left)),
}


def packed(layout: str, pair: Pair, squeeze: tuple[int, int] = (1, 1)) -> list[Image]:
    """Images of both cameras in one; `squeeze` is the factor by which each is made narrower and
    lower."""
    height, width = pair.left[0].shape[:2]
    size_px = width // squeeze[0], height // squeeze[1]
    both = [
        [cv2.resize(image, size_px, interpolation=cv2.INTER_AREA) for image in images]
        for images in pair
    ]
    return [PACKED[layout](*images) for images in zip(*both, strict=True)]


def write_video(
    path: Path | BytesIO,
    tracks: Sequence[Sequence[Image]],
    *,
    rate: int = 10,
    stereo_mode: str = "",
    options: dict[str, str] | None = None,
    codec: str = "libx264",
    cover: bool = False,
    **container_options: Any,
) -> Any:
    """A video of one or several tracks, without losses; the result is the path."""
    with av.open(
        path if isinstance(path, BytesIO) else str(path), "w", **container_options
    ) as container:
        if cover:
            art: Any = container.add_stream("mjpeg", rate=1)
            art.width, art.height, art.pix_fmt = 640, 480, "yuvj420p"
            art.disposition = av.stream.Disposition.attached_pic
        streams = []
        for images in tracks:
            stream: Any = container.add_stream(
                codec, rate=rate, options={"crf": "0", "preset": "ultrafast", **(options or {})}
            )
            stream.height, stream.width = images[0].shape[:2]
            stream.pix_fmt = "yuvj444p" if codec == "mjpeg" else "yuv444p"
            if stereo_mode:
                stream.metadata["stereo_mode"] = stereo_mode
            streams.append(stream)
        if cover:
            container.mux(art.encode(av.VideoFrame(640, 480, "yuvj420p")))
        for number, images in enumerate(zip_longest(*tracks)):
            for stream, image in zip(streams, images, strict=True):
                if image is not None:
                    frame = av.VideoFrame.from_ndarray(image, format="bgr24")
                    frame.pts, frame.time_base = number, Fraction(1, rate)
                    container.mux(stream.encode(frame))
        for stream in streams:
            container.mux(stream.encode())
    return path


def write_folder(folder: Path, images: Sequence[Image], name: str = "{n:06}.png") -> Path:
    """Images in a folder; `name` has the number n, the names of `stamps`, or both."""
    for number, image in enumerate(images):
        path = folder / name.format(n=number, **stamps(number))
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), image)
    return folder


START = datetime(2026, 1, 31, 14, 25, 30, 900_000, UTC)


def stamps(number: int) -> dict[str, str]:
    """Times of an image as names have them."""
    moment = START + timedelta(seconds=number / 10)
    whole_us = round(moment.timestamp() * 1e6)
    return {
        "ns": f"{1000 * whole_us}",
        "us": f"{whole_us}",
        "sec": f"{whole_us // 10**6}.{whole_us % 10**6:06}",
        "iso": f"{moment:%Y-%m-%dT%H-%M-%S}.{moment.microsecond // 1000:03}",
        "dash": f"{moment:%Y-%m-%d-%H-%M-%S}-{moment.microsecond // 1000:03}",
        "second": f"{moment:%Y-%m-%d %H:%M:%S}.{moment.microsecond:06}000",
    }


def box(kind: bytes, content: bytes) -> bytes:
    """A box of ISO/IEC 14496-12."""
    return struct.pack(">I4s", 8 + len(content), kind) + content


def with_box(path: Path, added: bytes) -> Path:
    """Add a box to the description of the video track of an MP4 file whose index is at its end."""
    content = path.read_bytes()
    moov = content.index(b"moov")
    at = content.index(b"avc1", content.index(b"stsd", moov)) - 4
    end = at + struct.unpack_from(">I", content, at)[0]
    grown = bytearray(content[:end] + added + content[end:])
    for name in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"avc1"):
        size_at = content.index(name, moov) - 4
        struct.pack_into(
            ">I", grown, size_at, struct.unpack_from(">I", grown, size_at)[0] + len(added)
        )
    path.write_bytes(grown)
    return path


# Google's Spherical Video V2: version and flags 0, then 2 = left-right
ST3D = box(b"st3d", bytes([0, 0, 0, 0, 2]))
VEXU = box(
    b"vexu",
    box(b"eyes", box(b"stri", bytes([0, 0, 0, 0, 3])))
    + box(b"pack", box(b"pkin", bytes(4) + b"over")),
)  # Apple's video extended usage: both eyes, over and under


def folders(
    folder: Path, pair: Pair, *, names: tuple[str, str] = ("left/{n:06}.png", "right/{n:06}.png")
) -> Written:
    """A folder of images for each camera; the part of a name before the last slash is the
    folder."""
    for images, name in zip(pair, names, strict=True):
        write_folder(folder, images, name)
    return Written(tuple(folder / name.rpartition("/")[0] for name in names), {})


def timed_folders(
    folder: Path, pair: Pair, *, names: tuple[str, str], times: str, form: str
) -> Written:
    """Folders with a file of times beside the images, whose lines have the form `form`."""
    written = folders(folder, pair, names=names)
    lines = [form.format(n=n, s=n / 10, **stamps(n)) for n in range(len(pair.left))]
    for path in written.names:
        (path.parent / times).write_text("".join(f"{line}\n" for line in lines))
    return written


def one_folder(folder: Path, pair: Pair, *, names: tuple[str, str]) -> Written:
    """Both cameras' images in one folder, or in its folders."""
    folders(folder / "drive", pair, names=names)
    return Written((folder / "drive",), {"stereo_layout": "auto"})


def deep(folder: Path, pair: Pair, *, n_bits: int, suffix: str) -> Written:
    """Images of one channel with more than 8 bits, or 8."""
    grey = [[cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in images] for images in pair]
    stored = [
        [image if n_bits == 8 else image.astype(np.uint16) << (n_bits - 8) for image in side]
        for side in grey
    ]
    return folders(
        folder, Pair(*stored), names=(f"left/{{n:06}}.{suffix}", f"right/{{n:06}}.{suffix}")
    )


def bayer(folder: Path, pair: Pair) -> Written:
    """PNGs behind a Bayer filter, rggb."""

    def filtered(image: Image) -> Image:
        tiled = image[..., 1].copy()
        tiled[::2, ::2], tiled[1::2, 1::2] = image[::2, ::2, 2], image[1::2, 1::2, 0]
        return tiled

    written = folders(folder, Pair(*([filtered(image) for image in images] for images in pair)))
    return written._replace(options={"bayer": "rggb"})


def videos(
    folder: Path,
    pair: Pair,
    *,
    suffix: str = "mp4",
    names: tuple[str, str] = ("left", "right"),
    **options: Any,
) -> Written:
    """Two videos."""
    both = zip(names, pair, strict=True)
    return Written(
        tuple(write_video(folder / f"{name}.{suffix}", [side], **options) for name, side in both),
        {},
    )


def one_file(
    folder: Path,
    pair: Pair,
    *,
    layout: str = "side-by-side",
    option: str = "",
    name: str = "both.mp4",
    squeeze: tuple[int, int] = (1, 1),
    added: bytes = b"",
    **options: Any,
) -> Written:
    """Both cameras in the images of one video; `option` is the given layout, "" = the true one."""
    path = write_video(folder / name, [packed(layout, pair, squeeze)], **options)
    if added:
        with_box(path, added)
    return Written((path,), {"stereo_layout": option or layout})


def tracks(
    folder: Path, pair: Pair, *, suffix: str = "mkv", option: str = "auto", preview: bool = False
) -> Written:
    """Both cameras in the tracks of one video, with a small preview first."""
    small = [[cv2.resize(image, (160, 48)) for image in pair.left]] if preview else []
    return Written(
        (write_video(folder / f"both.{suffix}", [*small, *pair]),), {"stereo_layout": option}
    )


def previews(folder: Path, pair: Pair) -> Written:
    """Two videos with a small preview as their first track."""
    paths = [
        write_video(
            folder / f"{side}.mp4", [[cv2.resize(image, (160, 48)) for image in images], images]
        )
        for side, images in zip(("left", "right"), pair, strict=True)
    ]
    return Written(tuple(paths), {})


def chosen_track(folder: Path, pair: Pair) -> Written:
    """Both cameras in the images of the second track, which `track` names."""
    path = write_video(
        folder / "both.mp4", [packed("top-bottom", pair), packed("side-by-side", pair)]
    )
    return Written((path,), {"stereo_layout": "side-by-side", "track": 1})


def joined(folder: Path, pair: Pair) -> Written:
    """Two videos, each of two transport streams that are joined as bytes; the clock of the second
    is set back."""
    n, paths = len(pair.left) // 2, []
    for side, images in zip(("left", "right"), pair, strict=True):
        parts = [
            write_video(folder / f"part{k}.ts", [part], rate=4).read_bytes()
            for k, part in enumerate((images[:n], images[n:]))
        ]
        paths.append(folder / f"{side}.ts")
        paths[-1].write_bytes(b"".join(parts))
    return Written(tuple(paths), {})


DATED = ("20260131_142530.mp4", "20260131_142531.mp4")


def segments(folder: Path, pair: Pair, *, form: str = "folder") -> Written:
    """Files of equal length, in folders, as lists, or with both cameras in each; the first one has
    a second."""
    if form == "packed":
        both = packed("side-by-side", pair)
        paths = [
            write_video(folder / name, [both[part]])
            for name, part in zip(DATED, PARTS, strict=True)
        ]
        return Written((paths,), {"stereo_layout": "side-by-side"})
    names = []
    for side, images in zip(("left", "right"), pair, strict=True):
        (folder / side).mkdir()
        paths = [
            write_video(folder / side / name, [images[part]])
            for name, part in zip(DATED, PARTS, strict=True)
        ]
        names.append(paths if form == "lists" else folder / side)
    return Written(tuple(names), {})


PARTS = slice(0, 10), slice(10, None)


def bag(folder: Path, pair: Pair, *, form: str) -> Written:
    """ROS bags and MCAP files, with topics of two cameras or of one with the images of both."""
    sides = list(zip(*pair, strict=True))
    if form == "mcap side by side":
        return Written(
            (write_foxglove(folder / "drive.mcap", ["/both"], packed("side-by-side", pair)),), ONE
        )
    if form == "ros2 side by side":
        path = write_ros2(
            folder / "bag",
            ["/zed"],
            packed("side-by-side", pair),
            storage="sqlite3",
            topic="image_raw/compressed",
        )
        return Written((path,), ONE)
    if form == "mcap":
        names, topic = ["/left", "/right"], "image"
        path = write_foxglove(folder / "drive.mcap", names, sides)
    elif form == "ros1":
        names, topic = ["/stereo/left", "/stereo/right"], "image_raw/compressed"
        path = write_ros1(folder / "drive.bag", names, sides, topic=topic)
    else:
        names, topic = ["/camera/infra1", "/camera/infra2"], "image_raw"
        path = write_ros2(
            folder / "bag", names, sides, storage="mcap", topic=topic, encoding="bgr8"
        )
    return Written((path, path), {"topics": [f"{name}/{topic}" for name in names]})


ONE = {"stereo_layout": "side-by-side"}


def live(_: Path, pair: Pair, *, servers: ExitStack, layout: str = "side-by-side") -> Written:
    """A stream of a camera with both images in one, again and again, two a second."""
    camera = Camera(images=packed(layout, pair), rate_hz=2)
    servers.callback(camera.close)
    return Written((camera.url,), {"stereo_layout": layout})


class Recording(NamedTuple):
    """A kind of recording, and what writes it."""

    kind: str
    write: Write
    rate_hz: float = 10.0  # 0 = live
    n_lost: int = 0  # largest number of frames that the form itself loses


RECORDINGS = (
    Recording("two folders of PNG", folders),
    Recording("two MP4", videos),
    Recording("two MP4 with cover art", partial(videos, cover=True)),
    Recording("two MP4 with preview stream", previews),
    Recording("two MKV at 30 frames/s (times of 1 ms)", partial(videos, suffix="mkv", rate=30), 30.0),
    Recording("two AVI of JPEG", partial(videos, suffix="avi", codec="mjpeg", options={"qmin": "1", "qmax": "1"})),
    Recording("two MOV", partial(videos, suffix="mov")),
    Recording("two transport streams", partial(videos, suffix="ts")),
    Recording("two raw H.264 streams", partial(videos, suffix="h264")),
    Recording("two videos of 3 frames", lambda folder, pair: videos(folder, Pair(pair.left[:3], pair.right[:3]))),
    Recording("joined TS, clock set back", joined, 4.0, n_lost=2),
    Recording("segments, dated names", segments),
    Recording("segments, lists of files", partial(segments, form="lists")),
    *(Recording(layout, partial(one_file, layout=layout)) for layout in PACKED),
    Recording("half side by side", partial(one_file, squeeze=(2, 1))),
    Recording("half top-bottom", partial(one_file, layout="top-bottom", squeeze=(1, 2))),
    Recording("side by side, auto by matching", partial(one_file, option="auto")),
    Recording("right-left, auto by matching", partial(one_file, layout="right-left", option="auto")),
    Recording("top-bottom, auto by matching", partial(one_file, layout="top-bottom", option="auto")),
    Recording("name _SBS", partial(one_file, option="auto", name="drive_SBS.mp4")),
    Recording("name .OU", partial(one_file, layout="top-bottom", option="auto", name="drive.OU.mp4")),
    Recording("H.264 frame packing 3", partial(one_file, option="auto", options={"x264-params": "frame-packing=3"})),
    Recording(
        "H.264 frame packing 4",
        partial(one_file, layout="top-bottom", option="auto", options={"x264-params": "frame-packing=4"}),
    ),
    Recording(
        "MKV StereoMode right_left",
        partial(one_file, layout="right-left", option="auto", name="both.mkv", stereo_mode="right_left"),
    ),
    Recording("MP4 box st3d", partial(one_file, option="auto", added=ST3D)),
    Recording("MP4 box vexu", partial(one_file, layout="top-bottom", option="auto", added=VEXU)),
    Recording("side by side in segments", partial(segments, form="packed")),
    Recording(
        "side by side, folder of PNG",
        lambda folder, pair: Written((write_folder(folder / "both", packed("side-by-side", pair)),), ONE),
    ),
    Recording("two tracks of MKV", tracks),
    Recording("two tracks of MP4", partial(tracks, suffix="mp4", option="tracks")),
    Recording("two tracks of MP4 after a preview", partial(tracks, suffix="mp4", preview=True)),
    Recording("side by side in a chosen track", chosen_track),
    Recording("KITTI raw", partial(timed_folders, names=("image_02/data/{n:010}.png", "image_03/data/{n:010}.png"),
                                   times="timestamps.txt", form="{second}")),
    Recording("KITTI odometry with times.txt", partial(
        timed_folders, names=("image_2/{n:06}.png", "image_3/{n:06}.png"), times="times.txt", form="{s:e}")),
    Recording("KITTI 2015", partial(folders, names=("image_2/{n:06}_10.png", "image_3/{n:06}_10.png"))),
    Recording("EuRoC (ns) with data.csv", partial(
        timed_folders, names=("cam0/data/{ns}.png", "cam1/data/{ns}.png"), times="data.csv", form="{ns},{ns}.png")),
    Recording("EuRoC (ns)", partial(folders, names=("cam0/{ns}.png", "cam1/{ns}.png"))),
    Recording("TUM (seconds)", partial(folders, names=("rgb/{sec}.png", "rgb2/{sec}.png"))),
    Recording("nuScenes (us)", partial(folders, names=(
        "L/n015-2018-07-24-11-22-45+0800__CAM_FRONT__{us}.png",
        "R/n015-2018-07-24-11-22-45+0800__CAM_FRONT__{us}.png"))),
    Recording("ISO dates", partial(folders, names=("left/{iso}.png", "right/{iso}.png"))),
    Recording("DrivingStereo", partial(folders, names=(
        "left/2018-07-11-14-48-52_{dash}.png", "right/2018-07-11-14-48-52_{dash}.png"))),
    Recording("Cityscapes", partial(folders, names=(
        "leftImg8bit/aachen_{n:06}_000019_leftImg8bit.png", "rightImg8bit/aachen_{n:06}_000019_rightImg8bit.png"))),
    Recording("numbers without zeros", partial(folders, names=("left/frame{n}.png", "right/frame{n}.png"))),
    *(
        Recording(f"one folder, {names[0]}", partial(one_folder, names=names))
        for names in (
            ("left_{n:04d}.png", "right_{n:04d}.png"), ("{n:04d}_L.png", "{n:04d}_R.png"),
            ("cam0_{n:04d}.png", "cam1_{n:04d}.png"), ("{n:04d}_image_2.png", "{n:04d}_image_3.png"),
            ("left/{n:04d}.png", "right/{n:04d}.png"), ("cam0/data/{n:04d}.png", "cam1/data/{n:04d}.png"),
        )
    ),
    *(
        Recording(f"{n_bits} bits per pixel, .{suffix}", partial(deep, n_bits=n_bits, suffix=suffix))
        for n_bits, suffix in ((8, "pgm"), (10, "png"), (12, "tiff"), (12, "png"), (14, "pgm"), (16, "png"))
    ),
    Recording("Bayer PNG", bayer),
    Recording("MCAP, two topics", partial(bag, form="mcap")),
    Recording("MCAP, one topic side by side", partial(bag, form="mcap side by side")),
    Recording("ROS 1 bag, two topics", partial(bag, form="ros1")),
    Recording("ROS 2 bag, raw images of two infrared cameras", partial(bag, form="ros2")),
    Recording("ROS 2 bag, one topic side by side", partial(bag, form="ros2 side by side")),
)  # fmt: skip
