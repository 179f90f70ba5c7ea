"""Real stereo drives for benchmarks, looped to any length without decoding."""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from pathlib import Path

import av

REAL_DATA = Path(os.environ.get("TRACK_RANGE_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


@dataclass(frozen=True, slots=True)
class LoopedDrive:
    """A stereo drive that is repeated to a given length.

    Attributes:
        left: left video.
        right: right video.
        rig: rig file of the original drive.
        image_hw: (height, width) of the images.
    """

    left: Path
    right: Path
    rig: Path
    image_hw: tuple[int, int]


def add_drive_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the drive and the detector."""
    drive = REAL_DATA / "kitti_stereo" / "0003"
    parser.add_argument("--drive", type=Path, default=drive, help="folder with left.mp4, right.mp4 and calib.txt")
    model = REAL_DATA / "models" / "yolov5n_coco_640.onnx"
    parser.add_argument("--detector", type=Path, default=model, help="a YOLOv5 ONNX file")


def looped(drive: Path, folder: Path, *, n_frames: int) -> LoopedDrive:
    """The drive repeated to at least `n_frames` frames, in `folder`."""
    for name in ("left.mp4", "right.mp4"):
        loop_video(drive / name, folder / name, n_frames=n_frames)
    with av.open(str(drive / "left.mp4")) as reader:
        codec = reader.streams.video[0].codec_context
        image_hw = (codec.height, codec.width)
    return LoopedDrive(folder / "left.mp4", folder / "right.mp4", drive / "calib.txt", image_hw)


def ordinary_video(target: Path, *, n_frames: int) -> Path:
    """A video of 1280x720 px as a dashcam writes it (H.264, crf 23): a real one, played forwards and backwards."""
    with av.open(str(REAL_DATA / "dashcam" / "highway_two_cars.mp4")) as reader:
        frames = [frame.to_ndarray(format="yuv420p") for frame in reader.decode(video=0)]
    period = 2 * len(frames) - 2
    with av.open(str(target), "w") as writer:
        stream = writer.add_stream("libx264", rate=25, options={"crf": "23"})
        stream.height, stream.width = frames[0].shape[0] * 2 // 3, frames[0].shape[1]
        stream.pix_fmt = "yuv420p"
        for number in range(n_frames):
            place = number % period
            image = av.VideoFrame.from_ndarray(frames[min(place, period - place)], format="yuv420p")
            writer.mux(stream.encode(image))
        writer.mux(stream.encode(None))
    return target


def loop_video(source: Path, target: Path, *, n_frames: int) -> None:
    """Write a video with the packets of `source`, repeated to at least `n_frames` frames."""
    with av.open(str(target), "w") as writer:
        stream = None
        n_written, offset = 0, 0
        while n_written < n_frames:
            with av.open(str(source)) as reader:
                video = reader.streams.video[0]
                stream = stream or writer.add_stream_from_template(video)
                for packet in reader.demux(video):
                    if packet.dts is None or packet.pts is None:
                        continue
                    packet.pts, packet.dts = packet.pts + offset, packet.dts + offset
                    packet.stream = stream
                    writer.mux(packet)
                    n_written += 1
                offset += int(video.duration or 0)
