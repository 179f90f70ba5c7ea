"""A calibration's figures, as `calibrate --json` keeps them: cameras, standard deviations, views, what was left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from track_range.calibration.board_search import FoundViews
from track_range.stereo.calibration.board_views import RejectedView
from track_range.stereo.calibration.coverage import view_shape
from track_range.stereo.calibration.one_camera import CameraCalibration, ViewFit
from track_range.stereo.calibration.two_cameras import PairCalibration


def mono_figures(found: CameraCalibration, search: FoundViews) -> dict[str, Any]:
    """Of one camera."""
    return {
        "camera": _camera_figures(found),
        "rms_px": found.rms_px,
        "views": [_view_figures(fit) for fit in found.fits],
        "rejected": _rejected_figures([*search.rejected, *found.rejected]),
        "notes": search.notes,
        "warnings": list(found.coverage.warnings),
    }


def pair_figures(found: PairCalibration, search: FoundViews) -> dict[str, Any]:
    """Of a rig."""
    warnings = [
        f"{name}: {text}"
        for name, eye in (("left", found.left), ("right", found.right))
        for text in eye.coverage.warnings
    ]
    return {
        "left": _camera_figures(found.left),
        "right": _camera_figures(found.right),
        "right_from_left": found.rig.right_from_left.tolist(),
        "baseline_m": found.rig.baseline_m,
        "baseline_sd_m": found.baseline_sd_m,
        "rms_px": found.rms_px,
        "rows_px": found.rows_px,
        "held_out_rows_px": found.held_out_rows_px,
        "views": [
            {
                **_view_figures(fit.left),
                "right_name": fit.right.view.name,
                "right_rms_px": fit.right.rms_px,
                "rows_px": fit.rows_px,
            }
            for fit in found.fits
        ],
        "rejected": _rejected_figures([*search.rejected, *found.rejected]),
        "notes": search.notes,
        "warnings": warnings,
    }


def _camera_figures(found: CameraCalibration) -> dict[str, Any]:
    coverage = asdict(found.coverage)
    del coverage["warnings"]
    return {**asdict(found.camera), "sd": asdict(found.std), "rms_px": found.rms_px, "coverage": coverage}


def _view_figures(fit: ViewFit) -> dict[str, Any]:
    x, y, size, skew = view_shape(fit.view).tolist()
    shape = {"x": x, "y": y, "size": size, "skew": skew, "tilt_deg": tilt_deg(fit)}
    return {"name": fit.view.name, "rms_px": fit.rms_px, "edge_px": fit.view.edge_px, "n": len(fit.view.xy_px), **shape}


def _rejected_figures(rejected: Sequence[RejectedView]) -> list[dict[str, str]]:
    return [{"name": view.name, "reason": view.reason} for view in rejected]


def tilt_deg(fit: ViewFit) -> float:
    """Angle between the board's plane and the image plane."""
    return float(np.degrees(np.arccos(np.clip(abs(fit.board_to_camera[2, 2]), 0, 1))))
