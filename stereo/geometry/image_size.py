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
from track_range.stereo.geometry.rig import RigError, StereoRig

_CROPPED_PX = 2  # largest number of rows or columns that video codecs crop
# largest relative difference of aspect ratios at which a calibration is scaled
_ASPECT_TOLERANCE = 0.01
# Largest distance of the principal point from the middle / image width: up to 0.036 in the cameras
# of KITTI, KITTI-360, EuRoC, Cityscapes, nuScenes, TuSimple, OAK-D and others, 0.047 in one; 0.10
# in Middlebury's crops. Above 0.07: doubt.
_CENTRED, _OFF_CENTRE = 0.05, 0.07
_USUAL_FOV_DEG = (20.0, 130.0)  # horizontal field of view of pinhole cameras for driving
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


def size_alternatives(
    camera: PinholeCamera, size_px: tuple[int, int]
) -> tuple[FocalAlternative, ...]:
    """Readings of a camera, as stated in its file, that its principal point supports; `size_px` is
    (width, height).
    """
    return SizeFit(camera, size_px).alternatives


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


@dataclass(frozen=True, slots=True)
class SizeFit:
    """A camera, as stated in its file, and images of a size."""

    stated: PinholeCamera
    size_px: tuple[int, int]  # (width, height)

    @property
    def reading(self) -> SizeReading:
        """How the images belong to the camera."""
        if self.stated.width_px:
            if is_size_of(self.stated, self.size_px):
                return "stated"
            return "scaled" if has_aspect_of(self.stated, self.size_px) else "other aspect"
        width, height = self.size_px
        is_central_x = width / 3 <= self.stated.cx_px <= width * 2 / 3
        is_central_y = height / 3 <= self.stated.cy_px <= height * 2 / 3
        return "assumed" if is_central_x and is_central_y else "off centre"

    @property
    def camera(self) -> PinholeCamera:
        """The camera of the images; without a meaning if these have another aspect, or are off
        centre.
        """
        if self.reading == "scaled":
            return self.stated.resized(self.size_px)
        width, height = self.size_px
        return replace(self.stated, width_px=width, height_px=height)

    @property
    def calibrated_px(self) -> tuple[int, int]:
        """The size that the file states, else that of the images."""
        return self.stated.size_px if self.stated.width_px else self.size_px

    @property
    def centred_sizes(self) -> list[tuple[int, int]]:
        """Usual sizes in which the principal point is central."""
        return _centred_sizes(self.stated, self.calibrated_px)

    @property
    def alternatives(self) -> tuple[FocalAlternative, ...]:
        """Readings that a principal point off the centre supports, the likeliest first."""
        width = self.calibrated_px[0]
        if abs(self.stated.cx_px - (width - 1) / 2) <= _OFF_CENTRE * width:
            return ()
        return tuple(
            FocalAlternative(w / width, f"K belongs to images of {w}x{h} px that were resized")
            for w, h in self.centred_sizes
        )


def fitted_to_size(
    camera: PinholeCamera, size_px: tuple[int, int], source: object
) -> tuple[PinholeCamera, tuple[str, ...]]:
    """The camera adapted to images of `size_px` = (width, height), and notes for the user.

    The calibrated size may differ by a few rows or columns cropped by a codec; otherwise the camera
    is scaled if the aspect ratio agrees. Without a calibrated size, the principal point must lie in
    the middle third of the image. Raises RigError if the calibration is for images of a different
    shape or size.
    """
    fit = SizeFit(camera, size_px)
    notes = [*_reading_notes(fit, source), *_doubt_notes(fit, source)]
    return fit.camera, (*notes, *field_notes(fit.camera, source))


def _reading_notes(fit: SizeFit, source: object) -> tuple[str, ...]:
    """A note on a size that is assumed or scaled; RigError for images that do not belong to the
    camera.
    """
    camera, (width, height) = fit.stated, fit.size_px
    calibrated = f"{camera.width_px}x{camera.height_px}"
    match fit.reading:
        case "off centre":
            raise RigError(
                f"{source}: expected a principal point in the middle third of the {width}x{height} "
                f"px images, found ({camera.cx_px:.1f}, {camera.cy_px:.1f}), as in images of "
                f"{_listed(fit.centred_sizes)} px; give the calibration of these images."
            )
        case "other aspect":
            raise RigError(
                f"{source}: expected images with the aspect ratio of {calibrated} px, found "
                f"{width}x{height} px; give the calibration of these images."
            )
        case "assumed":
            note = (
                f"{source}: the calibration has no image size; it is taken to be {width}x{height} "
                "px, the size of the images."
            )
        case "scaled":
            note = (
                f"{source}: the calibration is scaled from {calibrated} px to the image size, "
                f"{width}x{height} px, assuming that the images are resized: the focal length is "
                f"{fit.camera.fx_px:.0f} px. If they are cropped, as in modes that use a part of "
                f"the sensor, the focal length is {camera.fx_px:.0f} px, and distances are "
                f"{camera.width_px / width:.2f} times as long; in that case, give the calibration "
                "of these images."
            )
        case "stated":
            return ()
    return (note,)


def _doubt_notes(fit: SizeFit, source: object) -> tuple[str, ...]:
    """A note on a principal point that is central in images of another size."""
    if not fit.alternatives:
        return ()
    camera, (width, height) = fit.stated, fit.calibrated_px
    factor = fit.alternatives[0].factor
    sizes = fit.centred_sizes
    likely_size = _listed(sizes[:1])
    focal_px = fit.camera.fx_px
    off_centre = abs(camera.cx_px + 0.5 - width / 2) / width
    return (
        f"{source}: the focal length is in doubt: the principal point x = {camera.cx_px:.0f} "
        f"px is {off_centre:.0%} of the width off the middle of {width}x{height} px (usual: up to "
        f"{_CENTRED:.0%}), but central in {_listed(sizes)} px. If images were resized from "
        f"{likely_size} px, the focal length is {focal_px / factor:.0f} px instead of "
        f"{focal_px:.0f} px, and distances are {factor:.2f} times what they should be; in that "
        f"case, {_advice(fit, sizes[0])}. If they were cropped, the focal length is right. The "
        "sigmas of all distances cover both.",
    )


def _advice(fit: SizeFit, likely_px: tuple[int, int]) -> str:
    """What to do if the camera belongs to images of `likely_px`, (width, height)."""
    camera, (width_px, height_px) = fit.stated, likely_px
    likely = replace(camera, width_px=width_px, height_px=height_px)
    if not has_aspect_of(likely, fit.size_px):
        fy_px = camera.fy_px * fit.size_px[1] / height_px
        return f"give the calibration of these images (fy {fy_px:.0f} px)"
    if camera.width_px:
        return "state this size in the calibration"
    size = f"{width_px}x{height_px}"
    command = f"track-range rig convert FILE rig.yaml --size {size}"
    return f"state this size in the calibration ({command})"


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
    alternatives = []
    for width, height in ((4, 3), (16, 9)):
        aspect = width * size_px[1] / (height * size_px[0])
        cause = f"shown as {width}:{height}, pixels are {aspect:.2f} times as wide as high"
        alternatives.append(FocalAlternative(math.sqrt(aspect), cause))
    return tuple(alternatives)


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
    scale_x, scale_y = size_px[0] / camera.width_px, size_px[1] / camera.height_px
    return abs(scale_x / scale_y - 1) <= _ASPECT_TOLERANCE
