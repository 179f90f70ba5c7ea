"""The drives that benchmarks run on: a short real stereo drive, looped to any length without decoding it."""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from pathlib import Path

import av

REAL_DATA = Path(os.environ.get("TRACK_RANGE_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


@dataclass(frozen=True, slots=True)
class LoopedDrive:
    """A stereo drive repeated until it is long enough; `rig` is the original's, image_hw (height, width)."""

    left: Path
    right: Path
    rig: Path
    image_hw: tuple[int, int]


def add_drive_options(parser: argparse.ArgumentParser) -> None:
    """Options that say which drive and which detector."""
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


def loop_video(source: Path, target: Path, *, n_frames: int) -> None:
    """Copy the packets again and again, each round later by the video's length."""
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
