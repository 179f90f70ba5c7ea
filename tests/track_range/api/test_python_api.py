"""The Python API: `import track_range as tr`."""

import csv
import doctest
import json
import re
import subprocess
import sys
from contextlib import closing
from itertools import islice
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import track_range as tr
from track_range.stereo.alignment.file import save_alignment
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.rig_formats.rig_yaml import save_rig

PROJECT = Path(__file__).resolve().parents[3]


def recorded(drive, **options):
    return tr.Run.stereo(
        drive.left, drive.right, detections=drive.detections, overlay=False, align="off", **options
    )


@pytest.fixture(scope="module")
def finished(small_drive, tmp_path_factory):
    """A run that was iterated to its end and wrote its files, and its frames."""
    out = tmp_path_factory.mktemp("results")
    run = recorded(small_drive, out=out, truth=small_drive.truth)
    return run, list(run), out


def test_every_public_name_is_importable():
    assert len(tr.__all__) == len(set(tr.__all__))
    for name in tr.__all__:
        assert getattr(tr, name) is not None
    assert set(tr.__all__) <= set(dir(tr))
    with pytest.raises(AttributeError, match="Detecter"):
        _ = tr.Detecter
    for module in (tr.errors, tr.evaluate):
        assert set(module.__all__) <= set(dir(module))
        assert all(callable(getattr(module, name)) for name in module.__all__)


@pytest.mark.parametrize(
    ("former", "present"),
    [
        ("UserError", "errors.UserError"),
        ("RigError", "errors.RigError"),
        ("evaluate_tracks", "evaluate.tracks"),
        ("evaluate_detections_by_size", "evaluate.detections_by_size"),
        ("ImageTruth", "evaluate.ImageTruth"),
        ("MonoPipeline", "Pipeline"),
    ],
)
def test_former_names_warn_of_their_end(former, present):
    with pytest.warns(DeprecationWarning, match=rf"\btrack_range\.{present}\b") as warned:
        value = getattr(tr, former)
    assert value is attrgetter(present)(tr)
    assert warned[0].filename == __file__
    assert former not in dir(tr)


def test_import_loads_no_library():
    code = (
        "import sys, track_range; print({'numpy', 'cv2', 'pydantic', 'rich', 'onnxruntime'} & "
        "set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_frames_carry_tracks_and_ranges(finished):
    _, frames, _ = finished
    assert [frame.index for frame in frames] == list(range(len(frames)))
    last = frames[-1]
    assert len(last.tracks) > 0
    assert {"mono", "stereo", "fused", "fused_kf"} <= set(last.ranges)
    assert last.ranges["fused"].track_id.tolist() == last.tracks.track_id.tolist()
    assert np.isfinite(last.ranges["fused"].distance_m).any()


def test_table_equals_tracks_csv(finished):
    run, frames, out = finished
    table = run.to_arrow()
    with (out / "tracks.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert table.column_names == list(rows[0])
    assert table.num_rows == len(rows) == sum(len(frame.tracks) for frame in frames)
    for name in ("frame", "track_id", "fused_m", "fused_sigma_m", "closing_mps"):
        written = [float(row[name]) if row[name] else None for row in rows]
        assert table[name].to_pylist() == written


def test_summary_equals_summary_json(finished):
    run, frames, out = finished
    assert run.summary == json.loads((out / "summary.json").read_text())
    assert run.summary["frames"] == len(frames)
    assert "Closest approaches" in run._repr_html_() or "closest approaches" in run._repr_html_()


def test_pandas_frame(finished):
    pytest.importorskip("pandas")
    run, _, _ = finished
    assert run.to_pandas()["fused_m"].notna().any()


def test_run_without_out_writes_nothing(small_drive, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = recorded(small_drive, duration=0.3)
    assert sum(1 for _ in run) > 0
    assert list(tmp_path.iterdir()) == []
    assert run.to_arrow().num_rows > 0


def test_run_is_iterated_once(small_drive):
    run = recorded(small_drive, duration=0.3)
    with pytest.raises(RuntimeError, match="finished"):
        _ = run.summary
    n_frames = sum(1 for _ in run)
    with pytest.raises(RuntimeError, match="iterated"):
        iter(run)
    assert run.summary["frames"] == n_frames


def test_leaving_the_loop_keeps_the_rows(small_drive, tmp_path):
    run = recorded(small_drive, out=tmp_path / "out")
    for frame in run:
        if frame.index == 2:
            break
    assert run.summary["frames"] == 3
    assert set(run.to_arrow()["frame"].to_pylist()) <= {0, 1, 2}
    assert (tmp_path / "out" / "summary.json").exists()
    assert any("early" in note for note in run.notes)


def test_write_processes_all_frames(small_drive, tmp_path):
    folder = recorded(small_drive, duration=0.3).write(tmp_path / "out")
    assert {"tracks.csv", "mot.txt", "summary.json", "report.html", "settings.yaml"} <= {
        p.name for p in folder.iterdir()
    }


@pytest.mark.slow
def test_write_after_iteration_gives_the_same_rows(small_drive, tmp_path):
    first = recorded(small_drive, duration=0.5)
    first.write(tmp_path / "while")
    second = recorded(small_drive, duration=0.5)
    for _ in second:
        pass
    second.write(tmp_path / "after")
    assert (tmp_path / "after" / "tracks.csv").read_bytes() == (
        tmp_path / "while" / "tracks.csv"
    ).read_bytes()
    after, during = (
        np.loadtxt(tmp_path / name / "mot.txt", delimiter=",", ndmin=2)
        for name in ("after", "while")
    )
    assert after == pytest.approx(during, abs=0.0101)  # rounded twice
    assert second.summary["files"] == {}


def test_closed_run_is_not_iterated(small_drive):
    run = recorded(small_drive)
    run.open()
    run.close()
    with pytest.raises(RuntimeError, match="closed"):
        iter(run)


def test_second_write_keeps_the_videos(small_drive, tmp_path):
    run = tr.Run.mono(
        small_drive.left,
        focal_px=700,
        detections=small_drive.detections,
        duration=0.3,
        out=tmp_path / "out",
    )
    for _ in run:
        pass
    assert (tmp_path / "out" / "overlay.mp4").exists()
    run.write(tmp_path / "out")
    assert (tmp_path / "out" / "overlay.mp4").exists()


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"allign": "off"}, "did you mean align"),
        ({"duration": -1}, "duration"),
        ({"rig": "rig.yaml", "focal_px": 700}, "focal"),
        ({"tracker": "nosuch"}, "tracker"),
    ],
)
def test_wrong_options(small_drive, options, word):
    with pytest.raises(tr.errors.ConfigError, match=word):
        recorded(small_drive, **options)


