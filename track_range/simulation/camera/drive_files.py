"""Writing of a drive's images, as a video or lossless PNGs, and maps of true disparities, objects,
heads and plates.
"""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.files.output_files import make_folder, write_bytes
from track_range.recording.video.layouts import REVERSED, STACKED, PackedLayout
from track_range.simulation.world.scene import Scene
from track_range.simulation.world.truth import VisibleObjects
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.views.videos.video_writer import VideoWriter

# x264's constant rate factor; compression then shifts textures by far less than 0.1 px
NEAR_LOSSLESS_CRF = 10
# of 0 to 9; files are a third larger than at level 9, but written five times as fast
PNG_COMPRESSION = 1
# largest range of disparities in a pixel; above it shows two objects and gets no disparity
EDGE_PX = 1.0
# tolerance outside an object's 3-D box, and smallest height of its points above the road
SURFACE_MARGIN_M = 0.04
MIN_SAMPLES = 2  # minimum number of a pixel's four samples that show a head or plate


class PngFolder:
    """Writes images as 000000.png, 000001.png, ... by frame number, with gaps for dropped
    frames.
    """

    def __init__(self, folder: Path, *, fps: float) -> None:
        make_png_folder(folder)
        self._folder, self._fps = folder, fps

    def write(self, image: Image, time_s: float) -> None:
        """Write an image; its number is `time_s` in frames."""
        write_png(self._folder / f"{round(time_s * self._fps):06}.png", image)

    def close(self) -> None:
        """Do nothing."""


def make_png_folder(folder: Path) -> None:
    """Create a folder for PNG images; images of an earlier drive are removed."""
    make_folder(folder)
    for old in folder.glob("*.png"):
        with suppress(OSError):
            old.unlink()


def image_writer(path: Path, camera: PinholeCamera, fps: float) -> VideoWriter | PngFolder:
    """A writer of a video if `path` ends in .mp4, else of a folder of PNGs."""
    if path.suffix == ".mp4":
        return VideoWriter(
            path,
            width_px=camera.width_px,
            height_px=camera.height_px,
            fps=fps,
            crf=NEAR_LOSSLESS_CRF,
        )
    return PngFolder(path, fps=fps)


class PackedWriter:
    """Writes the left and right images of equal times, passed in this order, as one image each."""

    def __init__(self, path: Path, camera: PinholeCamera, fps: float, layout: PackedLayout) -> None:
        self._axis, self._order = int(layout not in STACKED), -1 if layout in REVERSED else 1
        n_rows, n_columns = (2, 1) if layout in STACKED else (1, 2)
        both = replace(
            camera, width_px=n_columns * camera.width_px, height_px=n_rows * camera.height_px
        )
        self._writer = image_writer(path, both, fps)
        # the last image that was passed, and its time
        self._last: tuple[Image, float] | None = None

    def write(self, image: Image, time_s: float) -> None:
        """Write an image together with the previous image, if both have the same time."""
        before, self._last = self._last, (image, time_s)
        if before is not None and before[1] == time_s:
            self._writer.write(
                np.concatenate((before[0], image)[:: self._order], self._axis), time_s
            )

    def close(self) -> None:
        """Finish the file; a second call does nothing."""
        self._writer.close()


FrameWriter = VideoWriter | PngFolder | PackedWriter  # writes the images of a camera


def write_png(path: Path, image: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> None:
    """Write one image atomically; `OutputError` if it cannot be written."""
    _, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, PNG_COMPRESSION])
    write_bytes(path, encoded.tobytes())


def disparity_map(inverse_depth: FloatArray, rig: StereoRig) -> npt.NDArray[np.uint16]:
    """(H, W) KITTI's disparities: 256 d, 0 for sky, edges and d >= 256 px; `inverse_depth` (2 * H,
    2 * W) in 1/m.
    """
    height, width = inverse_depth.shape
    samples = inverse_depth.reshape(height // 2, 2, width // 2, 2) * (
        rig.left.fx_px * rig.baseline_m
    )
    is_smooth = samples.max(axis=(1, 3)) - samples.min(axis=(1, 3)) <= EDGE_PX
    mean = samples.mean(axis=(1, 3))
    is_known = is_smooth & (samples.min(axis=(1, 3)) > 0) & (mean < 256 - 1 / 256)
    return np.where(is_known, np.rint(mean * 256), 0).astype(np.uint16)


