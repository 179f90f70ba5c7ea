"""Sentences about a recording without calibration, and what is assumed for it.

Distances need the focal length f in pixels. If it is not given, it is estimated, and its relative uncertainty is part
of that of all distances.
"""

from __future__ import annotations

from track_range.ranging.fitting.camera.measurements import FocalGuess

GIVEN_FOCAL_SIGMA = 0.02
"""Relative standard deviation of a focal length given by the user; assumed."""

ASSUMED_BASELINE_M = 0.5
"""Baseline of an uncalibrated pair; it only sets the range of disparities that is searched."""

HOW_TO_CALIBRATE = (
    "for calibrated distances record a chessboard with both cameras, run `track-range calibrate --stereo LEFT RIGHT "
    "--board 9x6 --square-mm MM --out rig.yaml`, and give --rig rig.yaml"
)


def pair_notes(focal: FocalGuess, row_offset_px: float | None, *, is_given: bool) -> tuple[str, ...]:
    """Messages about a pair without a rig.

    Args:
        focal: its focal length.
        row_offset_px: corrected vertical offset; None = matching points are not in equal rows.
        is_given: whether the user gave the focal length.
    """
    length = f"the focal length is {focal.focal_px:.0f} px as given" if is_given else focal_sentence(focal)
    if row_offset_px is None:
        return (
            f"No rig, so distances are uncalibrated: {length}; {HOW_TO_CALIBRATE}.",
            "Matching points of left and right are not in equal rows, so stereo matching needs a rig: distances "
            "come from the left video alone.",
        )
    rows = f" Vertical offset of {row_offset_px:+.1f} px between left and right; corrected." if row_offset_px else ""
    return (
        f"No rig, so distances are uncalibrated: {length}, and the baseline is estimated from the sizes of road "
        f"users; {HOW_TO_CALIBRATE}.{rows}",
    )


def focal_sentence(guess: FocalGuess) -> str:
    """Clause about an estimated focal length."""
    return (
        f"the focal length is estimated as {guess.focal_px:.0f} px within {100 * guess.sigma:.0f} %, from "
        f"{guess.source} (give --focal-px if it is known)"
    )
