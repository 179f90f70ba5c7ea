"""Results of a calibration for `calibrate --json`: cameras, standard deviations, used and rejected views."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from track_range.calibration.board_search import BoardSearch
from track_range.stereo.calibration.coverage import view_shape
from track_range.stereo.calibration.one_camera import CameraCalibration, ViewFit
from track_range.stereo.calibration.two_cameras import PairCalibration


def mono_figures(calibration: CameraCalibration, search: BoardSearch) -> dict[str, Any]:
    """Results of one camera as plain values for JSON."""
    return {
        "camera": _camera_figures(calibration),
        "rms_px": calibration.rms_px,
        "views": [_view_figures(fit) for fit in calibration.fits],
        "rejected": [asdict(view) for view in (*search.rejected, *calibration.rejected)],
        "notes": search.notes,
        "warnings": list(calibration.coverage.warnings),
    }


def pair_figures(calibration: PairCalibration, search: BoardSearch) -> dict[str, Any]:
    """Results of a rig as plain values for JSON."""
    warnings = [
        f"{name}: {text}"
        for name, camera in (("left", calibration.left), ("right", calibration.right))
        for text in camera.coverage.warnings
    ]
    return {
        "left": _camera_figures(calibration.left),
        "right": _camera_figures(calibration.right),
        "right_from_left": calibration.rig.right_from_left.tolist(),
        "baseline_m": calibration.rig.baseline_m,
        "baseline_sd_m": calibration.baseline_std_m,
        "rms_px": calibration.rms_px,
        "single_rms_px": list(calibration.single_rms_px),
        "rows_px": calibration.row_error_px,
        "held_out_rows_px": calibration.held_out_row_error_px,
        "views": [
            {
                **_view_figures(fit.left),
                "right_name": fit.right.view.name,
                "right_rms_px": fit.right.rms_px,
                "rows_px": fit.row_error_px,
            }
            for fit in calibration.fits
        ],
        "rejected": [asdict(view) for view in (*search.rejected, *calibration.rejected)],
        "notes": search.notes,
        "warnings": warnings,
    }


def _camera_figures(calibration: CameraCalibration) -> dict[str, Any]:
    coverage = {key: value for key, value in asdict(calibration.coverage).items() if key != "warnings"}
    std = asdict(calibration.std)
    return {**asdict(calibration.camera), "sd": std, "rms_px": calibration.rms_px, "coverage": coverage}


def _view_figures(fit: ViewFit) -> dict[str, Any]:
    x, y, size, skew = view_shape(fit.view).tolist()
    shape = {"x": x, "y": y, "size": size, "skew": skew, "tilt_deg": tilt_deg(fit)}
    return {"name": fit.view.name, "rms_px": fit.rms_px, "edge_px": fit.view.edge_px, "n": len(fit.view.xy_px), **shape}


def tilt_deg(fit: ViewFit) -> float:
    """Angle between the board and the image plane, degrees."""
    return float(np.degrees(np.arccos(np.clip(abs(fit.board_to_camera[2, 2]), 0, 1))))
