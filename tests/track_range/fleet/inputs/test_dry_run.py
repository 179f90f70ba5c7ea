"""Dry run: the headers of the clips of a fleet."""

from dataclasses import replace

import pytest

from track_range.fleet.engine.clip_run import clip_settings
from track_range.fleet.inputs.clip import Clip
from track_range.fleet.inputs.dry_run import check_clips

CALIBRATION = "P0: 50 0 32 0 0 50 24 0 0 0 1 0\nP1: 50 0 32 -27 0 50 24 0 0 0 1 0\n"


@pytest.fixture
def pair(tmp_path, film):
    """A pair of videos of 1 s with their calibration."""
    for side in ("left", "right"):
        film(tmp_path / f"{side}.mp4", [n / 10 for n in range(10)])
    (tmp_path / "calib.txt").write_text(CALIBRATION)
    return Clip("a", str(tmp_path / "left.mp4"), str(tmp_path / "right.mp4"))


def check(*clips, **options):
    return list(check_clips(clips, **options))


def test_properties_of_a_pair(pair):
    (checked,) = check(pair)
    assert checked.problems == checked.notes == ()
    assert (checked.size_px, checked.calibration) == ((64, 48), "file")
    assert checked.fps == pytest.approx(10)
    assert checked.duration_s == pytest.approx(1, abs=0.11)
    assert checked.n_bytes > 500


def test_problems_are_those_of_their_clips(pair, tmp_path, film):
    (tmp_path / "text.mp4").write_text("no video")
    (tmp_path / "empty.mp4").touch()
    clips = [
        pair,
        replace(pair, left=str(tmp_path / "text.mp4")),
        replace(pair, left=str(tmp_path / "empty.mp4")),
        replace(pair, right=str(tmp_path / "none.mp4")),
        replace(pair, settings={"rig": str(tmp_path / "none.yaml")}),
        replace(pair, settings={"rig": str(tmp_path / "left.mp4")}),
        replace(pair, settings={"truth": str(tmp_path / "none.csv")}),
        replace(pair, problem="half of a pair."),
    ]
    words = ["", "text.mp4", "empty", "none.mp4", "none.yaml", "left.mp4", "none.csv", "half"]
    for checked, word in zip(check(*clips), words, strict=True):
        assert bool(checked.problems) == bool(word)
        assert word in " ".join(checked.problems)


def test_sizes_that_differ(pair, tmp_path, film, level):
    film(tmp_path / "wide.mp4", [0, 0.1], images=[level(n, width_px=128) for n in range(2)])
    (checked,) = check(replace(pair, right=str(tmp_path / "wide.mp4")))
    assert "128x48" in checked.problems[0]


def test_calibration_of_one_camera(pair, tmp_path, film):
    (tmp_path / "alone").mkdir()
    clip = Clip("b", str(film(tmp_path / "alone" / "b.mp4", [0, 0.1])))
    (checked,) = check(clip)
    assert (checked.calibration, checked.problems) == ("none", ())
    assert "the focal length is estimated" in checked.notes[0]
    (checked,) = check(clip, has_camera=True)
    assert (checked.calibration, checked.notes) == ("camera", ())
    assert check(clip, focal_px=50)[0].calibration == "focal length"
    assert check(replace(clip, settings={"focal_px": "50"}))[0].calibration == "focal length"
    assert check(replace(clip, settings={"rig": str(tmp_path / "calib.txt")}))[0].problems == ()


def test_folder_of_images(tmp_path, level):
    import cv2

    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number:06d}.png"), level(number))
    (checked,) = check(Clip("a", str(tmp_path)), focal_px=50, fps=5)
    assert (checked.size_px, checked.fps, checked.problems) == ((64, 48), 5, ())
    assert checked.duration_s == pytest.approx(0.6)


def test_remote_clips_are_not_opened(bucket):
    bucket.child("a.mp4").write_bytes(b"abc")
    present, missing = check(*(Clip(name, bucket.child(f"{name}.mp4").address) for name in "ab"))
    assert (present.n_bytes, present.problems) == (3, ())
    assert "not opened" in present.notes[0]
    assert "b.mp4" in missing.problems[0]


def test_order_of_many_clips(tmp_path):
    clips = [Clip(str(n), str(tmp_path / f"{n}.mp4")) for n in range(600)]
    assert [checked.clip for checked in check_clips(clips)] == clips


def test_two_cameras_in_one_video(tmp_path, film, level):
    film(tmp_path / "both.mp4", [0, 0.1], images=[level(n, width_px=128) for n in range(2)])
    (tmp_path / "calib.txt").write_text(CALIBRATION)
    clip = Clip("a", str(tmp_path / "both.mp4"))
    (checked,) = check(clip, stereo_layout="side-by-side")
    assert (checked.size_px, checked.calibration, checked.problems) == ((64, 48), "file", ())
    (own,) = check(
        replace(clip, settings={"stereo_layout": "top-bottom"}), stereo_layout="side-by-side"
    )
    assert own.size_px == (128, 24)
    assert check(clip)[0].size_px == (128, 48)
    settings = clip_settings({"stereo_layout": "side-by-side"}, clip)
    assert (settings.stereo, settings.mono) == ((tmp_path / "both.mp4",) * 2, None)
