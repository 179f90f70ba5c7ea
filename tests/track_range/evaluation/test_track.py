"""Tests of `track-range track`: tracks of recorded boxes; MOT files count frames from 1, KITTI
files from 0."""

import json

import cv2
import numpy as np
import pytest


def rrc_rows(*rows):
    """(frame, left edge, score) -> rows frame,x1,y1,x2,y2,score."""
    return "".join(f"{f},{x},10,{x + 40},50,{score}\n" for f, x, score in rows)


@pytest.fixture
def moving():
    """(frame, left edge, score) of two targets, one of which is missing in a frame."""
    return [(f, 100 + 2 * f, 0.9) for f in range(10)] + [(f, 400, 0.8) for f in range(10) if f != 5]


def rows_of(path):
    return [[float(cell) for cell in line.split(",")] for line in path.read_text().splitlines()]


def test_rrc_rows_tracked_and_evaluated(tmp_path, cli, moving):
    folder = tmp_path / "Car"
    folder.mkdir()
    (folder / "0007.txt").write_text(rrc_rows(*moving))
    status, printed, _ = cli("track", folder, "--out", tmp_path / "out", "--kitti")
    assert status == 0, printed
    rows = rows_of(tmp_path / "out/mot/0007.txt")
    assert {row[0] for row in rows} == set(range(1, 11))
    assert {row[1] for row in rows} == {1, 2}
    assert rows[0][2:6] == [101.0, 11.0, 40.0, 40.0]  # MOT pixels count from 1
    kitti = (tmp_path / "out/kitti/0007.txt").read_text().splitlines()
    assert len(kitti) == len(rows)
    assert kitti[0].startswith("0 1 Car -1 -1 -10 100.00 10.00 140.00 50.00 ")
    truth = tmp_path / "0007.txt"
    truth.write_text(
        "".join(
            f"{f} {i} Car 0 0 -10 {x} 10 {x + 40} 50 1 1 1 0 0 0 0\n"
            for f in range(10)
            for i, x in ((1, 100 + 2 * f), (2, 400))
        )
    )
    status, _, _ = cli(
        "evaluate",
        "tracks",
        "--truth",
        truth,
        "--results",
        tmp_path / "out",
        "--json",
        tmp_path / "f.json",
    )
    assert status == 0
    figures = json.loads((tmp_path / "f.json").read_text())["combined"]
    assert (figures["idsw"], figures["fp"]) == (0, 0)
    assert figures["idf1"] > 97


def test_motchallenge_folders_count_from_one(tmp_path, cli, moving):
    for name in ("A", "B"):
        folder = tmp_path / name / "det"
        folder.mkdir(parents=True)
        (folder / "det.txt").write_text(
            "".join(f"{f + 1},-1,{x + 1},11,40,40,{s}\n" for f, x, s in moving)
        )
    (tmp_path / "A/seqinfo.ini").write_text(
        "[Sequence]\nname=A\nframeRate=25\nseqLength=12\nimWidth=640\nimHeight=480\n"
    )
    status, printed, _ = cli("track", tmp_path, "--out", tmp_path / "out")
    assert status == 0, printed
    assert sorted(path.name for path in (tmp_path / "out/mot").iterdir()) == ["A.txt", "B.txt"]
    assert min(row[0] for row in rows_of(tmp_path / "out/mot/A.txt")) == 1
    assert not (tmp_path / "out/kitti").exists()


def kitti_row(frame, x):
    return f"{frame} -1 Car -1 -1 -10 {x} 10 {x + 40} 50 -1 -1 -1 -1000 -1000 -1000 -10 0.9\n"


def mot_row(frame, x):
    return f"{frame + 1},-1,{x + 1},11,40,40,0.9\n"