def test_missing_video(tmp_path):
    run = tr.Run.mono(tmp_path / "none.mp4", focal_px=700)
    with pytest.raises(tr.errors.VideoError, match=r"none\.mp4"):
        run.open()


def test_own_detector_and_tracker_objects(small_drive):
    seen = []

    class MiddleBox:
        def detect(self, image):
            height, width = image.shape[:2]
            return tr.Detections.of(
                [[width / 2 - 40, height / 2 - 10, width / 2 + 40, height / 2 + 40]], [0.9], [2]
            )

    class OneIdentity:
        def update(self, detections, time_s, image):
            seen.append(time_s)
            n = len(detections)
            observed = np.ones(n, np.bool_)
            return tr.Tracks(
                np.arange(n, dtype=np.int64) + 41,
                detections.xyxy_px,
                detections.class_id,
                detections.score,
                observed,
            )

    run = tr.Run.mono(
        small_drive.left, focal_px=700, detector=MiddleBox(), tracker=OneIdentity(), duration=0.3
    )
    frames = list(run)
    assert len(seen) == len(frames) > 0
    assert all(frame.tracks.track_id.tolist() == [41] for frame in frames)
    assert run.summary["inputs"]["detector"].endswith("MiddleBox")
    with pytest.raises(tr.errors.ConfigError, match="both"):
        recorded(small_drive, detector=MiddleBox())


def test_own_detector_with_invalid_boxes(small_drive):
    class Percent:
        def detect(self, image):
            return tr.Detections.of([[10, 10, 60, 60]], [90], [2])

    run = tr.Run.mono(small_drive.left, focal_px=700, detector=Percent(), duration=0.3)
    with pytest.raises(
        tr.errors.UserError, match=r"Percent, frame 0: ValueError: score: .*got 90\.0"
    ):
        list(run)


def test_parts_range_a_pair(small_drive):
    run = recorded(small_drive, duration=0.2)
    frame = next(iter(run))
    run.close()
    assert run.rig is not None
    by_size = tr.SizeRanger(run.camera).measure(frame.tracks, frame.frame)
    # in a run, the search of boxes starts from the sizes
    by_stereo = tr.StereoRanger(run.rig).measure_with(frame.tracks, frame.frame, {"mono": by_size})
    assert by_stereo.distance_m == pytest.approx(
        frame.ranges["stereo"].distance_m, rel=0.05, nan_ok=True
    )
    assert by_size.distance_m == pytest.approx(frame.ranges["mono"].distance_m, nan_ok=True)


