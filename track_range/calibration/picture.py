"""The picture of a calibration: coverage and residuals of the corners, and the residual of each view.

left   the image plane: density of corners as shades, residuals as arrows, enlarged by the factor in the title
right  one bar per view: its residual and name; the three worst are red
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from track_range.foundation.files.cache_folder import set_matplotlib_folder
from track_range.stereo.calibration.one_camera import CameraCalibration

_ARROW_FRACTION = 0.025  # arrow of the 90th percentile of the residuals / image width
_N_CELLS = 40  # cells along a row of the image in which corners are counted


def calibration_picture(cameras: Mapping[str, CameraCalibration]) -> bytes:
    """A PNG file with one row of panels per camera, with its name as title."""
    set_matplotlib_folder()
    from matplotlib.colors import PowerNorm  # matplotlib takes a third of a second
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 6.5 * len(cameras)), layout="constrained")
    panels = figure.subplots(len(cameras), 2, squeeze=False, width_ratios=(2, 1))
    for (plane, bars), (name, calibration) in zip(panels, cameras.items(), strict=True):
        fits, width_px, height_px = calibration.fits, calibration.camera.width_px, calibration.camera.height_px
        xy_px = np.concatenate([fit.view.xy_px for fit in fits])
        residual_px = np.concatenate([fit.residual_px for fit in fits])
        view = np.repeat(np.arange(len(fits)), [len(fit.view.xy_px) for fit in fits])
        length_px = float(np.percentile(np.linalg.norm(residual_px, axis=1), 90))
        factor = _ARROW_FRACTION * width_px / max(length_px, 1e-6)
        edges = ((-0.5, width_px - 0.5), (-0.5, height_px - 0.5))
        cells = (_N_CELLS, max(_N_CELLS * height_px // width_px, 1))
        plane.hist2d(*xy_px.T, bins=cells, range=edges, cmap="GnBu", norm=PowerNorm(0.5), alpha=0.6)
        arrows: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.0012}
        plane.quiver(*xy_px.T, *(factor * residual_px).T, view, cmap="hsv", **arrows)
        title = f"{name}: {len(fits)} views, residual {calibration.rms_px:.3f} px RMS; arrows x {factor:.0f}"
        plane.set(xlim=edges[0], ylim=edges[1][::-1], aspect="equal", title=title)
        rms_px = np.array([fit.rms_px for fit in fits])
        is_worst = np.argsort(np.argsort(-rms_px)) < 3
        drawn = bars.barh(np.arange(len(fits)), rms_px, color=np.where(is_worst, "#dc3c3c", "#3c82be"))
        bars.bar_label(drawn, fmt="%.2f", fontsize=7)
        names = [fit.view.name[-28:].encode("ascii", "replace").decode() for fit in fits]  # as the font has them
        bars.set_yticks(np.arange(len(fits)), names, fontsize=7, parse_math=False)
        bars.set(xlabel="residual, px", ylim=(len(fits) - 0.5, -0.5))
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
