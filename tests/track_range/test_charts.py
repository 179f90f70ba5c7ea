"""The charts: their lines, their edge cases, and that a page may hold many of them."""

from __future__ import annotations

import re
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import numpy.typing as npt
import pytest

from track_range.charts import (
    LINE_POINTS,
    METHOD_COLOURS,
    distance_chart,
    error_chart,
    inline_svg,
    median_by_distance,
    method_style,
    methods_measured,
    stage_chart,
)

Columns = dict[str, npt.NDArray[Any]]


def drive(n: int = 20, *, truth: bool = True) -> Columns:
    """One track that comes nearer, measured by three methods; sgbm never measures."""
    rng = np.random.default_rng(11)
    distance_m = np.linspace(60, 20, n)
    columns = {
        "frame": np.arange(float(n)),
        "time_s": np.arange(n) * 0.1,
        "track_id": np.ones(n),
        "class": np.full(n, "car"),
        "observed": np.ones(n),
        "mono_m": distance_m * (1 + 0.08 * rng.standard_normal(n)),
        "mono_sigma_m": distance_m * 0.08,
        "sgbm_m": np.full(n, np.nan),
        "fused_m": distance_m * 1.01,
        "fused_sigma_m": distance_m * 0.02,
        "fused_kf_m": distance_m,
        "x_m": np.zeros(n),
        "y_m": np.zeros(n),
    }
    return columns | ({"truth_m": distance_m} if truth else {})


def parsed(svg: str) -> ET.Element:
    """The element, read as strictly as XML asks, with the name space that a page declares by itself."""
    return ET.fromstring(f'<page xmlns:xlink="x">{svg}</page>')[0]  # noqa: S314 - our own text


def texts(svg: str) -> set[str]:
    return {"".join(element.itertext()).strip() for element in parsed(svg).iter("text")}


def test_methods_are_what_was_measured_in_the_columns_order() -> None:
    assert methods_measured(drive()) == ["mono", "fused", "fused_kf"]


def test_a_filtered_method_has_its_methods_colour_dashed() -> None:
    assert method_style("mono")["color"] == method_style("mono_kf")["color"] == METHOD_COLOURS["mono"]
    assert "linestyle" in method_style("mono_kf")
    assert "linestyle" not in method_style("mono")
    assert method_style("radar")["color"] not in METHOD_COLOURS.values()


def test_a_track_chart_names_its_methods_axes_and_truth() -> None:
    svg = distance_chart(drive(), 1)
    assert {"time, s", "distance, m", "mono", "fused", "fused_kf", "truth"} <= texts(svg)
    assert "sgbm" not in texts(svg)
    assert parsed(svg).get("aria-label") == "Distance over time of track 1"
    assert parsed(svg).get("viewBox")


def test_without_truth_no_truth_is_drawn_and_there_is_no_error_chart() -> None:
    assert "truth" not in texts(distance_chart(drive(truth=False), 1))
    assert error_chart(drive(truth=False)) is None
    nothing_true = drive() | {"truth_m": np.full(20, np.nan)}
    assert error_chart(nothing_true) is None


def test_predicted_boxes_are_ringed() -> None:
    columns = drive()
    columns["observed"][4:6] = 0
    assert "predicted box" in texts(distance_chart(columns, 1))
    columns["observed"][:] = 1
    assert "predicted box" not in texts(distance_chart(columns, 1))


def test_a_track_of_one_frame_is_a_point() -> None:
    points = [use.get("style", "") for use in parsed(distance_chart(drive(1), 1)).iter("use")]
    for method in ("mono", "fused"):
        assert any(METHOD_COLOURS[method] in style for style in points)


def test_a_track_that_nothing_measured_has_an_empty_chart() -> None:
    columns = {name: values for name, values in drive().items() if not name.endswith("_m")}
    assert "distance, m" in texts(distance_chart(columns, 1))


def test_a_long_track_is_thinned() -> None:
    n = 40 * LINE_POINTS
    assert len(distance_chart(drive(n), 1)) < 400_000


def test_medians_by_hand() -> None:
    distance_m = np.array([10.0, 15, 19.9, 21, 22, 35, 36, 37, np.nan])
    error_pct = np.array([1.0, 5, 2, 9, 9, -1, np.nan, -3, 4])
    middles_m, medians = median_by_distance(distance_m, error_pct)
    assert middles_m.tolist() == [15.0]
    assert medians.tolist() == [2.0]
    assert [len(part) for part in median_by_distance(distance_m[:0], error_pct[:0])] == [0, 0]


def test_a_truth_of_no_distance_has_no_relative_error() -> None:
    assert error_chart(drive() | {"truth_m": np.zeros(20)}) is None


def test_the_error_chart_names_the_methods_that_have_errors() -> None:
    svg = error_chart(drive())
    assert svg is not None
    assert {"mono", "fused", "true distance, m", "error, %"} <= texts(svg)
    assert "sgbm" not in texts(svg)


def test_a_wild_measurement_does_not_flatten_the_error_chart() -> None:
    columns = drive(100)
    columns["mono_m"][3] = 4000.0
    svg = error_chart(columns)
    assert svg is not None
    labels = [float(text.replace("\N{MINUS SIGN}", "-")) for text in texts(svg) if re.fullmatch(r"\W?\d+", text)]
    assert max(labels) <= 100


def test_many_points_become_one_picture() -> None:
    svg = error_chart(drive(5000))
    assert svg is not None
    assert "data:image/png;base64," in svg
    assert len(svg) < 500_000
    few = error_chart(drive(50))
    assert few is not None
    assert "data:image/png" not in few


def test_stages_that_did_not_run_have_no_bar() -> None:
    svg = stage_chart({"read": 2.0, "detect": 61.25, "lane": None, "sgbm": 0.0})
    assert svg is not None
    assert {"read", "detect", "61.2", "2.0", "ms per frame"} <= texts(svg)
    assert not {"lane", "sgbm"} & texts(svg)
    assert stage_chart({}) is None
    assert stage_chart({"lane": None}) is None


def test_charts_take_the_pages_ink_and_refer_to_nothing_outside() -> None:
    svg = distance_chart(drive(), 1)
    assert "currentColor" in svg
    assert "http" not in svg
    assert "#000000" not in svg
    assert all(target.startswith("#") for target in re.findall(r'xlink:href="([^"]*)"', svg))


def test_names_inside_two_charts_do_not_clash_and_the_same_chart_is_the_same_text() -> None:
    columns = drive()
    columns["track_id"] = np.repeat([1.0, 2.0], 10)
    first, second = (set(re.findall(r'id="([^"]*)"', distance_chart(columns, i))) for i in (1, 2))
    assert first
    assert second
    assert not first & second
    assert distance_chart(columns, 1) == distance_chart(columns, 1)


def test_a_title_is_escaped_and_a_foreign_svg_refused() -> None:
    svg = inline_svg(
        '<?xml version="1.0"?><svg width="1" viewBox="0 0 1 1"><style>*{}</style><g id="a"/></svg>', 'a "<b>'
    )
    assert svg == '<svg role="img" aria-label="a &quot;&lt;b&gt;" viewBox="0 0 1 1" stroke-linejoin="round"><g/></svg>'
    with pytest.raises(ValueError, match="an SVG without a viewBox"):
        inline_svg("<svg></svg>", "x")
