"""Clips of one camera are estimated once: which clips, from which of them, and what is written."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from track_range.fleet.engine.cameras import (
    MOST_CLIPS,
    clips_by_camera,
    readable,
    with_cameras,
)
from track_range.fleet.engine.clip_run import clip_settings
from track_range.fleet.engine.plan import FleetPlan, fleet_plan
from track_range.fleet.inputs.clip import Clip, FleetInputError
from track_range.fleet.settings import FleetSettings
from track_range.foundation.errors import UserError
from track_range.stereo.rig_formats.reading import load_camera, read_calibration


@pytest.fixture
def clips(tmp_path):
    """Three clips of two vehicles, without files beside them."""
    vehicles = {"a": "van", "b": "bus", "c": "van"}
    return [
        Clip(name, str(tmp_path / f"{name}.mp4"), labels={"vehicle": vehicle})
        for name, vehicle in vehicles.items()
    ]


def plan_of(camera, out="out", *, is_dry=False, **options):
    settings = FleetSettings(recordings=("x",), out=str(out), camera=camera, dry_run=is_dry)
    return FleetPlan(settings=settings, options=options)


def names(of_camera):
    return {name: [clip.name for clip in clips] for name, clips in of_camera.items()}


def test_a_name_is_the_camera_of_all_clips_and_a_placeholder_that_of_each_vehicle(clips):
    assert names(clips_by_camera(clips, plan_of("dashcam"))) == {"dashcam": ["a", "b", "c"]}
    assert names(clips_by_camera(clips, plan_of("{vehicle}-front"))) == {
        "van-front": ["a", "c"],
        "bus-front": ["b"],
    }


def test_the_folder_of_a_clip_names_its_camera(tmp_path):
    clips = [
        Clip(f"{van}/{name}", str(tmp_path / van / f"{name}.mp4"))
        for van, name in (("van-1", "a"), ("van-1", "b"), ("van-2", "a"))
    ]
    assert names(clips_by_camera(clips, plan_of("{folder}"))) == {
        "van-1": ["van-1/a", "van-1/b"],
        "van-2": ["van-2/a"],
    }


def test_a_dry_run_names_the_cameras_and_counts_the_clips_that_can_be_opened(
    clips, tmp_path, film, capsys
):
    for name in ("a", "b"):
        film(tmp_path / f"{name}.mp4", [0, 0.1])
    (tmp_path / "c.mp4").write_bytes(b"no video")
    plan = plan_of("{vehicle}", tmp_path / "out", is_dry=True)
    assert with_cameras(clips, plan, Console(width=300)) == clips
    assert capsys.readouterr().out.splitlines() == [
        "Camera van: Not estimated yet. By 1 of 2 clips.",
        "Camera bus: Not estimated yet. By 1 of 1 clip.",
    ]
    assert not (tmp_path / "out").exists()


def test_folders_of_one_name_are_counted(tmp_path, film, capsys):
    clips = []
    for van in ("van-1", "van-2"):
        (tmp_path / van / "front").mkdir(parents=True)
        film(tmp_path / van / "front" / "a.mp4", [0, 0.1])
        clips.append(Clip(f"{van}/front/a", str(tmp_path / van / "front" / "a.mp4")))
    with_cameras(clips, plan_of("{folder}", tmp_path / "out", is_dry=True), Console(width=300))
    assert capsys.readouterr().out == (
        "Camera front: Not estimated yet. By 2 of 2 clips in 2 folders.\n"
    )


def test_clips_with_a_calibration_keep_it(clips, tmp_path):
    first, second, third = clips
    pair = replace(first, right=str(tmp_path / "right.mp4"))
    given = replace(second, settings={"focal_px": "900"})
    assert names(clips_by_camera([pair, given, third], plan_of("dashcam"))) == {"dashcam": ["c"]}
    with pytest.raises(FleetInputError, match="without a calibration, found none"):
        clips_by_camera(clips, plan_of("dashcam", focal_px=900))
    (tmp_path / "rig.yaml").write_text("")  # beside all videos
    with pytest.raises(FleetInputError, match="without a calibration, found none"):
        clips_by_camera(clips, plan_of("dashcam"))


def test_unknown_placeholders_are_named(clips):
    with pytest.raises(
        FleetInputError, match=r"--camera .*\{car\} is unknown; expected one of clip, folder, v"
    ):
        clips_by_camera(clips, plan_of("{car}"))


def test_many_clips_are_read_evenly(tmp_path, film):
    video = film(tmp_path / "0.mp4", [0, 0.1])
    clips = [Clip(str(k), str(video)) for k in range(3 * MOST_CLIPS)]
    assert [int(clip.name) for clip in readable(clips)] == list(range(0, 3 * MOST_CLIPS, 3))
    assert readable(clips[:2]) == clips[:2]


def test_remote_clips_are_refused(tmp_path):
    with pytest.raises(FleetInputError, match=r"s3://.*on this machine.*calibrate drive"):
        with_cameras(
            [Clip("a", "s3://bucket/a.mp4", settings={"ego_speed": "off"})],
            plan_of("dashcam", tmp_path),
            Console(quiet=True),
        )


def test_clips_that_cannot_be_opened_stay_for_the_run(clips, tmp_path):
    for clip in clips:
        (tmp_path / f"{clip.name}.mp4").write_bytes(b"no video")
    plan = plan_of("dashcam", tmp_path / "out")
    assert with_cameras(clips, plan, Console(quiet=True)) == clips


@pytest.mark.slow
def test_one_estimate_is_that_of_all_clips_and_stays(small_drive, tmp_path, capsys):
    recordings = tmp_path / "clips"
    recordings.mkdir()
    for name in ("a", "b"):
        shutil.copy(small_drive.left, recordings / f"{name}.mp4")
    clips = [Clip(name, str(recordings / f"{name}.mp4")) for name in ("a", "b")]
    (recordings / "damaged.mp4").write_bytes(b"no video")
    clips.append(Clip("damaged", str(recordings / "damaged.mp4")))
    plan, console = plan_of("dash cam", tmp_path / "out"), Console(width=300)
    result = with_cameras(clips, plan, console)
    rig = tmp_path / "out" / "cameras" / "dash%20cam.yaml"
    assert [clip.settings["rig"] for clip in result] == [str(rig)] * 3
    printed = capsys.readouterr().out
    assert printed.startswith("Camera dash cam: Focal length ")
    assert "By 2 of 3 clips." in printed
    camera, _ = load_camera(rig, size_px=None)
    evidence = json.loads(rig.with_suffix(".json").read_text())
    assert camera.fx_px == pytest.approx(evidence["focal_px"])
    assert evidence["source"] == "a.mp4 b.mp4"
    road = read_calibration(rig, is_grey=False, is_pair=False).road
    assert 0.0 < road.focal_sigma < 0.4
    written_ns = rig.stat().st_mtime_ns
    assert with_cameras(clips, plan, console) == result
    assert rig.stat().st_mtime_ns == written_ns
    # a further clip is further evidence
    shutil.copy(small_drive.right, recordings / "c.mp4")
    more = [*clips, Clip("c", str(recordings / "c.mp4"))]
    with_cameras(more, plan, console)
    assert rig.stat().st_mtime_ns > written_ns


@pytest.mark.slow
def test_an_estimate_is_of_the_present_files_and_options(small_drive, tmp_path):
    video, out = tmp_path / "a.mp4", tmp_path / "out"
    shutil.copy(small_drive.left, video)
    clips, console = [Clip("a", str(video))], Console(quiet=True)
    settings = FleetSettings(recordings=(str(video),), out=str(out), camera="dashcam")

    def estimated(**options):
        """When the calibration was written."""
        (with_rig,) = with_cameras(clips, fleet_plan(settings, options), console)
        return Path(with_rig.settings["rig"]).stat().st_mtime_ns

    first_ns = estimated()
    assert estimated() == first_ns
    with_option_ns = estimated(min_score="0.4")
    assert with_option_ns > first_ns
    shutil.copy(small_drive.right, video)
    assert estimated(min_score="0.4") > with_option_ns
    dry = fleet_plan(settings.model_copy(update={"dry_run": True}), {"min_score": "0.4"})
    assert "rig" in with_cameras(clips, dry, console)[0].settings
    dry = fleet_plan(settings.model_copy(update={"dry_run": True}), {})
    assert with_cameras(clips, dry, console) == clips


@pytest.mark.slow
def test_the_lens_is_evidence_of_the_estimate_and_no_option_of_its_clips(small_drive, tmp_path):
    shutil.copy(small_drive.left, tmp_path / "a.mp4")
    settings = FleetSettings(recordings=("x",), out=str(tmp_path / "out"), camera="dashcam")

    def focal_px(own, **options):
        clips = [Clip("a", str(tmp_path / "a.mp4"), settings=own)]
        plan = fleet_plan(settings, options)
        (clip,) = with_cameras(clips, plan, Console(quiet=True))
        assert clip_settings(plan.options, clip).lens_fov_deg is None
        return load_camera(Path(clip.settings["rig"]), size_px=None)[0].fx_px

    narrow_px = focal_px({}, lens_fov_deg="40h")
    assert focal_px({}, lens_fov_deg="110h") < 0.9 * narrow_px
    assert focal_px({"lens_fov_deg": "40h"}) == pytest.approx(narrow_px)


def test_clips_of_a_camera_have_one_lens(clips, tmp_path, film):
    for clip in clips:
        film(Path(clip.left), [0, 0.1])
    clips[1] = replace(clips[1], settings={"lens_fov_deg": "140d"})
    with pytest.raises(FleetInputError, match="one lens_fov_deg"):
        with_cameras(clips, plan_of("dashcam", tmp_path / "out"), Console(quiet=True))


@pytest.mark.slow
def test_boxes_of_the_estimate_are_those_of_the_detector_options(small_drive, tmp_path):
    shutil.copy(small_drive.left, tmp_path / "a.mp4")
    clips = [Clip("a", str(tmp_path / "a.mp4"))]
    with pytest.raises(UserError, match="--min-score"):
        with_cameras(clips, plan_of("dashcam", tmp_path, min_score="2"), Console(quiet=True))
