"""Invalid input on the command line: one sentence, status 1, no traceback."""

import shutil
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest
import yaml

TRACK_RANGE = Path(sys.executable).with_name("track-range")


@pytest.fixture
def fails(tmp_path, cli):
    """Runs a command that must fail; returns its error message."""

    def run(*arguments, status=1):
        done = cli(*arguments, "--out", tmp_path / "out")
        assert done.status == status, done.stderr
        assert "Traceback" not in done.stderr
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        assert len(lines) == 1, done.stderr
        assert lines[0].startswith("track-range: ")
        return lines[0]

    return run


@pytest.fixture
def succeeds(tmp_path, cli):
    """Runs a command that must succeed; returns its output in one line."""

    def run(*arguments):
        done = cli(*arguments, "--out", tmp_path / "out")
        assert done.status == 0, done.stderr
        return " ".join(done.stdout.split())

    return run


@pytest.fixture
def options(small_drive):
    """`options(right=..., rig=...)`: arguments of a valid run, with some replaced."""

    def arguments(**changed):
        files = {
            "left": small_drive.left,
            "right": small_drive.right,
            "rig": small_drive.rig,
            "detections": small_drive.detections,
        } | changed
        rest = [
            part
            for key in files
            if key not in ("left", "right")
            for part in (f"--{key}", files[key])
        ]
        return [
            "--stereo",
            files["left"],
            files["right"],
            *rest,
            "--no-sgbm",
            "--no-overlay",
            "--lanes",
            "off",
            "--align",
            "off",
        ]

    return arguments


def junk(path, content):
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (None, "no such"),
        (b"", "empty"),
        (b"this is no video at all " * 50, "video"),
        ("half", "index"),
    ],
    ids=["missing", "empty", "text", "truncated"],
)
def test_videos(fails, options, small_drive, tmp_path, content, word):
    video = tmp_path / "v.mp4"
    if content == "half":
        # moov at the end, as cameras write it, so half a file cannot be opened
        remuxed = tmp_path / "plain.mp4"
        with av.open(str(small_drive.left)) as source, av.open(str(remuxed), "w") as target:
            stream = target.add_stream_from_template(source.streams.video[0])
            for packet in source.demux(video=0):
                if packet.dts is not None:
                    packet.stream = stream
                    target.mux(packet)
        content = remuxed.read_bytes()[: remuxed.stat().st_size // 2]
    if content is not None:
        junk(video, content)
    sentence = fails(*options(left=video))
    assert str(video) in sentence
    assert word in sentence


@pytest.mark.slow
def test_truncated_video(render_drive, succeeds, tmp_path):
    long = render_drive(seed=3, seconds=1.6)  # a fragment per second: the second one is cut
    right = junk(
        tmp_path / "cut.mp4", long.right.read_bytes()[: int(long.right.stat().st_size * 0.9)]
    )
    files = ("--stereo", long.left, right, "--rig", long.rig, "--detections", long.detections)
    assert "right video ends" in succeeds(
        *files, "--no-sgbm", "--no-overlay", "--lanes", "off", "--align", "off"
    )
    frames = {
        int(row.split(",")[0]) for row in (tmp_path / "out/tracks.csv").read_text().splitlines()[1:]
    }
    assert 9 <= max(frames) < 14


def test_empty_folder(fails, options, tmp_path):
    (tmp_path / "images").mkdir()
    assert "images" in fails(*options(left=tmp_path / "images"))


def changed_rig(drive, path, **changes):
    rig = yaml.safe_load(drive.rig.read_text())
    for key, value in changes.items():
        if key == "x_m":
            rig["right_from_left"]["translation_m"][0] = value
        else:
            rig["left"][key] = rig["right"][key] = value
    path.write_text(yaml.safe_dump(rig))
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "messages"),
    [
        ({"x_m": 0.0}, ["baseline", "0"]),
        ({"x_m": 0.54}, ["baseline", "-0.54"]),
        ({"x_m": -540.0}, ["baseline", "540", "millimetres"]),
        ({"width_px": 640, "height_px": 480}, ["640x480", "620x188"]),
        ({"fx_px": -700.0}, ["fx", "-700"]),
        ({"fx_px": "wide"}, ["fx"]),
        ({"focus": 3}, ["focus"]),
    ],
    ids=["zero", "negative", "millimetres", "size", "focal", "word", "unknown"],
)
def test_rigs(fails, options, small_drive, tmp_path, changes, messages):
    sentence = fails(*options(rig=changed_rig(small_drive, tmp_path / "rig.yaml", **changes)))
    assert all(message in sentence for message in messages), sentence


def test_invalid_rig_files(fails, options, tmp_path):
    assert "none.yaml" in fails(*options(rig=tmp_path / "none.yaml"))
    assert "r.yaml" in fails(*options(rig=junk(tmp_path / "r.yaml", b"\x00\x01\xff")))
    assert "r.yaml" in fails(*options(rig=junk(tmp_path / "r.yaml", b"hello: world")))
    kitti = "P2: 700 0 10 0 0 700 170 0 0 0 1 0\nP3: 700 0 10 -380 0 700 170 0 0 0 1 0\n"
    assert "middle third" in fails(*options(rig=junk(tmp_path / "calib.txt", kitti.encode())))


