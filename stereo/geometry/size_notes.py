"""Notes on the size of the images that a calibration is used for, and its refusals.

The readings are those of `image_size`.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.image_size import CENTRED, SizeFit, fit_to_size, has_aspect_of
from track_range.stereo.geometry.rig import RigError, StereoRig

_USUAL_FOV_DEG = (20.0, 130.0)  # horizontal field of view of pinhole cameras for driving


def fitted_to_size(
    camera: PinholeCamera, size_px: tuple[int, int], source: object
) -> tuple[PinholeCamera, tuple[str, ...]]:
    """The camera adapted to images of `size_px` = (width, height), see `fit_to_size`, and notes for
    the user. Raises RigError if the calibration is for images of a different shape or size.
    """
    fit = fit_to_size(camera, size_px)
    if fit.reading in ("off centre", "other aspect"):
        raise RigError(f"{source}: {_reading_sentence(fit)}")
    sentences = (_reading_sentence(fit), _doubt_sentence(fit))
    notes = [f"{source}: {sentence}" for sentence in sentences if sentence]
    return fit.camera, (*notes, *field_notes(fit.camera, source))


def fitted_rig(
    rig: StereoRig, sizes_px: tuple[tuple[int, int], tuple[int, int]], source: object
) -> tuple[StereoRig, tuple[str, ...]]:
    """The pair adapted to images of two sizes, see `fitted_to_size`; notes that hold for both
    cameras appear once.
    """
    left, left_notes = fitted_to_size(rig.left, sizes_px[0], f"{source} (left)")
    right, right_notes = fitted_to_size(rig.right, sizes_px[1], f"{source} (right)")
    is_equal = sizes_px[0] == sizes_px[1] and rig.left.size_px == rig.right.size_px and left_notes
    fitted = replace(rig, left=left, right=right, alignment=None)
    return fitted, left_notes if is_equal else (*left_notes, *right_notes)


def _reading_sentence(fit: SizeFit) -> str:
    """How the images belong to the camera, or why they do not; "" for images of the stated size."""
    camera, (width, height) = fit.stated, fit.size_px
    calibrated = f"{camera.width_px}x{camera.height_px}"
    match fit.reading:
        case "off centre":
            return (
                f"expected a principal point in the middle third of the {width}x{height} "
                f"px images, found ({camera.cx_px:.1f}, {camera.cy_px:.1f}), as in images of "
                f"{_listed(fit.centred_sizes)} px; give the calibration of these images."
            )
        case "other aspect":
            return (
                f"expected images with the aspect ratio of {calibrated} px, found "
                f"{width}x{height} px; give the calibration of these images."
            )
        case "assumed":
            return (
                f"the calibration has no image size; it is taken to be {width}x{height} "
                "px, the size of the images."
            )
        case "scaled":
            return (
                f"the calibration is scaled from {calibrated} px to the image size, "
                f"{width}x{height} px, assuming that the images are resized: the focal length is "
                f"{fit.camera.fx_px:.0f} px. If they are cropped, as in modes that use a part of "
                f"the sensor, the focal length is {camera.fx_px:.0f} px, and distances are "
                f"{camera.width_px / width:.2f} times as long; in that case, give the calibration "
                "of these images."
            )
        case "stated":
            return ""


def _doubt_sentence(fit: SizeFit) -> str:
    """A principal point that is central in images of another size; "" for one that is central."""
    if not fit.alternatives:
        return ""
    width, height = fit.calibrated_px
    factor = fit.alternatives[0].factor
    focal_px = fit.camera.fx_px
    off_centre = abs(fit.stated.cx_px + 0.5 - width / 2) / width
    return (
        f"the focal length is in doubt: the principal point x = {fit.stated.cx_px:.0f} "
        f"px is {off_centre:.0%} of the width off the middle of {width}x{height} px (usual: up to "
        f"{CENTRED:.0%}), but central in {_listed(fit.centred_sizes)} px. If images were resized "
        f"from {_listed(fit.centred_sizes[:1])} px, the focal length is {focal_px / factor:.0f} px "
        f"instead of {focal_px:.0f} px, and distances are {factor:.2f} times what they should be; "
        f"in that case, {_advice(fit)}. If they were cropped, the focal length is right. The "
        "sigmas of all distances cover both."
    )


def _advice(fit: SizeFit) -> str:
    """What to do if the camera belongs to images of the likeliest size."""
    camera, (width_px, height_px) = fit.stated, fit.centred_sizes[0]
    likely = replace(camera, width_px=width_px, height_px=height_px)
    if not has_aspect_of(likely, fit.size_px):
        fy_px = camera.fy_px * fit.size_px[1] / height_px
        return f"give the calibration of these images (fy {fy_px:.0f} px)"
    if camera.width_px:
        return "state this size in the calibration"
    return (
        "state this size in the calibration (track-range rig convert FILE rig.yaml --size "
        f"{width_px}x{height_px})"
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


def _listed(sizes: Sequence[tuple[int, int]]) -> str:
    return " or ".join(f"{width}x{height}" for width, height in sizes)
