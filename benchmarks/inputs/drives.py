"""Drives for benchmarks: real ones looped to any length, simulated ones in memory, and rendered
ones in a cache.

An edge of the lane of a simulated drive consists of points (x(z) + offset, y(z), z) at a constant
lateral offset from the middle of the road, which are projected into the image; columns between two
points are interpolated, up to the first crest of the road, behind which the road is hidden.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import av
import numpy as np

from benchmarks.harness import option
from track_range.detection.catalogue.lookup import DEFAULT_MODEL, find_model
from track_range.detection.detections import Detections
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.camera.fault_options import NO_FAULTS, Faults
from track_range.simulation.drive import Drive, write_drive
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.surroundings import SURROUNDINGS
from track_range.stereo.geometry.frames import Frame

REAL_DATA = Path(
    os.environ.get("TRACK_RANGE_DATA", Path(__file__).resolve().parents[3] / "shared" / "data")
)

DRIVE_OPTIONS = (
    option(
        "--drive",
        default=REAL_DATA / "kitti_stereo/0003",
        help="folder with left.mp4, right.mp4 and calib.txt",
    ),
    option(
        "--detector",
        default=REAL_DATA / "models" / "yolov5n_coco_640.onnx",
        type=Path,
        help="a YOLOv5 ONNX file",
    ),
)

FPS = 10.0

NEAREST_M, FARTHEST_M, N_POINTS = 2.0, 90.0, 300
"""Range of depths ahead of the camera and number of the points of a lane edge."""

COLLISIONS = (
    "rear-stationary",
    "rear-slower",
    "rear-braking",
    "crossing-adult",
    "crossing-child",
    "crossing-car",
    "cut-in",
)
"""Scenarios with a contact."""

# scenarios without a contact
HARMLESS = ("curve-parked", "oncoming", "overhead-sign", "following", "queue")
CONFLICT_S = 8.0  # length of a rendered drive in s, after all contacts

WIDTH_PX, HEIGHT_FRACTION = 1240, 376 / 1240
"""Default width of the images of rendered drives, and their height relative to it: KITTI's."""


@dataclass(frozen=True, slots=True)
class LoopedDrive:
    """A stereo drive that is repeated to a given length: videos, rig file, and (height, width) of
    the images.
    """

    left: Path
    right: Path
    rig: Path
    image_hw: tuple[int, int]


def looped(drive: Path, folder: Path, *, n_frames: int) -> LoopedDrive:
    """The drive repeated to at least `n_frames` frames, in `folder`, without decoding."""
    for name in ("left.mp4", "right.mp4"):
        with av.open(str(folder / name), "w") as writer:
            stream = None
            n_written, offset = 0, 0
            while n_written < n_frames:
                with av.open(str(drive / name)) as reader:
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
                    image_hw = (video.codec_context.height, video.codec_context.width)
    return LoopedDrive(folder / "left.mp4", folder / "right.mp4", drive / "calib.txt", image_hw)


def ordinary_video(target: Path, *, n_frames: int, fps: int = 25) -> Path:
    """A video of 1280x720 px as a dashcam writes it (H.264, crf 23): a real one, played forwards
    and backwards.
    """
    with av.open(str(REAL_DATA / "dashcam" / "highway_two_cars.mp4")) as reader:
        frames = [frame.to_ndarray(format="yuv420p") for frame in reader.decode(video=0)]
    period = 2 * len(frames) - 2
    with av.open(str(target), "w") as writer:
        stream = writer.add_stream("libx264", rate=fps, options={"crf": "23"})
        stream.height, stream.width = frames[0].shape[0] * 2 // 3, frames[0].shape[1]
        stream.pix_fmt = "yuv420p"
        for number in range(n_frames):
            place = number % period
            image = av.VideoFrame.from_ndarray(frames[min(place, period - place)], format="yuv420p")
            writer.mux(stream.encode(image))
        writer.mux(stream.encode(None))
    return target


def decoded(video: Path, n_frames: int | None = None) -> list[Image]:
    """(H, W, 3) BGR images of a video; None = all."""
    with av.open(str(video)) as reader:
        images = []
        for number, frame in enumerate(reader.decode(video=0)):
            if number == n_frames:
                break
            images.append(np.asarray(frame.to_ndarray(format="bgr24"), np.uint8))
        return images