def test_rig_of_twice_the_image_size_is_scaled(succeeds, options, small_drive, tmp_path):
    rig = yaml.safe_load(small_drive.rig.read_text())
    for side in ("left", "right"):
        rig[side] = {k: v if k == "distortion" else 2 * v for k, v in rig[side].items()}
    big = junk(tmp_path / "big.yaml", yaml.safe_dump(rig).encode())
    assert "scaled" in succeeds(*options(rig=big))
    detected = yaml.safe_load((tmp_path / "out/settings.yaml").read_text())["found"]
    assert detected["focal_px"] == pytest.approx(
        yaml.safe_load(small_drive.rig.read_text())["left"]["fx_px"], rel=1e-3
    )


def test_swapped_videos(fails, options, small_drive):
    assert "swapped" in fails(*options(left=small_drive.right, right=small_drive.left))


@pytest.mark.slow
def test_models(fails, small_drive, tmp_path):
    pair = ("--stereo", small_drive.left, small_drive.right, "--detector")
    assert "none.onnx" in fails(*pair, tmp_path / "none.onnx")
    assert "m.onnx" in fails(*pair, junk(tmp_path / "m.onnx", b"\x08\x07junk"))


def test_a_model_with_unknown_outputs(fails, small_drive, shared_data):
    pair = ("--stereo", small_drive.left, small_drive.right, "--detector")
    sentence = fails(*pair, shared_data / "models/twinlitenet_360x640.onnx")
    assert "drivable [1, 2, 360, 640]" in sentence


@pytest.mark.slow
def test_truth_detections_and_classes(fails, options, small_drive, tmp_path):
    assert "none.txt" in fails(*options(truth=tmp_path / "none.txt"))
    assert "line 1" in fails(*options(truth=junk(tmp_path / "t.txt", b"1 2 3\n")))
    assert "d.txt" in fails(*options(detections=junk(tmp_path / "d.txt", b"\xff\xfe\x00")))
    assert "'truck'" in fails(*options(classes="trcuk"))


def test_nan_boxes_are_skipped(succeeds, options, small_drive, tmp_path):
    rows = small_drive.detections.read_text().splitlines()
    plain = [f"{r[0]},{','.join(r[6:10])},{r[17]}" for r in (row.split() for row in rows)]
    boxes = junk(
        tmp_path / "boxes.csv", "\n".join([*plain, "0,nan,1,2,3,0.9", "0,5,5,1,1,0.9"]).encode()
    )
    assert "boxes.csv: " in succeeds(*options(detections=boxes, classes="car"))


def test_unwritable_output_folder(cli, options, tmp_path):
    blocked = junk(tmp_path / "file", b"")
    done = cli(*options(), "--out", blocked / "out")
    assert done.status == 1
    assert str(blocked / "out") in done.stderr


def test_contradicting_options(fails, options, small_drive):
    assert "--detections" in fails(*options(), "--detector", "m.onnx", status=2)
    assert "--mono" in fails("--detections", small_drive.detections, status=2)
    assert "--threads" in fails(*options(), "--threads", "-2", status=2)
    assert "--threads" in fails(*options(), "--threads", "100000", status=2)
    assert "--device" in fails(*options(), "--device", "abacus", status=2)


def test_start_after_the_end(fails, options):
    assert "start" in fails(*options(), "--start", "1000")


@pytest.mark.slow
def test_inputs_are_kept_and_old_results_removed(small_drive, tmp_path, cli):
    folder = tmp_path / "one"
    folder.mkdir()
    video = shutil.copy(small_drive.left, folder / "overlay.mp4")
    run = ("--mono", video, "--rig", small_drive.rig, "--detections", small_drive.detections)
    refused = cli(*run, "--out", folder)
    assert refused.status == 1
    assert "overlay.mp4: " in refused.stderr
    assert video.read_bytes() == small_drive.left.read_bytes()
    assert cli(*run, "--out", tmp_path / "two").status == 0
    assert (tmp_path / "two/overlay.mp4").is_file()
    assert cli(*run, "--out", tmp_path / "two", "--no-overlay").status == 0
    assert not (tmp_path / "two/overlay.mp4").exists()


@pytest.mark.slow
def test_closed_pipe_keeps_the_results(options, tmp_path):
    command = [str(TRACK_RANGE), *map(str, options()), "--out", str(tmp_path / "out")]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert (tmp_path / "out/report.html").is_file()


def test_videos_of_different_rate_length_and_start(succeeds, small_drive, options, tmp_path):
    """Right video with every other frame and a late start: matching frames are used, the others are
    reported."""
    right = tmp_path / "right.mkv"
    with av.open(str(small_drive.right)) as source, av.open(str(right), "w") as target:
        stream = target.add_stream("libx264", rate=5)
        stream.width, stream.height, stream.pix_fmt = 620, 188, "yuv420p"
        for number, frame in enumerate(source.decode(video=0)):
            if number in (2, 4):
                fresh = av.VideoFrame.from_ndarray(
                    frame.to_ndarray(format="yuv420p"), format="yuv420p"
                )
                fresh.pts, fresh.time_base = frame.pts, frame.time_base
                target.mux(stream.encode(fresh))
        target.mux(stream.encode(None))
    assert "starts 0.20 s later" in succeeds(*options(right=right))
    frames = np.unique(
        [
            int(row.split(",")[0])
            for row in (tmp_path / "out/tracks.csv").read_text().splitlines()[1:]
        ]
    )
    assert set(frames) <= {2, 4}


@pytest.mark.parametrize("name", ["tracks.csv", "summary.json", "overlay.mp4"])
def test_table_must_not_replace_a_result(fails, options, tmp_path, name):
    sentence = fails(*options(table=tmp_path / "out" / name))
    assert f"{name}: " in sentence
    assert "overwritten" in sentence
    assert not (tmp_path / "out").exists()
