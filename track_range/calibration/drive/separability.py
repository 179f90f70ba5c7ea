"""Sentences on what measurements of a drive determine of its camera."""

import math

from track_range.calibration.drive.pre_pass import MountedCamera

# standard deviation relative to that of the prior below which the measurements determine a
# parameter
_DETERMINED = 0.7
_INSEPARABLE = 0.85  # magnitude of the correlation above which two parameters cannot be separated


def separability(mounted: MountedCamera, *, has_height: bool) -> tuple[str, ...]:
    """Sentences on focal length, camera height and pitch, alone and in pairs."""
    fit, before = mounted.fit, mounted.before
    prior, sigma = before.guess, mounted.focal_sigma
    focal = f"Focal length {mounted.estimate.focal_px:.0f} px within {100 * sigma:.1f} %"
    sentences = []
    if fit.contradiction != 1.0:
        name, deviation = fit.largest_deviation
        sentences.append(
            f"Warning: the measurements contradict each other, or usual values: {name} is off by "
            f"{abs(deviation):.0f} sigma. All sigmas are {fit.contradiction:.1f} times as large; "
            "check boxes and metres."
        )
    if sigma < _DETERMINED * prior.sigma:
        sentences.append(
            f"{focal}, from the measurements; without them, {prior.focal_px:.0f} px within "
            f"{100 * prior.sigma:.0f} %, from {prior.source}."
        )
    else:
        sentences.append(f"{focal}, from {before.leading.source}.")
    if before.distortion:
        sentences.append(f"Distortion k1 = {before.k1:+.3f} ± {before.k1_sigma:.3f}.")
    height = f"Camera height {fit.height_m:.2f} ± {fit.height_sigma_m:.2f} m"
    if has_height:
        sentences.append(f"{height}, as measured.")
    elif fit.gain("camera height") < _DETERMINED:
        sentences.append(f"{height}, from the contact points of objects of known distance or size.")
    else:
        sentences.append(
            f"{height}: this is a usual height, since the measurements do not determine the "
            "height; give --camera-height-m."
        )
    pitch = (
        f"Pitch {math.degrees(fit.pitch_rad(mounted.estimate.camera)):+.1f} ± {math.degrees(fit.pitch_sigma_rad):.1f} "
        "degrees (positive = down)"
    )
    sentences.append(
        f"{pitch}." if fit.gain("horizon") < _DETERMINED else f"{pitch}: not determined."
    )
    if abs(fit.correlation("focal length", "camera height")) > _INSEPARABLE:
        sentences.append(
            "Focal length and camera height cannot be separated: their product is known within "
            f"{100 * fit.product_sigma:.1f} %. Measure the height of the camera, or a distance to "
            "an object of known height."
        )
    if abs(fit.correlation("camera height", "horizon")) > _INSEPARABLE:
        sentences.append(
            "Camera height and pitch cannot be separated: add a distance at least twice or at most "
            "half as long."
        )
    return tuple(sentences)
