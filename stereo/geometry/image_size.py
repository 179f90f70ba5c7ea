"""Adaptation of a calibrated camera to the size of its images, and evidence for another size.

A matrix K is of use only with the size of the images that it was measured in. Where a file lacks
this size, or its size does not belong to K, the principal point shows the size: centred in images
of W px, it lies off centre in images of w.

    resized:  f' = f w / W        cropped:  f' = f
"""

import math
from dataclasses import replace
from typing import NamedTuple

from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, StereoRig

_CROPPED_PX = 2  # largest number of rows or columns that video codecs crop
# largest relative difference of aspect ratios at which a calibration is scaled
_ASPECT_TOLERANCE = 0.01
# Largest distance of the principal point from the middle / image width: up to 0.036 in the cameras
# of KITTI, KITTI-360, EuRoC, Cityscapes, nuScenes, TuSimple, OAK-D and others, 0.047 in one; 0.10
# in Middlebury's crops. Above 0.07: doubt.
_CENTRED, _OFF_CENTRE = 0.05, 0.07
_USUAL_FOV_DEG = (20.0, 130.0)  # horizontal field of view of pinhole cameras for driving
_COMMON_SIZES = (  # of images of cameras and data sets for driving, pixels
    *(
        (640, 360),
        (848, 480),
        (960, 540),
        (1280, 720),
        (1600, 900),
        (1920, 1080),
        (2304, 1296),
        (2560, 1440),
    ),
    *(
        (2704, 1520),
        (3840, 2160),
        (640, 480),
        (800, 600),
        (1024, 768),
        (1280, 960),
        (1440, 1080),
        (1600, 1200),
    ),
    *(
        (2592, 1944),
        (1280, 800),
        (1920, 1200),
        (1928, 1208),
        (752, 480),
        (672, 376),
        (2208, 1242),
        (1164, 874),
    ),
    *((1242, 375), (1408, 376), (1392, 512), (2048, 1024), (1762, 800)),
)

# widths and heights of digitised analogue video
_ANALOGUE_PX = (352, 704, 720, 960), (240, 288, 480, 576)


class FocalAlternative(NamedTuple):
    """Another possible meaning of a calibration or focal length."""

    factor: float  # by which the distances are too long if it holds
    cause: str  # what would have happened, for messages


def size_alternatives(
    camera: PinholeCamera, size_px: tuple[int, int]
) -> tuple[FocalAlternative, ...]:
    """Readings of a camera, as stated in its file, that its principal point supports; `size_px` is
    (width, height).
    """
    size = camera.size_px if camera.width_px else size_px
    width = size[0]
    if abs(camera.cx_px - (width - 1) / 2) <= _OFF_CENTRE * width:
        return ()
    return tuple(
        FocalAlternative(w / width, f"K belongs to images of {w}x{h} px that were resized")
        for w, h in _centred_sizes(camera, size)
    )


def _centred_sizes(camera: PinholeCamera, size_px: tuple[int, int]) -> list[tuple[int, int]]:
    """Up to two usual sizes in which the principal point is central, sizes with the aspect of
    `size_px` first.
    """
    sizes = [
        (w, h)
        for w, h in _COMMON_SIZES
        if max(abs(camera.cx_px - (w - 1) / 2), abs(camera.cy_px - (h - 1) / 2)) <= _CENTRED * w
    ]
    sizes.sort(key=lambda wh: abs(math.log(wh[0] / wh[1] * size_px[1] / size_px[0])))
    return sizes[:2] or [(round(2 * camera.cx_px + 1), round(2 * camera.cy_px + 1))]


