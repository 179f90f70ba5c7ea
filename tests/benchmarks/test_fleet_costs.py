"""Arithmetic of the time and cost of a fleet, and the tables in the documentation."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.fleet.costs import (
    ASSUMED,
    BEGIN,
    END,
    INPUTS,
    bottleneck,
    cost,
    cost_tables,
    inputs_in,
    replace_tables,
    times_s,
)

PAGE = Path(__file__).resolve().parents[2] / "docs/how-to/fleet.md"

MEASURED = {
    "stereo_ms": 100.0,
    "mono_ms": 50.0,
    "overhead_s": 0.6,
    "start_s": 20.0,
    "driver_clips_per_s": 100.0,
    "stereo_mb_per_s": 2.0,
    "mono_mb_per_s": 1.0,
    "gpu_mono_ms": 2.0,
}


@pytest.fixture
def inputs():
    return {**ASSUMED, **MEASURED}


def test_times_by_hand(inputs):
    """1000 h in 60,000 clips of 600 frames: 3,600,000 s of one core, and 36,000 s of overhead."""
    parts = times_s(inputs, 10, "stereo")
    assert parts["compute"] == pytest.approx(3_636_000 / 160)
    assert parts["storage"] == pytest.approx(7_200_000 / 12_500)
    assert parts["driver"] == pytest.approx(600)
    assert parts["ends"] == pytest.approx(20 + 60)
    assert parts["total"] == pytest.approx(3_636_000 / 160 + 80)
    assert cost(inputs, 10, 3600) == pytest.approx(160 * inputs["price_per_core_h"])


@pytest.mark.parametrize(("nodes", "part"), [(1, "compute"), (10, "compute"), (1000, "driver")])
def test_bottleneck(inputs, nodes, part):
    assert bottleneck(times_s(inputs, nodes, "stereo")) == part


def test_storage_is_the_bottleneck(inputs):
    parts = times_s({**inputs, "storage_mb_per_s": 100.0}, 100, "mono")
    assert bottleneck(parts) == "storage"
    assert parts["storage"] == pytest.approx(36_000)


def test_tables_are_replaced(inputs, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    replace_tables(page, inputs)
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    assert inputs_in(text) == pytest.approx(inputs)


def test_documented_tables_are_consistent():
    """The results in the documentation are those of the inputs in its table."""
    text = PAGE.read_text(encoding="utf-8")
    shown = text.partition(BEGIN)[2].partition(END)[0].strip()
    inputs = inputs_in(shown)
    assert {name for name, _, _ in INPUTS} <= inputs.keys()
    assert shown == cost_tables(inputs)


def test_gpus(inputs):
    """36,000,000 frames at 2 ms and 36,000 s of overhead, on 10 GPUs."""
    parts = times_s(inputs, 10, "mono", has_gpu=True)
    assert parts["compute"] == pytest.approx((72_000 + 36_000) / 10)
    assert cost(inputs, 10, 3600, has_gpu=True) == pytest.approx(10 * inputs["price_per_gpu_h"])
    assert cost_tables(inputs).count("one, GPU") == 4
    del inputs["gpu_mono_ms"]
    assert "GPU" not in cost_tables(inputs)
