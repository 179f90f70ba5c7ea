"""`Pipeline.state`, `restore`, `reset` and `health`: what a program asks beside the frames."""

import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

import track_range as tr
from track_range.pipeline.state import dumped, loaded
from track_range.recording.sources.open_video import open_video
from track_range.simulation.drive import Drive

OPTIONS: dict[str, Any] = {"sgbm": False, "deterministic": True}
N_FRAMES, AT = 10, 4


@pytest.fixture(scope="module")
def drive(render_drive: Any) -> Drive:
    return render_drive(seconds=1.0)


def images(drive: Drive) -> list[tuple[Any, ...]]:
    """Images of both cameras."""
    videos = open_video(drive.left), open_video(drive.right)
    return [tuple(one.image for one in pair) for pair in zip(*videos, strict=True)][:N_FRAMES]


def stereo(drive: Drive, **options: Any) -> tuple[Callable[[], Any], Callable[..., Any]]:
    """A pair with the packaged detector, the dense stereo and an alignment of its own."""
    return lambda: tr.Pipeline.stereo(drive.rig, **{**OPTIONS, **options}), _step_pair


def mono(drive: Drive) -> tuple[Callable[[], Any], Callable[..., Any]]:
    """One camera without a calibration."""
    return lambda: tr.Pipeline.mono(**OPTIONS), _step_one


def _step_pair(pipeline: Any, pair: Any, time_s: float) -> tr.FrameResult:
    return pipeline.step(*pair, time_s)


def _step_one(pipeline: Any, pair: Any, time_s: float) -> tr.FrameResult:
    return pipeline.step(pair[0], time_s)


def assert_same(found: tr.FrameResult, wanted: tr.FrameResult) -> None:
    assert (found.index, found.time_s) == (wanted.index, wanted.time_s)
    np.testing.assert_array_equal(found.tracks.xyxy_px, wanted.tracks.xyxy_px)
    np.testing.assert_array_equal(found.tracks.track_id, wanted.tracks.track_id)
    assert found.ranges.keys() == wanted.ranges.keys()
    for name in wanted.ranges:
        for part in ("distance_m", "sigma_m"):
            values = getattr(found.ranges[name], part), getattr(wanted.ranges[name], part)
            np.testing.assert_array_equal(*values)
    np.testing.assert_array_equal(found.warnings.probability, wanted.warnings.probability)
    np.testing.assert_array_equal(found.world.placement.age_s, wanted.world.placement.age_s)
    assert repr(found.ego) == repr(wanted.ego)


@pytest.mark.slow
@pytest.mark.parametrize("make", [mono, stereo, lambda drive: stereo(drive, sgbm=True)])
def test_a_restored_pipeline_goes_on_like_the_one_that_was_not_interrupted(
    drive: Drive, make: Any
) -> None:
    opened, step = make(drive)
    pairs = images(drive)
    with opened() as whole:
        wanted = [step(whole, pair, 0.1 * k) for k, pair in enumerate(pairs[: AT + 1])]
        state = pickle.loads(pickle.dumps(whole.state()))  # noqa: S301 - our own
        wanted += [step(whole, pair, 0.1 * k) for k, pair in enumerate(pairs) if k > AT]
        table, notes = whole.to_arrow(), whole.notes
    assert state.n_frames == AT + 1
    with tr.Pipeline.restore(state) as again:
        for k in range(AT + 1, len(pairs)):
            assert_same(step(again, pairs[k], 0.1 * k), wanted[k])
        assert again.to_arrow().equals(table)  # also the rows from before
        assert again.notes == notes
        again.reset()
        for k, pair in enumerate(pairs):  # as a new pipeline, at times before
            assert_same(step(again, pair, 0.1 * k), wanted[k])


class OneCar:
    """A detector that sees a car at the same place."""

    def detect(self, image: Any) -> tr.Detections:
        return tr.Detections.of([(280.0, 170.0, 360.0, 230.0)], [0.9], [tr.class_id("car")])


def noise(seed: int) -> Any:
    return np.random.default_rng(seed).integers(0, 256, (360, 640, 3), np.uint8)


