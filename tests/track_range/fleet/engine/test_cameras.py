"""Clips of one camera are estimated once: which clips, from which of them, and what is written."""

import json
import shutil
from dataclasses import replace

import pytest
from rich.console import Console

from track_range.fleet.engine.cameras import (
    MOST_CLIPS,
    camera_lines,
    chosen,
    clips_by_camera,
    with_cameras,
)
from track_range.fleet.inputs.clip import Clip, FleetInputError
from track_range.fleet.storage.location import Location
from track_range.stereo.rig_formats.reading import load_camera, read_calibration


@pytest.fixture
def clips(tmp_path):
    """Three clips of two vehicles, without files beside them."""
    vehicles = {"a": "van", "b": "bus", "c": "van"}
    return [
        Clip(name, str(tmp_path / f"{name}.mp4"), labels={"vehicle": vehicle})
        for name, vehicle in vehicles.items()
    ]


def names(of_camera):
    return {name: [clip.name for clip in clips] for name, clips in of_camera.items()}


def test_a_name_is_the_camera_of_all_clips_and_a_placeholder_that_of_each_vehicle(clips):
    assert names(clips_by_camera(clips, "dashcam")) == {"dashcam": ["a", "b", "c"]}
    assert names(clips_by_camera(clips, "{vehicle}-front")) == {
        "van-front": ["a", "c"],
        "bus-front": ["b"],
    }


def test_a_dry_run_names_the_cameras(clips):
    assert camera_lines(clips, "{vehicle}") == [
        "Camera van: estimated once, from 2 of 2 clips",
        "Camera bus: estimated once, from 1 of 1 clip",
    ]


def test_clips_with_a_calibration_keep_it(clips, tmp_path):
    first, second, third = clips
    pair = replace(first, right=str(tmp_path / "right.mp4"))
    given = replace(second, settings={"focal_px": "900"})
    assert names(clips_by_camera([pair, given, third], "dashcam")) == {"dashcam": ["c"]}
    (tmp_path / "rig.yaml").write_text("")  # beside all videos
    with pytest.raises(FleetInputError, match="without a calibration, found none"):
        clips_by_camera(clips, "dashcam")


def test_unknown_placeholders_are_named(clips):
    with pytest.raises(
        FleetInputError, match=r"--camera .*\{car\} is unknown; expected one of clip, v"
    ):
        clips_by_camera(clips, "{car}")


def test_many_clips_are_read_evenly():
    clips = [Clip(str(k), f"/{k}.mp4") for k in range(3 * MOST_CLIPS)]
    assert [int(clip.name) for clip in chosen(clips)] == list(range(0, 3 * MOST_CLIPS, 3))
    assert chosen(clips[:2]) == clips[:2]


def test_remote_clips_are_refused(tmp_path):
    with pytest.raises(FleetInputError, match=r"s3://.*on this machine.*calibrate drive"):
        with_cameras(
            [Clip("a", "s3://bucket/a.mp4", settings={"ego_speed": "off"})],
            "dashcam",
            Location.of(str(tmp_path)),
            {},
            Console(quiet=True),
        )


def test_clips_that_cannot_be_opened_stay_for_the_run(clips, tmp_path):
    for clip in clips:
        (tmp_path / f"{clip.name}.mp4").write_bytes(b"no video")
    out = Location.of(str(tmp_path / "out"))
    assert with_cameras(clips, "dashcam", out, {}, Console(quiet=True)) == clips


@pytest.mark.slow
def test_one_estimate_is_that_of_all_clips_and_stays(small_drive, tmp_path, capsys):
    recordings = tmp_path / "clips"
    recordings.mkdir()
    for name in ("a", "b"):
        shutil.copy(small_drive.left, recordings / f"{name}.mp4")
    clips = [Clip(name, str(recordings / f"{name}.mp4")) for name in ("a", "b")]
    (recordings / "damaged.mp4").write_bytes(b"no video")
    clips.append(Clip("damaged", str(recordings / "damaged.mp4")))
    out, console = Location.of(str(tmp_path / "out")), Console(width=300)
    result = with_cameras(clips, "dash cam", out, {}, console)
    rig = tmp_path / "out" / "cameras" / "dash%20cam.yaml"
    assert [clip.settings["rig"] for clip in result] == [str(rig)] * 3
    printed = capsys.readouterr().out
    assert printed.startswith("Camera dash cam: Focal length ")
    assert "By 2 of 3 clips." in printed
    camera, _ = load_camera(rig, size_px=None)
    evidence = json.loads(rig.with_suffix(".json").read_text())
    assert camera.fx_px == pytest.approx(evidence["focal_px"])
    assert evidence["source"] == "a.mp4 b.mp4"
    mounting = read_calibration(rig, is_grey=False, is_pair=False).mounting
    assert 0.0 < mounting.focal_sigma < 0.4
    written_ns = rig.stat().st_mtime_ns
    assert with_cameras(clips, "dash cam", out, {}, console) == result
    assert rig.stat().st_mtime_ns == written_ns
    # a further clip is further evidence
    shutil.copy(small_drive.right, recordings / "c.mp4")
    more = [*clips, Clip("c", str(recordings / "c.mp4"))]
    with_cameras(more, "dash cam", out, {}, console)
    assert rig.stat().st_mtime_ns > written_ns