@pytest.mark.parametrize("row", [kitti_row, mot_row])
def test_frame_numbers_of_both_formats(tmp_path, cli, row):
    boxes = tmp_path / "boxes.txt"
    boxes.write_text(
        "".join(row(frame, 100 + 3 * frame) for frame in (*range(2, 8), *range(30, 36)))
    )
    assert (
        cli("track", boxes, "--out", tmp_path / "out", "--kitti", "--online", "--classes", "car")[0]
        == 0
    )
    mot = rows_of(tmp_path / "out/mot/boxes.txt")
    kitti = [line.split() for line in (tmp_path / "out/kitti/boxes.txt").read_text().splitlines()]
    assert [line[0] for line in mot] == [int(line[0]) + 1 for line in kitti]
    assert [line[2] for line in mot] == [float(line[6]) + 1 for line in kitti]
    assert {8, 36} <= {line[0] for line in mot} <= {*range(3, 9), *range(31, 37)}
    # with the same boxes as truth, in either format, each result scores 100
    truth = {name: tmp_path / f"{name}-truth.txt" for name in ("kitti", "mot")}
    truth["kitti"].write_text(
        "".join(" ".join([*line[:3], "0", "0", *line[5:17]]) + "\n" for line in kitti)
    )
    truth["mot"].write_text(
        "".join(",".join(f"{cell:g}" for cell in [*line[:6], 1, 1, 1]) + "\n" for line in mot)
    )
    for expected, results in (("kitti", "kitti"), ("kitti", "mot"), ("mot", "mot")):
        pair = ("--truth", truth[expected], "--results", tmp_path / f"out/{results}/boxes.txt")
        assert cli("evaluate", "tracks", *pair, "--json", tmp_path / "figures.json")[0] == 0
        assert json.loads((tmp_path / "figures.json").read_text())["combined"][
            "hota"
        ] == pytest.approx(100.0)


def test_tracking_is_deterministic(tmp_path, cli, moving):
    (tmp_path / "boxes.txt").write_text(rrc_rows(*moving))
    for name in ("one", "two"):
        assert cli("track", tmp_path / "boxes.txt", "--out", tmp_path / name)[0] == 0
    first, second = ((tmp_path / name / "mot/boxes.txt").read_bytes() for name in ("one", "two"))
    assert first == second


def test_sequence_without_boxes(tmp_path, cli, moving):
    (tmp_path / "in").mkdir()
    (tmp_path / "in/a.txt").write_text("")
    (tmp_path / "in/b.txt").write_text(rrc_rows(*moving))
    assert cli("track", tmp_path / "in", "--out", tmp_path / "out")[0] == 0
    assert (tmp_path / "out/mot/a.txt").read_text() == ""


def test_invalid_input(tmp_path, cli, moving):
    boxes = tmp_path / "boxes.txt"
    boxes.write_text(rrc_rows(*moving))
    for arguments, status, word in (
        ((tmp_path / "none",), 1, "no such file"),
        ((tmp_path / "empty",), 1, "NAME.txt"),
        ((boxes, "--classes", "zebra"), 1, "zebra"),
        ((boxes, "--classes", "car,bus"), 2, "one class"),
    ):
        (tmp_path / "empty").mkdir(exist_ok=True)
        actual, _, errors = cli("track", *arguments, "--out", tmp_path / "out")
        assert (actual, word in errors) == (status, True), errors
    (tmp_path / "A/det").mkdir(parents=True)
    (tmp_path / "A/det/det.txt").write_text("1,-1,1,1,10,10,1\n")
    (tmp_path / "A/seqinfo.ini").write_text("[Sequence]\nframeRate=0\n")
    status, _, errors = cli("track", tmp_path / "A", "--out", tmp_path / "out")
    assert (status, "seqinfo.ini" in errors, "frameRate" in errors) == (1, True, True)


def frames_of(folder, n, *, hw=(64, 480), suffix=".png"):
    folder.mkdir(parents=True)
    for i in range(n):
        image = np.random.default_rng(7).integers(0, 255, (*hw, 3)).astype(np.uint8)
        image[10:51, 100 + 2 * i : 141 + 2 * i] = (20, 20, 200)
        cv2.imwrite(str(folder / f"{i + 1:06d}{suffix}"), image)
    return folder


def test_gaps_are_filled_unless_online(tmp_path, cli, moving):
    (tmp_path / "boxes.txt").write_text(rrc_rows(*moving))
    n_rows = {}
    for name, options in (("offline", ()), ("online", ("--online",))):
        assert cli("track", tmp_path / "boxes.txt", "--out", tmp_path / name, *options)[0] == 0
        rows = rows_of(tmp_path / name / "mot/boxes.txt")
        n_rows[name] = len(rows)
    assert n_rows == {"offline": 20, "online": 19}  # the target at 400 px is missing in frame 5
    filled = next(
        row for row in rows_of(tmp_path / "offline/mot/boxes.txt") if row[0] == 6 and row[2] > 300
    )
    assert filled[2:6] == [401.0, 11.0, 40.0, 40.0]


