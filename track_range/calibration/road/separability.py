"""What a fit of a camera determines, in words: parameters from measurements, and pairs that cannot be separated."""

from __future__ import annotations

import math
from collections.abc import Sequence

from track_range.ranging.fitting.camera.camera_fit import CameraFit
from track_range.ranging.fitting.camera.focal_evidence import FocalPosterior
from track_range.ranging.fitting.camera.measurements import FocalGuess

_DETERMINED = 0.7  # standard deviation relative to that of the prior below which the measurements determine a parameter
_INSEPARABLE = 0.85  # magnitude of the correlation above which two parameters cannot be separated


def separability(
    fit: CameraFit, guesses: Sequence[FocalGuess], by_shape: FocalPosterior, *, has_height: bool
) -> tuple[str, ...]:
    """Sentences on focal length, camera height, pitch, and pairs of them.

    `by_shape` is the prior of the fit: guesses from outside of the images, and shapes of road users.
    """
    camera, (shape_px, shape_sigma) = fit.camera, by_shape.guess
    origin = guesses[0].source if len(guesses) == 1 else " and ".join(guess.source for guess in guesses)
    if by_shape.n_tracks:
        origin += (
            f", and the shapes of {by_shape.n_tracks} vehicles ({shape_px:.0f} px within {100 * shape_sigma:.0f} %)"
        )
    focal = f"Focal length {camera.fx_px:.0f} px within {100 * fit.focal_sigma:.1f} %"
    sentences = []
    if fit.contradiction != 1.0:
        name, deviation = fit.largest_deviation
        sentences.append(
            f"Warning: the measurements contradict each other, or what is usual: {name}, is off by "
            f"{abs(deviation):.0f} sigma. All sigmas are {fit.contradiction:.1f} times as large; check boxes and "
            "metres."
        )
    if fit.gain("focal length") < _DETERMINED:
        sentences.append(f"{focal}, by the measurements (before: {shape_px:.0f} px, from {origin}).")
    else:
        sentences.append(f"{focal}: the measurements do not determine it; it comes from {origin}.")
    height = f"Camera height {fit.height_m:.2f} ± {fit.height_sigma_m:.2f} m"
    if has_height:
        sentences.append(f"{height}, as measured.")
    elif fit.gain("camera height") < _DETERMINED:
        sentences.append(f"{height}, from the contact points of objects of known distance or size.")
    else:
        sentences.append(f"{height}: a usual height, which the measurements do not determine; give --camera-height-m.")
    pitch = (
        f"Pitch {math.degrees(fit.pitch_rad):+.1f} ± {math.degrees(fit.pitch_sigma_rad):.1f} degrees (positive = down)"
    )
    sentences.append(f"{pitch}." if fit.gain("horizon") < _DETERMINED else f"{pitch}: not determined.")
    if abs(fit.correlation("focal length", "camera height")) > _INSEPARABLE:
        sentences.append(
            "Focal length and camera height cannot be separated: their product is known within "
            f"{100 * fit.product_sigma:.1f} %. Measure the height of the camera, or a distance to an object of known "
            "height."
        )
    if abs(fit.correlation("camera height", "horizon")) > _INSEPARABLE:
        sentences.append(
            "Camera height and pitch cannot be separated: add a distance at least twice as long or half as long."
        )
    return tuple(sentences)