@dataclass(frozen=True, slots=True)
class SimulatedDrive:
    """A simulated drive at `FPS` with KITTI's field of view, rendered on demand; `times_s` (F,)
    start at 0.
    """

    renderer: Renderer
    times_s: FloatArray

    @classmethod
    def of(
        cls, scenario: str, *, seed: int, seconds: float, faults: Faults = NO_FAULTS
    ) -> SimulatedDrive:
        scene = make_scenario(scenario, seed=seed, seconds=seconds)
        renderer = Renderer(scene, kitti_like_rig(), faults=faults)
        return cls(renderer, np.arange(round(seconds * FPS)) / FPS)

    def left_images(self) -> list[Image]:
        """All left images, (H, W, 3) BGR."""
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            return list(threads.map(self.renderer.render, self.times_s.tolist()))

    def frames(self) -> list[Frame]:
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            return list(threads.map(self._frame, range(len(self.times_s))))

    def iter_frames(self) -> Iterator[Frame]:
        """All frames, rendered one after the other."""
        return map(self._frame, range(len(self.times_s)))

    def _frame(self, index: int) -> Frame:
        time_s = float(self.times_s[index])
        left, right = (self.renderer.render(time_s, side=side) for side in ("left", "right"))
        return Frame(index, time_s, left, right)

    def lane_px(self, y_px: FloatArray) -> FloatArray:
        """(F, 2, K) columns of the left and right edge of the ego lane in rows (K,), by frame; NaN
        = not visible.
        """
        return np.array([list(self._edges_px(time_s, y_px)) for time_s in self.times_s.tolist()])

    def _edges_px(self, time_s: float, y_px: FloatArray) -> Iterator[FloatArray]:
        """(K,) columns of the left, then of the right edge."""
        scene = self.renderer.scene
        lanes = SURROUNDINGS[scene.surroundings].lanes
        pose = scene.pose(time_s)
        z = scene.ego_z_m(time_s) + 1 / np.linspace(1 / NEAREST_M, 1 / FARTHEST_M, N_POINTS)
        for offset_m in next(edges for number, *edges in lanes if number == 0):
            world = np.stack([scene.road.x_m(z, offset_m), scene.road.y_m(z), z], axis=1)
            points = (world - pose.position_m) @ pose.camera_from_world.T
            x, y = self.renderer.rig.left.project(points[points[:, 2] > 1.0]).T
            crest = 1 + int(np.argmax(np.diff(y, append=np.inf) >= 0))
            yield np.interp(y_px, y[:crest][::-1], x[:crest][::-1], left=np.nan, right=np.nan)


class StoredDetector:
    """Returns stored boxes, one frame after another, whatever the image."""

    def __init__(self, frames: Sequence[Detections]) -> None:
        self._frames = iter(frames)

    def detect(self, image: Image) -> Detections:
        return next(self._frames)


@dataclass(frozen=True, slots=True)
class ConflictDrive:
    """A rendered drive with a contact, or a harmless one: its files, and the packaged detector's
    boxes by frame.
    """

    scenario: str
    seed: int
    files: Drive
    boxes: list[Detections]

    @property
    def seconds(self) -> float:
        return len(self.boxes) / FPS


def conflict_drive(
    cache_folder: Path, scenario: str, seed: int, *, width_px: int = WIDTH_PX
) -> ConflictDrive:
    """The drive of a scenario and seed from the cache folder; if it is not there, rendered and
    detected first.
    """
    folder = cache_folder / f"{scenario}_{seed}_{width_px}"
    path = folder / "boxes.npz"
    files = Drive.in_folder(folder)
    if not path.exists():
        rig = kitti_like_rig(width_px=width_px, height_px=2 * round(width_px * HEIGHT_FRACTION / 2))
        write_drive(folder, scenario=scenario, seed=seed, seconds=CONFLICT_S, fps=FPS, rig=rig)
        frames = [_detector().detect(image) for image in decoded(files.left)]
        partial = path.with_name("partial.npz")
        np.savez_compressed(
            partial,
            frame=np.repeat(np.arange(len(frames)), [len(boxes) for boxes in frames]),
            xyxy_px=np.concatenate([boxes.xyxy_px for boxes in frames]),
            score=np.concatenate([boxes.score for boxes in frames]),
            class_id=np.concatenate([boxes.class_id for boxes in frames]),
            n_frames=np.array(len(frames)),
        )
        os.replace(partial, path)
    with np.load(path) as stored:
        frame, n_frames = stored["frame"], int(stored["n_frames"])
        xyxy_px, score, class_id = (stored[name] for name in ("xyxy_px", "score", "class_id"))
    rows = [np.flatnonzero(frame == number) for number in range(n_frames)]
    return ConflictDrive(
        scenario,
        seed,
        files,
        [Detections.of(xyxy_px[row], score[row], class_id[row]) for row in rows],
    )


@cache
def _detector() -> YoloDetector:
    return YoloDetector(
        find_model(DEFAULT_MODEL).path, YoloSettings(), runtime=Runtime(n_threads=1)
    )


CACHE = Path(tempfile.gettempdir()) / "track-range-drives"
CACHE_OPTION = option("--cache", default=CACHE, metavar="DIR", help="folder of rendered drives")