def test_images_of_one_and_of_several_sequences(tmp_path, cli, moving):
    images = frames_of(tmp_path / "frames/one", 10)
    frames_of(tmp_path / "frames/two/img1", 10)
    for name in ("one", "two"):
        (tmp_path / "boxes").mkdir(exist_ok=True)
        (tmp_path / f"boxes/{name}.txt").write_text(rrc_rows(*moving))
    status, printed, _ = cli(
        "track", tmp_path / "boxes/one.txt", "--images", images, "--out", tmp_path / "a"
    )
    assert status == 0, printed
    status, printed, _ = cli(
        "track", tmp_path / "boxes", "--images", tmp_path / "frames", "--out", tmp_path / "b"
    )
    assert status == 0, printed
    assert (tmp_path / "a/mot/one.txt").read_bytes() == (tmp_path / "b/mot/two.txt").read_bytes()
    status, _, errors = cli(
        "track", tmp_path / "boxes", "--images", tmp_path / "none", "--out", tmp_path / "c"
    )
    assert (status, "none: no such file" in errors) == (1, True)
    status, _, errors = cli(
        "track", tmp_path / "boxes", "--images", images, "--out", tmp_path / "c"
    )
    assert (status, "one.mp4" in errors) == (1, True)


def test_fewer_images_than_frames(tmp_path, cli, moving):
    images = frames_of(tmp_path / "frames", 6)
    (tmp_path / "boxes.txt").write_text(rrc_rows(*moving))
    status, printed, _ = cli(
        "track", tmp_path / "boxes.txt", "--images", images, "--out", tmp_path / "out"
    )
    assert (status, "6 of 10 frames" in printed) == (0, True)
    assert {row[0] for row in rows_of(tmp_path / "out/mot/boxes.txt")} == set(range(1, 11))


def test_missing_image(tmp_path, cli, moving):
    images = frames_of(tmp_path / "frames", 10)
    (images / "000004.png").unlink()
    (tmp_path / "boxes.txt").write_text(rrc_rows(*moving))
    status, printed, _ = cli(
        "track", tmp_path / "boxes.txt", "--images", images, "--out", tmp_path / "out"
    )
    assert (status, "9 of 10 frames" in printed) == (0, True)
    assert {row[1] for row in rows_of(tmp_path / "out/mot/boxes.txt")} == {1, 2}


def test_wrong_format(tmp_path, cli, moving):
    (tmp_path / "boxes.txt").write_text(rrc_rows(*moving))
    assert (
        cli("track", tmp_path / "boxes.txt", "--format", "rrc", "--out", tmp_path / "out")[0] == 0
    )
    status, _, errors = cli(
        "track", tmp_path / "boxes.txt", "--format", "mot", "--out", tmp_path / "out"
    )
    assert (status, "mot" in errors) == (1, True)


@pytest.fixture
def with_embeddings(tmp_path):
    """Two static people who change places while undetected for 8 frames, with their embeddings in
    feat.npy."""
    rows, embeddings = [], []
    for f in range(30):
        for person, x in ((0, 100 if f < 10 else 130), (1, 130 if f < 10 else 100)):
            if not 10 <= f < 18:
                rows.append([f + 1, -1, x + 1, 11, 40, 80, 0.9])
                embeddings.append(np.eye(8)[person] * 3.0)
    folder = tmp_path / "S/det"
    folder.mkdir(parents=True)
    (folder / "det.txt").write_text("".join(",".join(map(str, row)) + "\n" for row in rows))
    np.save(folder / "feat.npy", np.concatenate([np.array(rows), np.array(embeddings)], axis=1))
    return folder


def last_ids_by_position(path):
    """Ids in the last frame, from left to right."""
    return [
        row[1]
        for row in sorted((row for row in rows_of(path) if row[0] == 30), key=lambda row: row[2])
    ]


def test_embeddings_next_to_the_boxes(tmp_path, cli, with_embeddings):
    ids = {}
    for tracker in ("road", "deepsort", "sort"):
        status, printed, _ = cli(
            "track", tmp_path / "S", "--tracker", tracker, "--out", tmp_path / tracker
        )
        assert status == 0, printed
        ids[tracker] = last_ids_by_position(tmp_path / tracker / "mot/S.txt")
    assert ids == {"road": [2, 1], "deepsort": [2, 1], "sort": [1, 2]}


@pytest.mark.parametrize(
    ("write", "word"),
    [
        (lambda path, table: path.write_bytes(b"junk"), "array"),
        (lambda path, table: np.save(path, table[:-1]), "44 rows"),
        (lambda path, table: np.save(path, table[:, :7]), "44 rows"),
        (lambda path, table: np.save(path, table[::-1]), "same boxes"),
        (lambda path, table: np.save(path, table * np.nan), "finite"),
    ],
)
def test_invalid_embeddings(tmp_path, cli, with_embeddings, write, word):
    write(with_embeddings / "feat.npy", np.load(with_embeddings / "feat.npy"))
    status, _, errors = cli("track", tmp_path / "S", "--out", tmp_path / "out")
    assert (status, word in errors) == (1, True), errors


