"""Positions and courses for the bird's-eye view, by hand: a camera with f = 1000 px and cx = 600
px."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from track_range.results.rows.rows import Rows
from track_range.views.report.content.road import camera_of_rows, road_columns
from track_range.views.report.content.series import MAX_BINS, timeline

F_PX, CX_PX = 1000.0, 600.0


def rows(z_m: Any, x_m: Any, *, width_m: float = 1.8, **more: Any) -> Rows:
    """Rows of a track at 10 Hz; the closing speed is that of z."""
    z, x = np.asarray(z_m, np.float64), np.asarray(x_m, np.float64)
    n = len(z)
    u_px, half_px = CX_PX + F_PX * x / z, F_PX * width_m / z / 2
    closing_mps = -np.gradient(z) * 10
    columns = {
        "frame": np.arange(float(n)),
        "time_s": np.arange(n) / 10,
        "track_id": np.ones(n),
        "class": np.full(n, "car"),
        "observed": np.ones(n),
        "x1_px": u_px - half_px,
        "y1_px": np.full(n, 100.0),
        "x2_px": u_px + half_px,
        "y2_px": np.full(n, 200.0),
        "fused_m": z,
        "fused_kf_m": z,
        "x_m": x,
        "ttc_s": np.where(closing_mps > 0, z / np.where(closing_mps > 0, closing_mps, 1), np.nan),
        **more,
    }
    return Rows(columns)


def test_camera_from_rows() -> None:
    camera = camera_of_rows(rows(np.linspace(40, 20, 20), np.linspace(-3, 3, 20)))
    assert camera is not None
    assert (camera.fx_px, camera.cx_px) == (pytest.approx(F_PX), pytest.approx(CX_PX))
    assert camera.width_px == 2 * CX_PX


def test_no_camera_without_positions() -> None:
    known = rows(np.linspace(40, 20, 20), np.linspace(-3, 3, 20))
    assert camera_of_rows(known.with_columns({"x_m": np.full(20, np.nan)})) is None
    others = {name: values for name, values in known.columns.items() if name != "x_m"}
    assert camera_of_rows(Rows(others)) is None
    assert road_columns(known.select(slice(0))) == {}
    noise_m = np.random.default_rng(0).normal(0, 5, 20)
    assert camera_of_rows(known.with_columns({"x_m": noise_m})) is None  # not of one camera


def test_constant_bearing_is_collision_course() -> None:
    z_m = 40.0 - np.arange(30)  # 10 m/s
    road = road_columns(rows(z_m, 0.05 * z_m + 1e-3 * np.arange(30)))
    assert np.isnan(road["passing"][:3]).all()  # too few positions
    assert road["passing"][-1] == pytest.approx(0.03, abs=0.2)
    assert 0 < road["passing_sigma"][-1] < 1


def test_parallel_lane_is_no_collision_course() -> None:
    z_m = 40.0 - np.arange(30)
    columns = rows(z_m, np.full(30, -3.5))
    road = road_columns(columns)
    assert road["passing"][-1] == pytest.approx(-3.5, abs=0.01)
    assert road["box_width"] == pytest.approx(1.8)


def test_crossing_object() -> None:
    z_m, x_m = 30.0 - 1.0 * np.arange(20), -4.0 + 0.1 * np.arange(20)  # 10 and 1 m/s
    passing = road_columns(rows(z_m, x_m))["passing"]
    assert passing[-1] == pytest.approx(-2.1 + 1.1, abs=0.02)


def test_offsets_of_the_warning_are_used() -> None:
    """A vehicle ahead in a bend stays in the ego path, although it moves to the right of the
    camera's axis."""
    z_m = 40.0 - np.arange(30)
    columns = rows(
        z_m,
        0.004 * z_m**2 / 2,
        path_offset_m=np.where(np.arange(30) < 5, np.nan, 0.01 * np.arange(30)),
    )
    passing = road_columns(columns)["passing"]
    assert np.isnan(passing[:8]).all()
    assert passing[-1] == pytest.approx(0.29 + 0.1 * columns["ttc_s"][-1], abs=0.01)


def test_predicted_boxes_are_no_positions() -> None:
    z_m = 40.0 - np.arange(30)
    observed = np.r_[np.ones(10), np.zeros(20)]
    passing = road_columns(rows(z_m, np.linspace(-3, 3, 30), observed=observed))["passing"]
    assert np.isfinite(passing[9])
    assert np.isnan(passing[25:]).all()


def test_timeline_counts_road_users() -> None:
    columns = {
        "time_s": np.array([0.0, 0.0, 0.0, 0.1, 0.3]),
        "frame": np.array([0.0, 0.0, 0.0, 1.0, 3.0]),
    }
    columns["class"] = np.array(["car", "person", "traffic light", "car", "car"])
    data = timeline(Rows(columns), {"frames": 5})
    assert (data["from_s"], data["to_s"]) == (0.0, 0.5)
    assert data["n"] == "2,-1,-1,1,-1"
    assert "ego" not in data


def test_timeline_without_a_track_has_the_time_of_the_run() -> None:
    """221 frames at 25 frames per second."""
    data = timeline(Rows(), {"frames": 221, "events": {"hours": 8.84 / 3600}})
    assert data["to_s"] - data["from_s"] == pytest.approx(8.84)
    assert data["frame_s"] == pytest.approx(0.04)


def test_timeline_of_each_third_frame() -> None:
    columns = {
        "time_s": np.array([0.0, 0.3, 0.9]),
        "frame": np.array([0.0, 3.0, 9.0]),
        "class": np.full(3, "car"),
    }
    data = timeline(Rows(columns), {"frames": 5, "settings": {"every": 3}})
    assert (data["frame_s"], data["to_s"], data["n"]) == (0.3, 1.5, "1,0,-1,1,-1")


def test_timeline_with_ego_speed() -> None:
    columns = {
        "time_s": np.arange(3) / 10,
        "frame": np.arange(3.0),
        "ego_mps": np.array([10.0, np.nan, 12.0]),
    }
    columns["class"] = np.full(3, "car")
    assert timeline(Rows(columns), {})["ego"] == "100,,20"


def test_timeline_without_rows() -> None:
    data = timeline(
        Rows({"time_s": np.zeros(0), "frame": np.zeros(0), "class": np.zeros(0, np.str_)}),
        {"frames": 20, "starts_s": 3.0},
    )
    assert (data["from_s"], data["to_s"]) == (3.0, 5.0)


def test_timeline_of_a_long_run() -> None:
    columns = {"time_s": np.arange(36_000) / 10, "frame": np.arange(36_000.0)}
    columns["class"] = np.full(36_000, "car")
    assert len(timeline(Rows(columns), {})["n"].split(",")) == MAX_BINS
