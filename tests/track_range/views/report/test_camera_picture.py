"""The picture of an estimated camera: curves inside its borders, and round numbers at its axis."""

import numpy as np
import pytest

from tests.track_range.views.report.report_rows import columns, summary
from track_range.recording.cameras.camera_estimate import CameraEstimate, source_of_guess
from track_range.results.summary_shape import valid_summary
from track_range.stereo.geometry.focal_guess import FocalGuess
from track_range.views.report.content.camera import camera_picture
from track_range.views.report.page import report_page


def estimated():
    guesses = [("usual", 834.0, 0.3), ("motion", 1000.0, 0.01)]
    sources = tuple(
        source_of_guess(FocalGuess(px, sigma, f"<{kind}>"), kind, (1280, 720))
        for kind, px, sigma in guesses
    )
    return CameraEstimate(size_px=(1280, 720), sources=sources)


def places(curve):
    return np.array([pair.split(",") for pair in curve["points"].split()], float)


def test_joint_curve_is_where_the_motion_is():
    picture = camera_picture({"camera_estimate": estimated().summary()})
    usual, motion = map(places, picture["curves"])
    joint = places(picture["all"])
    ticks = {tick["text"]: tick["x"] for tick in picture["ticks"]}
    assert "1,000" in ticks
    for curve in (motion, joint):
        assert curve[np.argmin(curve[:, 1]), 0] == pytest.approx(ticks["1,000"], abs=8)
    assert usual[np.argmin(usual[:, 1]), 0] < ticks["1,000"] - 30
    every = np.concatenate([usual, motion, joint])
    assert every[:, 0].min() >= 0
    assert every[:, 0].max() <= picture["width"]
    assert every[:, 1].min() >= 0
    assert every[:, 1].max() <= picture["bottom"] + 0.1


def test_report_shows_it_without_markup_of_the_sources():
    page = report_page(
        summary(calibration="estimated", camera_estimate=estimated().summary()), columns(4)
    )
    assert 'class="all"' in page
    assert "&lt;motion&gt;" in page
    assert "<motion>" not in page
    assert 'class="all"' not in report_page(summary(calibration="estimated"), columns(4))


def test_damaged_estimates_are_omitted():
    whole = estimated().summary()
    assert valid_summary({"camera_estimate": whole})[1] == []
    valid, invalid = valid_summary({"camera_estimate": {**whole, "density": "x"}})
    assert "camera_estimate.density" in invalid
    assert camera_picture(valid) is None
    assert camera_picture({"camera_estimate": {**whole, "curve_px": [700.0]}}) is None