def test_reid_needs_images_and_a_reid_network(tmp_path, cli, moving):
    (tmp_path / "boxes.txt").write_text(rrc_rows(*moving))
    images = frames_of(tmp_path / "frames", 3)
    arguments = (
        "track",
        tmp_path / "boxes.txt",
        "--out",
        tmp_path / "out",
        "--reid",
        tmp_path / "none.onnx",
    )
    status, _, errors = cli(*arguments)
    assert (status, "--images" in errors) == (2, True)
    arguments = (*arguments, "--images", images)
    status, _, errors = cli(*arguments)
    assert (status, "none.onnx" in errors) == (1, True)
    status, _, errors = cli(*arguments, "--tracker", "sort")
    assert (status, "--tracker sort" in errors) == (2, True)


def test_inputs_are_not_overwritten(tmp_path, cli, moving):
    (tmp_path / "mot").mkdir()
    (tmp_path / "mot/a.txt").write_text(rrc_rows(*moving))
    status, _, errors = cli("track", tmp_path / "mot", "--out", tmp_path)
    assert (status, "mot/a.txt" in errors, "overwrite" in errors) == (1, True, True)
    assert (tmp_path / "mot/a.txt").read_text() == rrc_rows(*moving)
    for folder in ("same/S/det", "same/S/S/det"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "det.txt").write_text("1,-1,1,1,10,10,1\n")
    status, _, errors = cli("track", tmp_path / "same/S", "--out", tmp_path / "out")
    assert (status, "two sequences" in errors) == (1, True)


@pytest.mark.parametrize("frame", ["1000000000", "nan", "inf", "1e19", "1.5"])
def test_invalid_frame_numbers(tmp_path, cli, frame):
    (tmp_path / "boxes.txt").write_text(f"1,-1,1,1,10,10,1\n{frame},-1,1,1,10,10,1\n")
    status, _, errors = cli("track", tmp_path / "boxes.txt", "--out", tmp_path / "out")
    assert (status, "frame numbers" in errors) == (1, True)


def test_recording_of_one_frame(tmp_path, cli):
    (tmp_path / "boxes.txt").write_text("0,10,10,50,50,0.9\n")
    assert cli("track", tmp_path / "boxes.txt", "--out", tmp_path / "out")[0] == 0
    assert len(rows_of(tmp_path / "out/mot/boxes.txt")) == 1


def test_classes_of_kitti_rows_are_evaluated(tmp_path, cli):
    rows = [
        f"{f} {i} {kind} 0 0 -10 {x} 100 {x + 60} 160 1 1 1 0 0 0 0 {{}}"
        for f in range(6)
        for i, kind, x in ((1, "Car", 100), (2, "Pedestrian", 400))
    ]
    (tmp_path / "truth.txt").write_text("".join(row.format("").strip() + "\n" for row in rows))
    (tmp_path / "boxes.txt").write_text("".join(row.format("0.9") + "\n" for row in rows))
    assert cli("track", tmp_path / "boxes.txt", "--kitti", "--out", tmp_path / "out")[0] == 0
    status, printed, _ = cli(
        "evaluate",
        "tracks",
        "--truth",
        tmp_path / "truth.txt",
        "--results",
        tmp_path / "out",
        "--json",
        tmp_path / "f.json",
    )
    assert status == 0, printed
    assert json.loads((tmp_path / "f.json").read_text())["combined"]["hota"] == 100


def test_unreadable_sequence_among_others(tmp_path, cli, moving):
    (tmp_path / "in").mkdir()
    for name in ("a", "c"):
        (tmp_path / f"in/{name}.txt").write_text(rrc_rows(*moving))
    (tmp_path / "in/b.txt").write_text("1,2,3\n")
    status, printed, errors = cli("track", tmp_path / "in", "--out", tmp_path / "out")
    assert (status, "b: " in printed, "b.txt" in printed) == (1, True, True)
    assert "1 of 3 sequences" in errors
    assert sorted(path.name for path in (tmp_path / "out/mot").iterdir()) == ["a.txt", "c.txt"]


