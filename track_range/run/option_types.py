"""Keyword arguments of `Run` and `Pipeline`, for type checkers.

Written by `.ci/run_options.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict

if TYPE_CHECKING:
    from rich.console import Console

    from track_range.detection.detector import ObjectDetector
    from track_range.stereo.geometry.mounting import Mounting
    from track_range.stereo.geometry.rig import StereoRig
    from track_range.tracking.registry import ObjectTracker


class PipelineKeywords(TypedDict, total=False):
    """Options of detection, tracking and ranging by keyword; None = not given."""

    detector: str | Path | ObjectDetector | None
    classes: str | Sequence[str] | None
    min_score: str | float | None
    ignore: str | Path | None
    names: str | Path | Sequence[str] | None
    anchors: str | None
    letterbox: str | None
    layout: str | None
    size: str | int | None
    size_px: str | int | None
    far_pass: int | None
    threads: int | None
    device: Literal["auto", "cpu", "cuda", "tensorrt", "openvino", "coreml", "directml"] | None
    tracker: str | ObjectTracker | None
    reid: str | Path | None
    tracker_min_score: float | None
    curves: str | Path | None
    region: Literal["unknown", "europe", "north-america", "east-asia"] | None
    sgbm: bool | None
    sgbm_options: Mapping[str, Any] | None
    warning_options: Mapping[str, Any] | None
    event_options: Mapping[str, Any] | None
    lanes: str | Path | None
    lane_width_m: float | None
    camera_height_m: float | None
    lens_fov_deg: str | None
    camera_model: str | None
    mount: str | Sequence[str] | Mounting | None
    methods: str | Sequence[str] | None
    show_only: str | Sequence[str] | None
    depth_model: str | Path | Sequence[str | Path] | None
    stereo_model: str | Path | Sequence[str | Path] | None
    static_camera: bool | None
    ground: str | Path | None
    count_line: str | Sequence[str] | None
    zone: str | Sequence[str] | None


class RunKeywords(PipelineKeywords, total=False):
    """Options of a run by keyword; None = not given."""

    stereo_layout: (
        Literal["auto", "side-by-side", "right-left", "top-bottom", "bottom-top", "tracks"] | None
    )
    track: int | None
    topics: str | Sequence[str] | None
    rig: str | Path | StereoRig | None
    camera: str | Sequence[str] | None
    focal_px: float | None
    known_distance: str | Sequence[str] | None
    fov_deg: float | None
    yaw_deg: float | None
    start: float | None
    start_s: float | None
    duration: float | None
    duration_s: float | None
    every: int | None
    realtime: bool | None
    fps: float | None
    bayer: Literal["rggb", "bggr", "gbrg", "grbg"] | None
    start_utc: str | None
    ego_speed: str | Path | float | None
    speed_channel: str | None
    dbc: str | Path | None
    truth: str | Path | None
    truth_calib: str | Path | None
    truth_poses: str | Path | None
    truth_ahead_m: float | None
    truth_offset_s: float | None
    detections: str | Path | None
    align: str | Path | None
    out: str | Path | None
    overwrite: bool | None
    write: str | Sequence[str] | None
    anonymize: bool | None
    mcap_profile: Literal["foxglove", "ros2"] | None
    mcap_images: bool | None
    table: str | Path | None
    keep_gps: bool | None
    overlay: bool | None
    clips: bool | None
    disparity: bool | None
    overlay_disparity: bool | None
    overlay_cuboids: bool | None
    overlay_recorded: bool | None
    progress: bool | Console
