"""`track`: boxes of files to identities, in the files' own way of counting frames."""

import json

import pytest


def plain(*rows):
    return "".join(f"{f},{x},10,{x + 40},50,{score}\n" for f, x, score in rows)


@pytest.fixture
def moving():
    """Two targets, one of which pauses for a frame."""
    return [(f, 100 + 2 * f, 0.9) for f in range(10)] + [(f, 400, 0.8) for f in range(10) if f != 5]


def rows_of(path):
    return [[float(cell) for cell in line.split(",")] for line in path.read_text().splitlines()]


def test_plain_rows_keep_their_frames_and_the_result_can_be_evaluated(tmp_path, cli, moving):
    folder = tmp_path / "Car"
    folder.mkdir()
    (folder / "0007.txt").write_text(plain(*moving))
    status, told, _ = cli("track", folder, "--out", tmp_path / "out", "--kitti")
    assert status == 0, told
    rows = rows_of(tmp_path / "out/mot/0007.txt")
    assert {row[0] for row in rows} == set(range(10))
    assert {row[1] for row in rows} == {1, 2}
    assert rows[0][2:6] == [101.0, 11.0, 40.0, 40.0]  # MOT's pixels count from 1
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
        "evaluate", "tracks", "--truth", truth, "--results", tmp_path / "out", "--json", tmp_path / "f.json"
    )
    assert status == 0
    figures = json.loads((tmp_path / "f.json").read_text())["combined"]
    assert (figures["idsw"], figures["fp"]) == (0, 0)
    assert figures["idf1"] > 97


def test_motchallenge_folders_count_from_one(tmp_path, cli, moving):
    for name in ("A", "B"):
        folder = tmp_path / name / "det"
        folder.mkdir(parents=True)
        (folder / "det.txt").write_text("".join(f"{f + 1},-1,{x + 1},11,40,40,{s}\n" for f, x, s in moving))
    (tmp_path / "A/seqinfo.ini").write_text(
        "[Sequence]\nname=A\nframeRate=25\nseqLength=12\nimWidth=640\nimHeight=480\n"
    )
    status, told, _ = cli("track", tmp_path, "--out", tmp_path / "out")
    assert status == 0, told
    assert sorted(path.name for path in (tmp_path / "out/mot").iterdir()) == ["A.txt", "B.txt"]
    assert min(row[0] for row in rows_of(tmp_path / "out/mot/A.txt")) == 1
    assert not (tmp_path / "out/kitti").exists()


def test_the_same_boxes_give_the_same_tracks(tmp_path, cli, moving):
    (tmp_path / "boxes.txt").write_text(plain(*moving))
    for name in ("one", "two"):
        assert cli("track", tmp_path / "boxes.txt", "--out", tmp_path / name)[0] == 0
    first, second = ((tmp_path / name / "mot/boxes.txt").read_bytes() for name in ("one", "two"))
    assert first == second


def test_a_sequence_without_boxes_is_a_sequence_without_tracks(tmp_path, cli, moving):
    (tmp_path / "in").mkdir()
    (tmp_path / "in/a.txt").write_text("")
    (tmp_path / "in/b.txt").write_text(plain(*moving))
    assert cli("track", tmp_path / "in", "--out", tmp_path / "out")[0] == 0
    assert (tmp_path / "out/mot/a.txt").read_text() == ""


def test_wrong_input_is_one_sentence(tmp_path, cli, moving):
    boxes = tmp_path / "boxes.txt"
    boxes.write_text(plain(*moving))
    for arguments, status, said in (
        ((tmp_path / "none",), 1, "no such file or folder"),
        ((tmp_path / "empty",), 1, "no sequences"),
        ((boxes, "--classes", "zebra"), 1, "unknown class 'zebra'"),
        ((boxes, "--classes", "car,bus"), 2, "rows that name no class want one"),
    ):
        (tmp_path / "empty").mkdir(exist_ok=True)
        told, _, complaint = cli("track", *arguments, "--out", tmp_path / "out")
        assert (told, said in complaint) == (status, True), complaint
    (tmp_path / "A/det").mkdir(parents=True)
    (tmp_path / "A/det/det.txt").write_text("1,-1,1,1,10,10,1\n")
    (tmp_path / "A/seqinfo.ini").write_text("[Sequence]\nframeRate=0\n")
    told, _, complaint = cli("track", tmp_path / "A", "--out", tmp_path / "out")
    assert (told, "frameRate and seqLength must be positive" in complaint) == (1, True)