def test_documented_parts_give_the_distances_of_a_run(shared_data, tmp_path, monkeypatch, capsys):
    """KITTI's drive 0005, whose rig has an error of 0.6 px: 12 % of a distance of 30 m without the
    alignment."""
    pair = [shared_data / "kitti_stereo" / "0005" / f"{side}.mp4" for side in ("left", "right")]
    for video in pair:
        (tmp_path / video.name).symlink_to(video)
    save_rig(tr.load_rig(pair[0].parent / "calib.txt", size_px=(1242, 375)), tmp_path / "rig.yaml")
    monkeypatch.chdir(tmp_path)
    text = (PROJECT / "docs/reference/api/parts.md").read_text(encoding="utf-8")
    code = next(
        block
        for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL)
        if "tr.StereoRanger(" in block
    )
    n_frames = 6
    code = code.replace(
        "in recording.frames:", f"in __import__('itertools').islice(recording.frames, {n_frames}):"
    )
    names: dict = {}
    exec(code, names)  # noqa: S102  # the documented program
    assert capsys.readouterr().out
    with closing(tr.Run.stereo(*pair, rig="rig.yaml", overlay=False)) as run:
        expected = list(islice(run, n_frames))[-1].ranges["stereo"]
    distance_m = dict(zip(names["ranges"].track_id, names["ranges"].distance_m, strict=True))
    both = [
        (distance_m[n], d)
        for n, d in zip(expected.track_id, expected.distance_m, strict=True)
        if n in distance_m
    ]
    measured_m, run_m = np.array([pair for pair in both if np.isfinite(pair).all()]).T
    assert run_m.size >= 2
    assert measured_m == pytest.approx(run_m, rel=0.01)
    unaligned = tr.StereoRanger(names["recording"].rig, alignment=Alignment())
    far_m = unaligned.measure(names["tracks"], names["frame"]).distance_m
    assert np.nanmax(np.abs(far_m / names["ranges"].distance_m - 1)) > 0.05


def test_rig_files(small_drive, tmp_path):
    rig = tr.load_rig(small_drive.rig)
    assert rig.baseline_m == pytest.approx(0.54, abs=0.2)
    assert rig.left.width_px > 0
    (tmp_path / "calib.txt").write_text(
        "P2: 700 0 320 0 0 700 180 0 0 0 1 0\nP3: 700 0 320 -378 0 700 180 0 0 0 1 0\n"
    )
    with pytest.raises(tr.errors.RigError, match="size_px"):
        tr.load_rig(tmp_path / "calib.txt")
    assert tr.load_rig(tmp_path / "calib.txt", size_px=(640, 360)).baseline_m == pytest.approx(0.54)


def test_supervision_like_boxes_reach_the_tracker():
    tracker = tr.Tracker("sort")
    boxes = SimpleNamespace(
        xyxy=np.array([[100, 50, 180, 110]]),
        confidence=np.array([0.9]),
        class_id=np.array([2]),
        tracker_id=None,
        data={},
    )
    for index in range(5):
        tracks = tracker.update(tr.Detections.from_supervision(boxes), time_s=0.1 * index)
    assert tracks.to_supervision().tracker_id.tolist() == [1]


def test_evaluations_take_options_by_name(small_drive, tmp_path):
    figures = tr.evaluate.stereo(small_drive.left.parent, matchers=("sgbm",))
    assert figures["matchers"]["sgbm"]["median_relative_error_pct"] < 15
    with pytest.raises(tr.errors.UserError, match="matcher"):
        tr.evaluate.stereo(small_drive.left.parent, matcher="patch")


def test_tracks_measured_against_themselves(tmp_path):
    rows = [
        f"{frame},{track},{10 * track + frame},20,30,60,1,-1,-1,-1"
        for frame in range(1, 9)
        for track in (1, 2)
    ]
    for name in ("truth", "results"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.txt").write_text("\n".join(rows) + "\n")
    figures = tr.evaluate.tracks(tmp_path / "truth", tmp_path / "results", truth_format="mot")
    assert figures["combined"]["hota"] == pytest.approx(100)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        *(
            "Run",
            "Detections",
            "Tracks",
            "Ranges",
            "PinholeCamera",
            "StereoRig",
            "Detector",
            "Tracker",
            "SizeRanger",
        ),
        *(
            "StereoRanger",
            "Fusion",
            "DistanceFilters",
            "Rectifier",
            "load_rig",
            "evaluate.stereo",
            "open_recording",
        ),
        "load_alignment",
        *(
            "FrameResult",
            "class_id",
            "LateralFilters",
            "CollisionWarning",
            "WarningSettings",
            "Warnings",
            "RoadPlane",
        ),
    ],
)
def test_docstring_example(small_drive, tmp_path, monkeypatch, name):
    for file in ("left.mp4", "right.mp4", "rig.yaml"):
        (tmp_path / file).symlink_to(small_drive.left.parent / file)
    save_alignment(Alignment(offset_px=0.4), tmp_path / "align.yaml")
    (tmp_path / "dashcam.mp4").symlink_to(small_drive.left)
    (tmp_path / "drive").symlink_to(small_drive.left.parent)
    monkeypatch.chdir(tmp_path)
    examples = doctest.DocTestFinder(recurse=False).find(
        attrgetter(name)(tr), name, module=False, globs={}
    )
    results = [doctest.DocTestRunner().run(example) for example in examples]
    assert sum(result.attempted for result in results) >= 2
    assert sum(result.failed for result in results) == 0


@pytest.mark.parametrize(
    ("option", "value", "found"),
    [
        ("detector", np.zeros((2, 6)), "ndarray"),
        ("detector", len, "builtin_function_or_method"),
        ("detector", tr.Overlay, "the class Overlay"),
        ("tracker", 3, "int"),
        ("rig", {"fx": 1}, "dict"),
    ],
)
def test_objects_of_other_kinds_are_refused(option, value, found):
    with pytest.raises(tr.errors.ConfigError, match=rf"^{option}: .*{found}\.$"):
        tr.Run.mono("a.mp4", **{option: value})