def fitted_to_size(
    camera: PinholeCamera, size_px: tuple[int, int], source: object
) -> tuple[PinholeCamera, tuple[str, ...]]:
    """The camera adapted to images of `size_px` = (width, height), and notes for the user.

    The calibrated size may differ by a few rows or columns cropped by a codec; otherwise the camera
    is scaled if the aspect ratio agrees. Without a calibrated size, the principal point must lie in
    the middle third of the image. Raises RigError if the calibration is for images of a different
    shape or size.
    """
    width, height = size_px
    fitted, notes = replace(camera, width_px=width, height_px=height), tuple[str, ...]()
    calibrated = f"{camera.width_px}x{camera.height_px}"
    if camera.width_px == 0:
        if not (
            width / 3 <= camera.cx_px <= width * 2 / 3
            and height / 3 <= camera.cy_px <= height * 2 / 3
        ):
            raise RigError(
                f"{source}: expected a principal point in the middle third of the {width}x{height} "
                f"px images, found ({camera.cx_px:.1f}, {camera.cy_px:.1f}), as in images of "
                f"{_listed(_centred_sizes(camera, size_px))} px; give the calibration of these "
                "images."
            )
        notes = (
            f"{source}: the calibration has no image size; it is taken to be {width}x{height} px, "
            "the size of the images.",
        )
    elif not is_size_of(camera, size_px):
        if not has_aspect_of(camera, size_px):
            raise RigError(
                f"{source}: expected images with the aspect ratio of {calibrated} px, found "
                f"{width}x{height} px; give the calibration of these images."
            )
        fitted = camera.resized(size_px)
        notes = (
            f"{source}: the calibration is scaled from {calibrated} px to the image size, "
            f"{width}x{height} px, assuming that the images are resized: the focal length is "
            f"{fitted.fx_px:.0f} px. If they are cropped, as in modes that use a part of the "
            f"sensor, the focal length is {camera.fx_px:.0f} px, and distances are "
            f"{camera.width_px / width:.2f} times as long; in that case, give the calibration of "
            "these images.",
        )
    doubts = size_alternatives(camera, size_px)
    if doubts:
        own = camera.size_px if camera.width_px else size_px
        likely, sizes = doubts[0], _centred_sizes(camera, own)
        size = _listed(sizes[:1])
        command = (
            "" if camera.width_px else f" (track-range rig convert FILE rig.yaml --size {size})"
        )
        advice = f"state this size in the calibration{command}"
        if not has_aspect_of(replace(camera, width_px=sizes[0][0], height_px=sizes[0][1]), size_px):
            advice = (
                "give the calibration of these images (fy "
                f"{camera.fy_px * height / sizes[0][1]:.0f} px)"
            )
        notes += (
            f"{source}: the focal length is in doubt: the principal point x = {camera.cx_px:.0f} "
            f"px is {abs(camera.cx_px + 0.5 - own[0] / 2) / own[0]:.0%} of the width off the "
            f"middle of {own[0]}x{own[1]} px (usual: up to {_CENTRED:.0%}), but central in "
            f"{_listed(sizes)} px. If images were resized from {size} px, the focal length is "
            f"{fitted.fx_px / likely.factor:.0f} px instead of {fitted.fx_px:.0f} px, and "
            f"distances are {likely.factor:.2f} times what they should be; in that case, {advice}. "
            "If they were cropped, the focal length is right. The sigmas of all distances cover "
            "both.",
        )
    return fitted, (*notes, *field_notes(fitted, source))


def fitted_rig(
    rig: StereoRig, sizes_px: tuple[tuple[int, int], tuple[int, int]], source: object
) -> tuple[StereoRig, tuple[str, ...]]:
    """The pair adapted to images of two sizes, see `fitted_to_size`; notes that hold for both
    cameras appear once.
    """
    left, left_notes = fitted_to_size(rig.left, sizes_px[0], f"{source} (left)")
    right, right_notes = fitted_to_size(rig.right, sizes_px[1], f"{source} (right)")
    is_equal = sizes_px[0] == sizes_px[1] and rig.left.size_px == rig.right.size_px and left_notes
    fitted = StereoRig(left, right, rig.right_from_left, accuracy=rig.accuracy)
    return fitted, left_notes if is_equal else (*left_notes, *right_notes)


def analogue_alternatives(size_px: tuple[int, int]) -> tuple[FocalAlternative, ...]:
    """Pixel aspects of analogue video whose file states no aspect; its pixels are taken as square.

    Distances by width are then too long by the pixel aspect, and distances by height are right: the
    factor is in between.
    """
    if size_px[0] not in _ANALOGUE_PX[0] or size_px[1] not in _ANALOGUE_PX[1]:
        return ()
    aspects = {
        shape: shape[0] * size_px[1] / (shape[1] * size_px[0]) for shape in ((4, 3), (16, 9))
    }
    return tuple(
        FocalAlternative(
            math.sqrt(aspect), f"shown as {w}:{h}, pixels are {aspect:.2f} times as wide as high"
        )
        for (w, h), aspect in aspects.items()
    )


def field_notes(camera: PinholeCamera, source: object) -> tuple[str, ...]:
    """A note on a focal length of a pinhole camera with an unusual field of view."""
    fov_deg = 2 * math.degrees(math.atan(camera.width_px / 2 / camera.fx_px))
    low, high = _USUAL_FOV_DEG
    if camera.is_wide or low <= fov_deg <= high:
        return ()
    return (
        f"{source}: a focal length of {camera.fx_px:.0f} px in images {camera.width_px} px wide is "
        f"a field of view of {fov_deg:.0f} degrees; cameras for driving have {low:.0f} to "
        f"{high:.0f} degrees. Check that it is in pixels of images of this size.",
    )


def _listed(sizes: list[tuple[int, int]]) -> str:
    return " or ".join(f"{width}x{height}" for width, height in sizes)


def is_size_of(camera: PinholeCamera, size_px: tuple[int, int]) -> bool:
    """Whether images of this size come from the camera, perhaps cropped by a codec."""
    return all(
        0 <= own - side <= _CROPPED_PX for own, side in zip(camera.size_px, size_px, strict=True)
    )


def has_aspect_of(camera: PinholeCamera, size_px: tuple[int, int]) -> bool:
    """Whether images of this size have the aspect ratio of the images of the camera."""
    return (
        abs((size_px[0] / camera.width_px) / (size_px[1] / camera.height_px) - 1)
        <= _ASPECT_TOLERANCE
    )