def test_files_beside_motchallenge_folders_are_ignored(tmp_path, cli, moving):
    (tmp_path / "in/A/det").mkdir(parents=True)
    (tmp_path / "in/A/det/det.txt").write_text("1,-1,1,1,10,10,1\n")
    (tmp_path / "in/b.txt").write_text(rrc_rows(*moving))
    status, printed, _ = cli("track", tmp_path / "in", "--out", tmp_path / "out")
    assert (status, "ignored files: b.txt" in " ".join(printed.split())) == (0, True)


def test_boxes_outside_the_images_are_reported(tmp_path, cli, moving):
    (tmp_path / "boxes.txt").write_text(rrc_rows(*moving))
    wide, narrow = (
        frames_of(tmp_path / "wide", 10),
        frames_of(tmp_path / "narrow", 10, hw=(64, 320)),
    )
    status, printed, _ = cli(
        "track", tmp_path / "boxes.txt", "--images", wide, "--out", tmp_path / "out"
    )
    assert (status, "outside the images" in printed) == (0, False)
    status, printed, _ = cli(
        "track", tmp_path / "boxes.txt", "--images", narrow, "--out", tmp_path / "out"
    )
    assert (status, "9 of 19 boxes" in printed) == (0, True)


def test_layouts_of_images(tmp_path, cli, moving):
    (tmp_path / "one.txt").write_text(rrc_rows(*moving))
    frames_of(tmp_path / "sequence/img1", 6)
    frames_of(tmp_path / "named/one", 6)
    video = cv2.VideoWriter(
        str(tmp_path / "one.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 10, (480, 64)
    )
    for image in sorted((tmp_path / "named/one").iterdir()):
        video.write(cv2.imread(str(image)))
    video.release()
    (tmp_path / "camera").mkdir()
    (tmp_path / "one.mp4").rename(tmp_path / "camera/one.MP4")
    for name in ("sequence", "named", "camera"):
        status, printed, _ = cli(
            "track", tmp_path / "one.txt", "--images", tmp_path / name, "--out", tmp_path / "out"
        )
        assert (status, "6 of 10 frames" in printed) == (0, True), printed


def test_classes_without_a_kitti_type_are_reported(tmp_path, cli, moving):
    (tmp_path / "boxes.txt").write_text(rrc_rows(*moving))
    arguments = ("track", tmp_path / "boxes.txt", "--kitti", "--out", tmp_path / "out")
    status, printed, _ = cli(*arguments, "--classes", "bus")
    assert (status, "20 of 20 boxes" in printed) == (0, True)
    assert (tmp_path / "out/kitti/boxes.txt").read_text() == ""
    assert "of 20 boxes" not in cli(*arguments, "--classes", "car")[1]


def test_classes_option_and_rows_with_classes(tmp_path, cli):
    row = "{} -1 Car -1 -1 -10 100 100 160 160 -1 -1 -1 -1000 -1000 -1000 -10 0.9\n"
    (tmp_path / "boxes.txt").write_text("".join(row.format(f) for f in range(3)))
    arguments = ("track", tmp_path / "boxes.txt", "--kitti", "--out", tmp_path / "out")
    status, printed, _ = cli(*arguments, "--classes", "person")
    assert (status, "--classes person" in printed) == (0, True)
    assert "Pedestrian" not in (tmp_path / "out/kitti/boxes.txt").read_text()
    assert "--classes" not in cli(*arguments)[1]


def test_tracker_of_another_package(tmp_path, cli, moving):
    (tmp_path / "boxes.txt").write_text(rrc_rows(*moving))
    ids = {}
    for name in ("tests.toys.toy_tracker:GreedyIouTracker", "sort"):
        status, printed, _ = cli(
            "track", tmp_path / "boxes.txt", "--tracker", name, "--out", tmp_path / "out"
        )
        assert status == 0, printed
        ids[name] = {row[1] for row in rows_of(tmp_path / "out/mot/boxes.txt")}
    assert ids == {"tests.toys.toy_tracker:GreedyIouTracker": {101, 102}, "sort": {1, 2}}


@pytest.mark.parametrize(
    ("name", "status"),
    [("none", 2), ("tests.none:X", 2), ("tests.toys.toy_tracker:NotATracker", 1)],
)
def test_wrong_tracker(tmp_path, cli, moving, name, status):
    (tmp_path / "boxes.txt").write_text(rrc_rows(*moving))
    actual, _, errors = cli(
        "track", tmp_path / "boxes.txt", "--tracker", name, "--out", tmp_path / "out"
    )
    assert (actual, name in errors) == (status, True), errors