def object_map(
    inverse_depth: FloatArray, rig: StereoRig, visible: VisibleObjects, rotations: FloatArray
) -> npt.NDArray[np.uint8]:
    """(H, W) number of the object that each pixel shows: n + 1 for row n of the labels, 0 = none or
    beyond the 254th.

    A pixel shows an object if the point drawn there is within its 3-D box and above the road.
    `inverse_depth` is (2 * H, 2 * W), for the samples in 1/m; `rotations` are (M, 3, 3), of all
    road users, from the object's frame to the left camera's frame.
    """
    camera, labels = rig.left, visible.labels
    pixels = inverse_depth[::2, ::2]
    numbers = np.zeros(pixels.shape, np.uint8)
    for number in np.flatnonzero(labels.track_id >= 0)[:254].tolist():
        x1, y1, x2, y2 = (int(edge) for edge in labels.xyxy_px[number])
        column, row = np.meshgrid(np.arange(x1, x2 + 1), np.arange(y1, y2 + 1))
        box_inverse_depth = np.maximum(pixels[row, column], 1e-6)[:, :, None]
        rays = camera.rays(
            np.stack([column.ravel(), row.ravel()], axis=1).astype(np.float64) - 0.25
        )
        points = rays.reshape(*row.shape, 3) / box_inverse_depth - labels.location_m[number]
        height, width, length = labels.size_hwl_m[number]
        x, y, z = np.moveaxis(points @ rotations[visible.row[number]], 2, 0)
        inside = (np.abs(x) < length / 2 + SURFACE_MARGIN_M) & (
            np.abs(z) < width / 2 + SURFACE_MARGIN_M
        )
        inside &= (y > -height - SURFACE_MARGIN_M) & (y < -SURFACE_MARGIN_M)
        part = numbers[y1 : y2 + 1, x1 : x2 + 1]
        part[inside & (part == 0)] = number + 1
    return numbers


def write_masks(folder: Path, number: int, labels: npt.NDArray[np.uint16], scene: Scene) -> None:
    """Write the visible heads and plates of a left image, from `Renderer.render_with_labels`,
    without blur and noise.

    masks/000000.png is 0 = neither, 1 = head, 2 = number plate (`faces.IdentifyingPart`);
    mask_ids/000000.png is 1 + the track id of the road user (of truth.txt), 0 = neither. `number`
    is the frame's number in the left video, which has no gaps for dropped frames. The first one
    removes the masks of an earlier drive.
    """
    part, row = masks_of(labels)
    track_id = np.array([user.track_id for user in scene.road_users], np.int64)
    ids = np.where(part > 0, track_id[row] + 1, 0) if len(track_id) else row
    for name, image in (("masks", part), ("mask_ids", ids.astype(np.uint16))):
        if number == 0:
            make_png_folder(folder / name)
        write_png(folder / name / f"{number:06}.png", image)


def masks_of(labels: npt.NDArray[np.uint16]) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
    """(H, W) part of each pixel, 0 to 2, and (H, W) row of its road user in the scene, from samples
    (2 * H, 2 * W).
    """
    height, width = labels.shape
    samples = (
        labels.reshape(height // 2, 2, width // 2, 2)
        .transpose(0, 2, 1, 3)
        .reshape(height // 2, width // 2, 4)
    )
    label = np.sort(samples, axis=2)[:, :, 4 - MIN_SAMPLES].astype(np.int64)
    is_part = label > 0
    return np.where(is_part, (label - 1) % 2 + 1, 0).astype(np.uint8), np.where(
        is_part, (label - 1) // 2, 0
    )


def with_even_size(rig: StereoRig) -> StereoRig:
    """The rig with images of even width and height, as H.264 needs them: odd sizes grow by one."""
    camera = rig.left
    wide, high = camera.width_px + camera.width_px % 2, camera.height_px + camera.height_px % 2
    return StereoRig.rectified(replace(camera, width_px=wide, height_px=high), rig.baseline_m)
