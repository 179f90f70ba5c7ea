"""`tr.Pipeline`: frames in memory give what a run of the same videos gives; bad frames change
nothing."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

import track_range as tr
from tests.track_range.run.process_state import assert_unchanged_by, process_state
from track_range.recording.sources.open_video import open_video
from track_range.recording.video.frame import VideoFrame
from track_range.simulation.drive import Drive

OPTIONS: dict[str, Any] = {"sgbm": False}


def images(drive: Drive) -> list[tuple[VideoFrame, VideoFrame]]:
    """The frames of both videos, as recorded."""
    return list(zip(open_video(drive.left), open_video(drive.right), strict=True))


def stepped(pipeline: Any, drive: Drive, **arguments: Any) -> Iterator[tr.FrameResult]:
    for left, right in images(drive):
        yield pipeline.step(left.image, right.image, left.time_s, **arguments)


def _without_telemetry(drive: Drive, folder: Path) -> Drive:
    """A copy of the videos and the rig of a drive; its file of speeds, which a run finds, is left
    out."""
    copies = {name: folder / getattr(drive, name).name for name in ("left", "right", "rig")}
    for name, path in copies.items():
        shutil.copy(getattr(drive, name), path)
    return replace(drive, **copies)


@pytest.fixture(scope="module")
def plain_drive(render_drive: Any, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """A drive of 0.7 s whose speed is not known."""
    return _without_telemetry(render_drive(seconds=0.7), tmp_path_factory.mktemp("drive"))


@pytest.fixture(scope="module")
def checked_drive(render_drive: Any, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """The same for 1.2 s: with as many pairs as the check of a pair needs."""
    return _without_telemetry(render_drive(), tmp_path_factory.mktemp("drive"))


@pytest.fixture(scope="module")
def long_drive(render_drive: Any, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """A drive of 4 s, long enough for an alignment."""
    return _without_telemetry(render_drive(seed=5, seconds=4.0), tmp_path_factory.mktemp("drive"))


@pytest.mark.slow
def test_rows_are_those_of_a_run_with_the_same_alignment(long_drive: Drive) -> None:
    with tr.Run.stereo(long_drive.left, long_drive.right, rig=long_drive.rig, **OPTIONS) as run:
        expected = [result.ranges["fused"].distance_m for result in run]
        table, events = run.to_arrow(), run.events
    with tr.Pipeline.stereo(long_drive.rig, align=run.alignment, **OPTIONS) as pipeline:
        results = list(stepped(pipeline, long_drive))
    assert table.num_rows > 20
    assert pipeline.to_arrow().equals(table)  # to the last digit of tracks.csv
    for result, distance_m in zip(results, expected, strict=True):
        np.testing.assert_array_equal(result.ranges["fused"].distance_m, distance_m)
    assert pipeline.events() == events


def test_mono_rows_are_those_of_a_run(plain_drive: Drive) -> None:
    options = {**OPTIONS, "camera_height_m": 1.65}
    run = tr.Run.mono(plain_drive.left, focal_px=360, **options)
    n_frames = len(list(run))
    with tr.Pipeline.mono(focal_px=360, **options) as pipeline:
        results = [pipeline.step(left.image, left.time_s) for left, _ in images(plain_drive)]
    assert len(results) == n_frames
    assert pipeline.to_arrow().equals(run.to_arrow())
    assert pipeline.alignment is None


def test_frozen_right_camera_has_no_stereo(checked_drive: Drive) -> None:
    pairs = images(checked_drive)
    with tr.Pipeline.stereo(checked_drive.rig, align="off", **OPTIONS) as pipeline:
        for i, (left, right) in enumerate(pairs):
            image = right.image if i < 6 else pairs[5][1].image
            result = pipeline.step(left.image, image, left.time_s)
            has_stereo = bool(np.isfinite(result.ranges["stereo"].distance_m).any())
            assert has_stereo == (i < 6)
            assert (result.frame.right is None) == (i >= 6)
    (note,) = [note for note in pipeline.notes if "repeats" in note]
    assert "The right video" in note
    assert f"{len(pairs) - 6} frames" in note


@pytest.mark.slow
def test_large_offset_is_corrected_during_the_drive(long_drive: Drive) -> None:
    errors = []
    with (
        tr.Pipeline.stereo(long_drive.rig, deterministic=True, **OPTIONS) as pipeline,
        tr.Pipeline.stereo(long_drive.rig, align="off", **OPTIONS) as reference,
    ):
        for left, right in images(long_drive):
            true_m = (
                reference.step(left.image, right.image, left.time_s).ranges["stereo"].distance_m
            )
            shifted = np.roll(right.image, 24, axis=1)  # disparities are 24 px too small
            result = pipeline.step(left.image, shifted, left.time_s)
            distance_m = result.ranges["stereo"].distance_m
            if pipeline.alignment is not None and len(distance_m) == len(true_m):
                errors.append(np.abs(distance_m / true_m - 1))
    assert any("px too small" in note and "corrected" in note for note in pipeline.notes)
    assert pipeline.alignment is not None
    assert pipeline.alignment.measured.offset_px == pytest.approx(24.0, abs=0.5)
    assert np.nanmedian(np.concatenate(errors[1:])) < 0.05


@pytest.mark.slow
def test_one_camera_twice_has_no_stereo(long_drive: Drive) -> None:
    with tr.Pipeline.stereo(long_drive.rig, deterministic=True, **OPTIONS) as pipeline:
        for left, _ in images(long_drive):
            result = pipeline.step(left.image, left.image.copy(), left.time_s)
    assert result.frame.right is None
    assert any("one camera" in note for note in pipeline.notes)


@pytest.mark.slow
def test_automatic_alignment_is_unknown_first_and_then_that_of_a_run(long_drive: Drive) -> None:
    with tr.Run.stereo(long_drive.left, long_drive.right, rig=long_drive.rig, **OPTIONS) as run:
        expected = list(run)
    known = []
    n_before, errors = [], []
    with tr.Pipeline.stereo(long_drive.rig, deterministic=True, **OPTIONS) as pipeline:
        for result, of_run in zip(stepped(pipeline, long_drive), expected, strict=True):
            known.append(pipeline.alignment is not None)
            stereo, reference = result.ranges["stereo"], of_run.ranges["stereo"]
            is_measured = np.isfinite(stereo.distance_m) & np.isfinite(reference.distance_m)
            if len(known) <= 6:  # the pair is not explained before its seventh frame in motion
                n_before.append(int(np.isfinite(stereo.distance_m).sum()))
            if len(known) > 1 and known[-2]:
                errors.extend(np.abs(stereo.distance_m / reference.distance_m - 1)[is_measured])
    assert known.index(True) >= 9  # ten frames in motion
    assert known[12:] == [True] * len(known[12:])
    # alignments that differ by hundredths of a pixel may decide between two surfaces of a box
    is_other_surface = np.array(errors) >= 0.03
    assert is_other_surface.sum() <= 1 < 0.01 * len(errors)
    assert n_before == [0] * 6
    assert pipeline.alignment is not None
    assert pipeline.alignment.measured.is_measured


@pytest.mark.slow
def test_an_alignment_is_used_once_it_is_known(long_drive: Drive) -> None:
    with tr.Pipeline.stereo(long_drive.rig, **OPTIONS) as pipeline:
        first = next(stepped(pipeline, long_drive))
        assert (pipeline.alignment, first.frame.right) == (None, None)
        for left, right in images(long_drive)[1:]:
            pipeline.step(left.image, right.image, left.time_s)
            time.sleep(0.1)
        for _ in range(600):
            if pipeline.alignment is not None and pipeline.alignment.measured.is_measured:
                break
            time.sleep(0.1)
        last = pipeline.step(left.image, right.image, left.time_s + 0.1)
        assert pipeline.notes
    assert last.frame.right is not None
    assert last.frame.alignment is not None
    assert last.frame.alignment.is_measured


def test_rigs_in_memory(plain_drive: Drive) -> None:
    rig = tr.load_rig(plain_drive.rig)
    run = tr.Run.stereo(plain_drive.left, plain_drive.right, rig=rig, align="off", **OPTIONS)
    n_frames = len(list(run))
    by_file = tr.Run.stereo(
        plain_drive.left,
        plain_drive.right,
        rig=plain_drive.rig,
        align="off",
        **OPTIONS,
    )
    assert len(list(by_file)) == n_frames
    assert run.to_arrow().equals(by_file.to_arrow())
    with tr.Pipeline.stereo(rig, align="off", **OPTIONS) as pipeline:
        assert len(list(stepped(pipeline, plain_drive))) == n_frames
    assert pipeline.to_arrow().equals(run.to_arrow())
    with tr.Pipeline.mono(rig=rig.left, **OPTIONS) as mono:
        left, _ = images(plain_drive)[0]
        assert mono.step(left.image, 0.0).index == 0


BAD_FRAMES = {
    "size": lambda left, right: (left[:100], right, 5.0),
    "right size": lambda left, right: (left, right[:, :100], 5.0),
    "type": lambda left, right: (left.astype(np.float32), right, 5.0),
    "channels": lambda left, right: (np.dstack([left, left])[:, :, :4], right, 5.0),
    "no image": lambda left, right: (None, right, 5.0),
    "same time": lambda left, right: (left, right, None),
    "time before": lambda left, right: (left, right, 0.05),
    "no time": lambda left, right: (left, right, math.nan),
}


def test_bad_frames_change_nothing(plain_drive: Drive) -> None:
    tables = []
    for bad in ((), BAD_FRAMES):
        with tr.Pipeline.stereo(plain_drive.rig, align="off", **OPTIONS) as pipeline:
            for left, right in images(plain_drive):
                pipeline.step(left.image, right.image, left.time_s)
                for name in bad if left.time_s > 0.05 else ():
                    one, other, time_s = BAD_FRAMES[name](left.image, right.image)
                    with pytest.raises(
                        tr.errors.FrameError, match=r"^(left|right|time_s): expected .*found"
                    ):
                        pipeline.step(one, other, left.time_s if time_s is None else time_s)
            tables.append(pipeline.to_arrow())
    assert tables[0].equals(tables[1])


def test_a_first_frame_that_does_not_fit_the_rig_is_refused(plain_drive: Drive) -> None:
    left, right = images(plain_drive)[0]
    with tr.Pipeline.stereo(plain_drive.rig, align="off", **OPTIONS) as pipeline:
        with pytest.raises(tr.errors.RigError):
            pipeline.step(left.image[:, :300].copy(), right.image[:, :300].copy(), 0.0)
        assert pipeline.step(left.image, right.image, 0.0).index == 0


def test_swapped_images_are_refused_every_time(checked_drive: Drive) -> None:
    """From the frame on with which it is known: seven pairs that show motion are enough, here in
    1.1 s."""
    with tr.Pipeline.stereo(
        checked_drive.rig, align="off", deterministic=True, **OPTIONS
    ) as pipeline:
        *first, last = images(checked_drive)
        for left, right in first:
            result = pipeline.step(right.image, left.image, left.time_s)
            # the first pair looks wrong
            assert not np.isfinite(result.ranges["stereo"].distance_m).any()
        n_rows = pipeline.to_arrow().num_rows
        left, right = last
        for later_s in (0.0, 0.1, 0.2):
            with pytest.raises(tr.errors.RigError, match="swap"):
                pipeline.step(right.image, left.image, left.time_s + later_s)
        assert pipeline.to_arrow().num_rows == n_rows


def test_a_closed_pipeline_takes_no_frame(plain_drive: Drive) -> None:
    left, right = images(plain_drive)[0]
    for n_before in (0, 1):
        pipeline = tr.Pipeline.stereo(plain_drive.rig, **OPTIONS)
        for index in range(n_before):
            pipeline.step(left.image, right.image, float(index))
        rows = pipeline.to_arrow()
        pipeline.close()
        pipeline.close()
        with pytest.raises(tr.errors.UsageError, match="closed"):
            pipeline.step(left.image, right.image, 9.0)
        assert pipeline.to_arrow().equals(rows)


def test_options_are_checked(plain_drive: Drive) -> None:
    with pytest.raises(tr.errors.ConfigError, match=r"lane_width_m: .*1\.5"):
        tr.Pipeline.stereo(plain_drive.rig, lane_width_m=0.1)
    with pytest.raises(tr.errors.ConfigError, match="unknown option"):
        tr.Pipeline.stereo(plain_drive.rig, out="here")  # type: ignore[call-arg]
    with pytest.raises(tr.errors.ConfigError, match="either focal_px or rig"):
        tr.Pipeline.mono(focal_px=360, rig=plain_drive.rig)
    with pytest.raises(tr.errors.ConfigError, match=r"focal_px: .*positive"):
        tr.Pipeline.mono(focal_px=-1)
    with pytest.raises(tr.errors.ConfigError, match=r"keep_s: .*positive"):
        tr.Pipeline.mono(focal_px=360, keep_s=0)
    for bad in ("360", True, np.inf):
        with pytest.raises(tr.errors.ConfigError, match=r"focal_px: .*positive"):
            tr.Pipeline.mono(focal_px=bad)
    for bad_rig in (5, [1]):
        with pytest.raises(tr.errors.ConfigError, match=r"rig: expected"):
            tr.Pipeline.mono(rig=bad_rig)
        with pytest.raises(tr.errors.ConfigError, match=r"rig: expected"):
            tr.Pipeline.stereo(bad_rig)
    with pytest.raises(tr.errors.ConfigError, match=r"align: expected"):
        tr.Pipeline.stereo(plain_drive.rig, align=5)
    with pytest.raises(tr.errors.RigError, match=r"missing\.yaml"):
        tr.Pipeline.stereo("missing.yaml")
    with pytest.raises(tr.errors.RigError, match=r"missing\.yaml"):
        tr.Pipeline.stereo(plain_drive.rig, align="missing.yaml")


def test_focal_length_that_was_not_given_has_a_wide_sigma(plain_drive: Drive) -> None:
    pairs = images(plain_drive)
    with (
        tr.Pipeline.mono(**OPTIONS) as unknown,
        tr.Pipeline.mono(focal_px=360, **OPTIONS) as given,
    ):
        for left, _ in pairs:
            wide = unknown.step(left.image, left.time_s)
            known = given.step(left.image, left.time_s)
    height_px, width_px = pairs[0][0].image.shape[:2]
    assert known.focal is None
    assert wide.focal is not None
    # the usual field of view of 75 degrees, across an image of 16:9 with the same diagonal
    usual_px = math.hypot(width_px, height_px) / math.hypot(16, 9) * 16
    half_px = usual_px / 2
    assert wide.focal.focal_px == pytest.approx(half_px / math.tan(math.radians(37.5)), rel=2e-3)
    assert (wide.focal.sigma, wide.focal.since_s) == (0.3, 0.0)
    assert "usual field of view" in wide.focal.sentence
    relative = np.nanmedian(wide.ranges["fused"].sigma_m / wide.ranges["fused"].distance_m)
    assert 0.3 < relative < 0.45
    assert any("estimated" in note for note in unknown.notes)


def test_pair_without_a_rig_needs_images_of_one_size(plain_drive: Drive) -> None:
    left, right = images(plain_drive)[0]
    with tr.Pipeline.stereo(**OPTIONS) as pipeline:
        with pytest.raises(tr.errors.RigError, match=r"rig: expected right images of"):
            pipeline.step(left.image, right.image[:-4], 0.0)
        result = pipeline.step(left.image, right.image, 0.0)
    assert result.focal is not None


def test_times_on_any_clock_and_grey_images(plain_drive: Drive) -> None:
    pairs = images(plain_drive)
    epoch_s = 1.8e9
    with tr.Pipeline.stereo(plain_drive.rig, align="off", **OPTIONS) as pipeline:
        grey = [np.asarray(left.image[:, :, 1]) for left, _ in pairs]
        results = [
            pipeline.step(image, right.image, epoch_s + left.time_s)
            for image, (left, right) in zip(grey, pairs, strict=True)
        ]
    assert [result.time_s for result in results] == pytest.approx(
        [left.time_s for left, _ in pairs], abs=1e-5
    )
    assert results[0].left.shape == pairs[0][0].image.shape


def test_numbers_of_numpy_and_names_of_arguments(plain_drive: Drive) -> None:
    left, _ = images(plain_drive)[0]
    with tr.Pipeline.mono(focal_px=np.float32(360), **OPTIONS) as pipeline:
        assert (
            pipeline.step(left.image, np.float64(0.0), ego_speed_mps=np.float32(10)).ego_mps == 10.0
        )
        # NaN: a speed that is not given is predicted for a moment
        assert pipeline.step(left.image, 0.1, ego_speed_mps=math.nan).ego_mps == 10.0
        for arguments, name in (
            ((None, 0.2), "image"),
            ((left.image, "0.2"), "time_s"),
            ((left.image, None), "time_s"),
        ):
            with pytest.raises(tr.errors.FrameError, match=f"^{name}: expected"):
                pipeline.step(*arguments)
        for speed in ("fast", math.inf, 1e9, -29.2):
            with pytest.raises(tr.errors.FrameError, match=r"^ego_speed_mps: expected"):
                pipeline.step(left.image, 0.2, ego_speed_mps=speed)
        assert pipeline.step(left.image, 0.2).index == 2


def test_ways_to_call_step(plain_drive: Drive) -> None:
    left, right = (frame.image for frame in images(plain_drive)[0])
    with tr.Pipeline.stereo(plain_drive.rig, align="off", **OPTIONS) as stereo:
        assert stereo.step(left, right, 0.0).index == 0
        assert stereo.step(left, right, time_s=0.1, ego_speed_mps=5.0).index == 1
        assert stereo.step(left=left, right=right, time_s=0.2).index == 2
        for arguments in ((left, 0.3), (left, None, 0.3)):
            with pytest.raises(tr.errors.FrameError, match=r"^right: expected an image"):
                stereo.step(*arguments)
        with pytest.raises(tr.errors.FrameError, match=r"^time_s: expected a time"):
            stereo.step(left, right)
    with tr.Pipeline.mono(focal_px=360, **OPTIONS) as mono:
        assert mono.step(left, 0.0).index == 0
        assert mono.step(left, time_s=0.1, ego_speed_mps=5.0).index == 1
        assert mono.step(image=left, time_s=0.2).index == 2
        assert mono.step(left, None, 0.3).index == 3
        for both in ((left, right, 0.4), (left, right)):
            with pytest.raises(tr.errors.FrameError, match=r"^right: expected one image.*two"):
                mono.step(*both)
        assert mono.step(left, 0.4).index == 4
    for former in ("StereoPipeline", "MonoPipeline"):
        with pytest.warns(DeprecationWarning, match=r"track_range\.Pipeline"):
            assert getattr(tr, former) is tr.Pipeline


def test_speed_of_each_step(plain_drive: Drive) -> None:
    with tr.Pipeline.stereo(plain_drive.rig, align="off", **OPTIONS) as pipeline:
        results = list(stepped(pipeline, plain_drive, ego_speed_mps=10.25))
    assert [result.ego_mps for result in results] == [10.25] * len(results)
    with tr.Pipeline.stereo(plain_drive.rig, align="off", **OPTIONS) as pipeline:
        measured = [result.ego_mps for result in stepped(pipeline, plain_drive)]
    assert np.isfinite(measured[2:]).all()
    assert 10.25 not in measured


def test_camera_that_looks_aside(plain_drive: Drive) -> None:
    """The speed of each step is that of the vehicle, and nothing warns."""
    mount = tr.Mounting(yaw_deg=-60.0)
    run = tr.Run.mono(plain_drive.left, focal_px=360, mount=mount, ego_speed=36, **OPTIONS)
    results = list(run)
    (note,) = [note for note in run.notes if "--mount" in note]
    assert "no collision warnings" in note
    assert (run.events, any(result.alarms.has_warnings for result in results)) == ((), False)
    with tr.Pipeline.mono(focal_px=360, mount="yaw=-60", **OPTIONS) as pipeline:
        left = images(plain_drive)[0][0]
        ego = pipeline.step(left.image, left.time_s, ego_speed_mps=10.0).ego
        assert note in pipeline.notes
    assert (ego.speed_mps, ego.right_mps) == pytest.approx((5.0, -8.66), abs=0.01)
    assert results[0].ego.speed_mps == pytest.approx(ego.speed_mps)
    with pytest.raises(tr.errors.ConfigError, match="mount: expected yaw"):
        tr.Pipeline.mono(focal_px=360, mount="yaw=300", **OPTIONS)


def test_a_speed_in_another_unit_is_doubted_and_not_used(render_drive: Any, tmp_path: Path) -> None:
    """36 km/h are 10 m/s, given as 36 m/s: the images show 10."""
    drive = _without_telemetry(render_drive(seconds=2.0), tmp_path)
    with tr.Pipeline.stereo(drive.rig, align="off", **OPTIONS) as pipeline:
        results = list(stepped(pipeline, drive, ego_speed_mps=36.0))
    doubt = results[-1].scale_doubt
    assert doubt is not None
    assert doubt.causes[0][0] == "speed"
    assert doubt.factor == pytest.approx(3.6, rel=0.1)
    assert results[-1].ego_mps == pytest.approx(10.0, rel=0.1)


def test_a_rig_in_memory_is_written_beside_the_results(plain_drive: Drive, tmp_path: Path) -> None:
    options = {**OPTIONS, "align": "off", "overlay": False, "duration": 0.6}
    video = tmp_path / "videos/left.mp4"
    video.parent.mkdir()
    shutil.copy(plain_drive.left, video)  # no rig.yaml lies beside the copy
    run = tr.Run.stereo(
        video,
        plain_drive.right,
        rig=tr.load_rig(plain_drive.rig),
        out=tmp_path / "out",
        **options,
    )
    list(run)
    assert tmp_path / "out/rig.yaml" in run.files
    settings = yaml.safe_load((tmp_path / "out/settings.yaml").read_text(encoding="utf-8"))["run"]
    assert settings["rig"] == str(tmp_path / "out/rig.yaml")
    again = tr.Run.stereo(video, plain_drive.right, rig=settings["rig"], **options)
    list(again)
    assert again.to_arrow().equals(run.to_arrow())


class Nothing:
    """A tracker that makes every detection a track."""

    def update(self, detections: Any, time_s: float, image: Any) -> tr.Tracks:
        n = len(detections)
        observed = np.ones(n, np.bool_)
        return tr.Tracks(
            np.arange(1, n + 1), detections.xyxy_px, detections.class_id, detections.score, observed
        )


class OneCar:
    """A detector that finds the same car in every image."""

    def detect(self, image: Any) -> tr.Detections:
        return tr.Detections.of([[280.0, 95.0, 340.0, 140.0]], [0.9], [2])


def test_rows_and_events_are_kept_for_a_time() -> None:
    image = np.zeros((188, 620, 3), np.uint8)
    options: dict[str, Any] = {"detector": OneCar(), "tracker": Nothing(), "lanes": "off"}
    with tr.Pipeline.mono(focal_px=360, keep_s=2.0, **options) as pipeline:
        for index in range(100):
            pipeline.step(image, index / 10)
        table = pipeline.to_arrow()
    assert table["time_s"].to_pylist() == pytest.approx(np.arange(79, 100) / 10)
    assert pipeline.events() == ()


@pytest.mark.parametrize("has_own_tracker", [False, True])
def test_another_scene_starts_again_but_for_a_tracker_object(has_own_tracker: bool) -> None:
    rng = np.random.default_rng(0)
    textures = rng.integers(0, 255, (2, 12, 40, 3), np.uint8)
    scenes = [cv2.resize(one, (620, 188), interpolation=cv2.INTER_CUBIC) for one in textures]
    options: dict[str, Any] = {"detector": OneCar(), "lanes": "off"}
    if has_own_tracker:
        options["tracker"] = Nothing()
    with tr.Pipeline.mono(focal_px=360, **options) as pipeline:
        ids = []
        for index in range(16):
            noise = rng.integers(0, 12, (188, 620, 3), np.uint8)
            result = pipeline.step(cv2.add(scenes[index // 8], noise), index / 10)
            ids.append(result.tracks.track_id.tolist())
        notes = [note for note in pipeline.notes if "another scene from 0.8 s on" in note]
    assert len(notes) == 1
    assert ids[:9] == [[1]] * 9
    second = {one for row in ids[9:] for one in row}
    if has_own_tracker:
        assert second == {1}
    else:
        assert second
        assert 1 not in second


def test_a_detector_that_fails_leaves_the_tracks_as_they_were(plain_drive: Drive) -> None:
    class Failing(OneCar):
        fails = False

        def detect(self, image: Any) -> Any:
            return None if self.fails else super().detect(image)

    detector = Failing()
    left, right = images(plain_drive)[0]
    with tr.Pipeline.stereo(
        plain_drive.rig, align="off", detector=detector, tracker=Nothing(), **OPTIONS
    ) as pipeline:
        pipeline.step(left.image, right.image, 0.0)
        detector.fails = True
        with pytest.raises(tr.errors.UserError, match=r"Failing.*Detections"):
            pipeline.step(left.image, right.image, 0.1)
        detector.fails = False
        assert pipeline.step(left.image, right.image, 0.1).index == 1


def test_nothing_in_the_process_changes(plain_drive: Drive) -> None:
    before = process_state()
    with tr.Pipeline.stereo(plain_drive.rig) as pipeline:
        assert process_state() == before
        assert_unchanged_by(stepped(pipeline, plain_drive))
    assert process_state() == before


@pytest.mark.slow
def test_alignment_files_and_objects(plain_drive: Drive, tmp_path: Path) -> None:
    file = tmp_path / "align.yaml"
    alignment = tr.load_alignment(_saved(file))
    sources: tuple[Any, ...] = (file, str(file), alignment)
    tables = []
    for align in sources:
        with tr.Pipeline.stereo(plain_drive.rig, align=align, **OPTIONS) as pipeline:
            list(stepped(pipeline, plain_drive))
        tables.append(pipeline.to_arrow())
        assert pipeline.alignment is not None
        assert pipeline.alignment.applied.offset_px == pytest.approx(0.4)
    run = tr.Run.stereo(
        plain_drive.left,
        plain_drive.right,
        rig=plain_drive.rig,
        align=file,
        **OPTIONS,
    )
    list(run)
    assert all(table.equals(run.to_arrow()) for table in tables)


def _saved(file: Path) -> Path:
    from track_range.stereo.alignment.file import save_alignment
    from track_range.stereo.geometry.alignment import Alignment

    save_alignment(
        Alignment(offset_px=0.4, residual_px=0.1, offset_sigma_px=0.05, source="a test"), file
    )
    return file
