"""Adaptation of a calibrated camera to the size of its images, and evidence for another size.

A matrix K is of use only with the size of the images that it was measured in. Where a file lacks
this size, or its size does not belong to K, the principal point shows the size: centred in images
of W px, it lies off centre in images of w.

    resized:  f' = f w / W        cropped:  f' = f
"""

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from track_range.stereo.geometry.camera import PinholeCamera

_CROPPED_PX = 2  # largest number of rows or columns that video codecs crop
# largest relative difference of aspect ratios at which a calibration is scaled
_ASPECT_TOLERANCE = 0.01
# Largest distance of the principal point from the middle / image width: up to 0.036 in the cameras
# of KITTI, KITTI-360, EuRoC, Cityscapes, nuScenes, TuSimple, OAK-D and others, 0.047 in one; 0.10
# in Middlebury's crops. Above 0.07: doubt.
CENTRED, _OFF_CENTRE = 0.05, 0.07
_COMMON_SIZES = (  # of images of cameras and data sets for driving, (width, height) in pixels
    (640, 360), (848, 480), (960, 540), (1280, 720), (1600, 900), (1920, 1080), (2304, 1296),
    (2560, 1440), (2704, 1520), (3840, 2160), (640, 480), (800, 600), (1024, 768), (1280, 960),
    (1440, 1080), (1600, 1200), (2592, 1944), (1280, 800), (1920, 1200), (1928, 1208), (752, 480),
    (672, 376), (2208, 1242), (1164, 874), (1242, 375), (1408, 376), (1392, 512), (2048, 1024),
    (1762, 800),
)  # fmt: skip

# widths and heights of digitised analogue video
_ANALOGUE_PX = (352, 704, 720, 960), (240, 288, 480, 576)

SizeReading = Literal["stated", "scaled", "other aspect", "assumed", "off centre"]
"""How images belong to a camera: they have its size, perhaps cropped by a codec; its aspect ratio;
another one. Where the file states no size, they are taken to have been calibrated; or the principal
point is too far from their middle."""


class FocalAlternative(NamedTuple):
    """Another possible meaning of a calibration or focal length."""

    factor: float  # by which the distances are too long if it holds
    cause: str  # what would have happened, for messages


@dataclass(frozen=True, slots=True)
class SizeFit:
    """A camera, as stated in its file, adapted to images of a size."""

    stated: PinholeCamera
    size_px: tuple[int, int]  # (width, height) of the images
    calibrated_px: tuple[int, int]  # (width, height) that the file states, else that of the images
    reading: SizeReading  # how the images belong to the camera
    # the camera of the images; without a meaning if these have another aspect, or are off centre
    camera: PinholeCamera
    centred_sizes: tuple[
        tuple[int, int], ...
    ]  # usual sizes in which the principal point is central
    # readings that a principal point off the centre supports, the likeliest first
    alternatives: tuple[FocalAlternative, ...]


def fit_to_size(camera: PinholeCamera, size_px: tuple[int, int]) -> SizeFit:
    """A camera, as stated in its file, adapted to images of `size_px` = (width, height).

    The calibrated size may differ by a few rows or columns cropped by a codec; otherwise the camera
    is scaled if the aspect ratio agrees. Without a calibrated size, the principal point must lie in
    the middle third of the image.
    """
    reading = _reading_of(camera, size_px)
    fitted = replace(camera, width_px=size_px[0], height_px=size_px[1])
    if reading == "scaled":
        fitted = camera.resized(size_px)
    calibrated_px = camera.size_px if camera.width_px else size_px
    sizes = _centred_sizes(camera, calibrated_px)
    width, _ = calibrated_px
    is_off_centre = abs(camera.cx_px - (width - 1) / 2) > _OFF_CENTRE * width
    alternatives = tuple(
        FocalAlternative(w / width, f"K belongs to images of {w}x{h} px that were resized")
        for w, h in sizes
        if is_off_centre
    )
    return SizeFit(camera, size_px, calibrated_px, reading, fitted, sizes, alternatives)


def _reading_of(camera: PinholeCamera, size_px: tuple[int, int]) -> SizeReading:
    if camera.width_px:
        if is_size_of(camera, size_px):
            return "stated"
        return "scaled" if has_aspect_of(camera, size_px) else "other aspect"
    is_central = all(
        side / 3 <= centre <= side * 2 / 3
        for side, centre in zip(size_px, (camera.cx_px, camera.cy_px), strict=True)
    )
    return "assumed" if is_central else "off centre"


def _centred_sizes(camera: PinholeCamera, size_px: tuple[int, int]) -> tuple[tuple[int, int], ...]:
    """Up to two usual sizes in which the principal point is central, sizes with the aspect of
    `size_px` first.
    """
    sizes = [
        (w, h)
        for w, h in _COMMON_SIZES
        if max(abs(camera.cx_px - (w - 1) / 2), abs(camera.cy_px - (h - 1) / 2)) <= CENTRED * w
    ]
    sizes.sort(key=lambda wh: abs(math.log(wh[0] / wh[1] * size_px[1] / size_px[0])))
    return tuple(sizes[:2]) or ((round(2 * camera.cx_px + 1), round(2 * camera.cy_px + 1)),)


def analogue_alternatives(size_px: tuple[int, int]) -> tuple[FocalAlternative, ...]:
    """Pixel aspects of analogue video whose file states no aspect; its pixels are taken as square.

    Distances by width are then too long by the pixel aspect, and distances by height are right: the
    factor is in between.
    """
    if size_px[0] not in _ANALOGUE_PX[0] or size_px[1] not in _ANALOGUE_PX[1]:
        return ()
    alternatives = []
    for width, height in ((4, 3), (16, 9)):
        aspect = width * size_px[1] / (height * size_px[0])
        cause = f"shown as {width}:{height}, pixels are {aspect:.2f} times as wide as high"
        alternatives.append(FocalAlternative(math.sqrt(aspect), cause))
    return tuple(alternatives)


def is_size_of(camera: PinholeCamera, size_px: tuple[int, int]) -> bool:
    """Whether images of this size come from the camera, perhaps cropped by a codec."""
    return all(
        0 <= own - side <= _CROPPED_PX for own, side in zip(camera.size_px, size_px, strict=True)
    )


def has_aspect_of(camera: PinholeCamera, size_px: tuple[int, int]) -> bool:
    """Whether images of this size have the aspect ratio of the images of the camera."""
    scale_x, scale_y = size_px[0] / camera.width_px, size_px[1] / camera.height_px
    return abs(scale_x / scale_y - 1) <= _ASPECT_TOLERANCE