def test_states_that_cannot_be_restored_are_named() -> None:
    with tr.Pipeline.mono(focal_px=500, detector=OneCar(), **OPTIONS) as pipeline:
        pipeline.step(noise(0), 0.0)
        state = pipeline.state()
    assert "1 frames" in repr(state)
    with pytest.raises(tr.errors.StateError, match=r"expected a PipelineState.*found dict"):
        tr.Pipeline.restore({})  # type: ignore[arg-type]
    other = replace(state, made_by="0.1.0")
    with pytest.raises(tr.errors.StateError, match=r"one of track-range .*found one of 0\.1\.0"):
        tr.Pipeline.restore(other)
    earlier = replace(state, version=1)
    with pytest.raises(tr.errors.StateError, match=r"format 2\), found one of .*\(format 1"):
        tr.Pipeline.restore(earlier)
    with pytest.raises(tr.errors.StateError, match=r"^detector: expected the detector object"):
        tr.Pipeline.restore(state)
    with pytest.raises(tr.errors.StateError, match="found other bytes"):
        tr.Pipeline.restore(replace(state, content=b"x"), detector=OneCar())
    with tr.Pipeline.restore(state, detector=OneCar()) as again:
        assert again.step(noise(1), 0.1).index == 1
        with pytest.raises(tr.errors.FrameError, match=r"0\.1 s, the time of the last frame"):
            again.step(noise(1), 0.1)
    with pytest.raises(tr.errors.UsageError, match="closed"):
        again.state()


@pytest.mark.slow
def test_objects_of_the_second_process_are_part_of_a_state(drive: Drive) -> None:
    """Without `deterministic`, the alignment is estimated in another process, which each of both
    pipelines has."""
    pairs = images(drive)
    options = {**OPTIONS, "deterministic": False, "detector": OneCar()}
    with tr.Pipeline.stereo(drive.rig, **options) as pipeline:
        for k in range(4):
            pipeline.step(*pairs[k], 0.1 * k)
        state = pickle.loads(pickle.dumps(pipeline.state()))  # noqa: S301 - our own
        with tr.Pipeline.restore(state, detector=OneCar()) as again:
            for k in range(4, len(pairs)):
                result, other = (one.step(*pairs[k], 0.1 * k) for one in (pipeline, again))
                np.testing.assert_array_equal(result.tracks.xyxy_px, other.tracks.xyxy_px)
            again.reset()
            assert again.step(*pairs[0], 0.0).index == 0


def test_a_state_before_the_first_frame() -> None:
    with tr.Pipeline.mono(focal_px=500, detector=OneCar(), **OPTIONS) as pipeline:
        state = pipeline.state()
    with tr.Pipeline.restore(state, detector=OneCar()) as again:
        assert again.step(noise(1), 7.0).time_s == 0.0


def test_parts_that_cannot_be_pickled_are_named() -> None:
    with pytest.raises(tr.errors.StateError, match=r"cannot.*lambda"):
        dumped({"part": lambda: 0}, {})
    shared = object()
    assert loaded(dumped([shared, 1], {"it": shared}), {"it": "other"}) == ["other", 1]
    matcher = cv2.StereoBM.create(48, 9)
    matcher.setTextureThreshold(7)
    again = loaded(dumped(matcher, {}), {})
    values = again.getNumDisparities(), again.getBlockSize(), again.getTextureThreshold()
    assert values == (48, 9, 7)


def test_nanoseconds_are_exact_and_increase() -> None:
    start_ns = 1_700_000_000_000_000_001
    with tr.Pipeline.mono(focal_px=500, detector=OneCar(), **OPTIONS) as pipeline:
        assert pipeline.step(noise(0), time_ns=start_ns).time_s == 0.0
        step_ns = 50_000_001
        assert pipeline.step(noise(1), time_ns=start_ns + step_ns).time_s == step_ns / 1e9
        after = rf"^time_ns: expected whole nanoseconds after {start_ns + step_ns} ns"
        for time_ns in (start_ns + step_ns, start_ns, 1.5, True):
            with pytest.raises(tr.errors.FrameError, match=after):
                pipeline.step(noise(2), time_ns=time_ns)
        with pytest.raises(tr.errors.FrameError, match="either time_s or time_ns, found both"):
            pipeline.step(noise(2), 3.0, time_ns=start_ns + 2 * step_ns)
        result = pipeline.step(noise(2), time_ns=np.int64(start_ns + 2 * step_ns))
        assert result.time_s == pytest.approx(0.100000002, abs=1e-15)


def test_health_has_codes_since_when_and_the_sentences_of_the_notes() -> None:
    with tr.Pipeline.mono(focal_px=500, detector=OneCar(), mount="yaw=90", **OPTIONS) as pipeline:
        assert pipeline.health.severity == "ok"
        for k in range(6):
            pipeline.step(noise(k), 6.0 * k if k > 2 else 0.1 * k)
        health = pipeline.health
    by_code = {item.code: item for item in health.items}
    assert [item.sentence for item in health.items] == list(pipeline.notes)
    assert by_code["view-not-ahead"].severity == "warning"
    assert by_code["view-not-ahead"].sensor == "left"
    assert by_code["view-not-ahead"].since_s == 0.0
    late = by_code["times-not-in-seconds"]
    assert (late.severity, late.sensor, late.since_s) == ("error", "pipeline", 30.0)
    assert health.severity == health.of("pipeline") == "error"
    assert health.of("speed") == "ok"
    assert health.sensors["left"] == "warning"
    assert health.codes >= {"view-not-ahead", "times-not-in-seconds"}


def test_health_says_that_a_pipeline_cannot_see_and_that_it_sees_again() -> None:
    options = {**OPTIONS, "detector": OneCar(), "focal_px": 500}
    patches = np.kron(noise(1)[::40, ::40], np.ones((40, 40, 1), np.uint8))
    day = (patches // 2 + noise(2) // 4).astype(np.uint8)
    with tr.Pipeline.mono(**options) as pipeline:
        for k in range(10):
            pipeline.step(day // 20, 0.1 * k)
        (low,) = (item for item in pipeline.health.items if item.code == "low-visibility")
        assert (low.severity, low.sensor, low.since_s) == ("warning", "left", 0.0)
        assert "100 % of the latest frames" in low.sentence
        for k in range(10, 110):
            pipeline.step(day, 0.1 * k)
        assert "low-visibility" not in pipeline.health.codes


def test_a_dark_right_camera_is_an_error_of_the_right_camera(drive: Drive) -> None:
    pairs = images(drive)
    with tr.Pipeline.stereo(drive.rig, align="off", detector=OneCar(), **OPTIONS) as pipeline:
        for k, (left, right) in enumerate(pairs):
            pipeline.step(left, right * (k < 5), 0.1 * k)
        health = pipeline.health
    (dark,) = (item for item in health.items if item.code == "images-dark")
    assert (dark.severity, dark.sensor) == ("error", "right")
    assert "right" in dark.sentence
    assert health.of("left") == "ok"


def test_the_gap_is_from_the_bumper_of_the_mounting() -> None:
    mount = tr.Mounting(x_m=1.2, z_m=1.4, front_m=2.9)
    options = {**OPTIONS, "detector": OneCar()}
    with (
        tr.Pipeline.mono(focal_px=500, mount=mount, **options) as pipeline,
        tr.Pipeline.mono(
            focal_px=500, mount=mount, warning_options={"front_m": 1.0}, **options
        ) as given,
    ):
        for k in range(4):
            result, other = (one.step(noise(k), 0.1 * k) for one in (pipeline, given))
    (t,), (of_given,) = result.objects, other.objects
    assert t.gap_m == pytest.approx(t.filtered_m - 1.7)
    assert of_given.gap_m == pytest.approx(t.filtered_m - 1.0)
    x_m, _, z_m = t.in_camera.position_m
    assert z_m == t.filtered_m
    assert t.in_vehicle.position_m[0] == pytest.approx(z_m + 1.2)
    assert t.in_vehicle.position_m[1] == pytest.approx(-x_m)
    assert t.size_m[0] > t.size_m[1] > t.size_m[2] > 1.0
    assert (t.score, t.unobserved_s) == (pytest.approx(0.9), 0.0)
