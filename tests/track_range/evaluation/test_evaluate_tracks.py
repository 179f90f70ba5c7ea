"""Tests of `track-range evaluate tracks` on small files, worked by hand, and on invalid input."""

import json

import pytest

KITTI = "{frame} {id} {kind} 0 0 -10 {x} 10 {x2} 50 1 1 1 0 0 0 0\n"


def kitti_rows(*rows):
    """(frame, id, type, left edge) -> label rows; boxes are 40 px wide and high."""
    return "".join(KITTI.format(frame=f, id=i, kind=kind, x=x, x2=x + 40) for f, i, kind, x in rows)


def mot_rows(*rows):
    """(frame as in the file, id, left edge) -> MOT rows of the same boxes."""
    return "".join(f"{f},{i},{x + 1},11,40,40,0.9,-1,-1,-1\n" for f, i, x in rows)


@pytest.fixture
def kitti(tmp_path):
    truth = tmp_path / "truth"
    truth.mkdir()
    rows = [(f, 1, "Car", 100) for f in range(4)] + [(f, 2, "Van", 300) for f in range(4)]
    (truth / "0001.txt").write_text(kitti_rows(*rows, (0, 3, "Pedestrian", 500)))
    (truth / "0002.txt").write_text(kitti_rows(*((f, 1, "Car", 100) for f in range(4))))
    return truth


def test_sequences_and_combined(kitti, tmp_path, cli):
    results = tmp_path / "out/mot"
    results.mkdir(parents=True)
    # MOT rows count frames from 1, the truth from 0. The first sequence has an identity switch and
    # a tracked van, which is ignored; the second has no tracks.
    rows = [(1, 7, 100), (2, 7, 100), (3, 8, 100), (4, 8, 100), (1, 9, 300), (2, 9, 300)]
    (results / "0001.txt").write_text(mot_rows(*rows))
    (results / "0002.txt").write_text("")
    figures = tmp_path / "figures.json"
    status, printed, _ = cli(
        "evaluate", "tracks", "--truth", kitti, "--results", tmp_path / "out", "--json", figures
    )
    assert status == 0, printed
    assert "0002" in printed
    read = json.loads(figures.read_text())
    first, second, combined = read["sequences"]["0001"], read["sequences"]["0002"], read["combined"]
    assert (first["idsw"], first["fp"], first["fn"], first["mota"]) == (1, 0, 0, 75.0)
    assert (first["deta"], first["assa"]) == (100.0, 50.0)
    assert first["hota"] == pytest.approx(100 * 0.5**0.5)
    assert (second["fn"], second["mota"], second["motp"]) == (4, 0.0, None)
    assert (combined["fn"], combined["n"]) == (4, 8)
    assert combined["mota"] == pytest.approx(37.5)
    assert set(combined) >= set("hota deta assa loca mota motp idf1 idsw fp fn frag mt ml".split())


def test_results_without_truth_are_reported(kitti, tmp_path, cli):
    results = tmp_path / "results"
    results.mkdir()
    for name in ("0001", "0002", "0003"):
        (results / f"{name}.txt").write_text(mot_rows((1, 7, 100)))
    figures = tmp_path / "figures.json"
    status, printed, _ = cli(
        "evaluate", "tracks", "--truth", kitti, "--results", results, "--json", figures
    )
    (note,) = json.loads(figures.read_text())["notes"]
    assert (status, note in printed) == (0, True)
    assert "0003" in note
    (results / "0003.txt").unlink()
    assert (
        cli("evaluate", "tracks", "--truth", kitti, "--results", results, "--json", figures)[0] == 0
    )
    assert json.loads(figures.read_text())["notes"] == []


def test_kitti_results_of_another_class(kitti, tmp_path, cli):
    results = tmp_path / "0001.txt"
    results.write_text(kitti_rows((0, 5, "Pedestrian", 500), (0, 6, "Car", 100)))
    status, _, _ = cli(
        "evaluate", "tracks", "--truth", kitti / "0001.txt", "--results", results, "--class", "pedestrian",
        "--json", tmp_path / "f.json",
    )  # fmt: skip
    assert status == 0
    assert json.loads((tmp_path / "f.json").read_text())["combined"]["hota"] == pytest.approx(100.0)


def test_motchallenge_folders(tmp_path, cli):
    folder = tmp_path / "truth/TOWN/gt"
    folder.mkdir(parents=True)
    (folder / "gt.txt").write_text("".join(f"{f},1,101,11,40,40,1,1,1\n" for f in (1, 2, 3)))
    (tmp_path / "TOWN.txt").write_text(mot_rows((1, 4, 100), (2, 4, 100), (3, 4, 100)))
    status, printed, _ = cli(
        "evaluate", "tracks", "--truth", tmp_path / "truth", "--results", tmp_path / "TOWN.txt",
        "--json", tmp_path / "f.json",
    )  # fmt: skip
    assert (status, "TOWN" in printed) == (0, True)
    assert json.loads((tmp_path / "f.json").read_text())["combined"]["mota"] == 100.0


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
        ("0003.txt", "", "0001, 0002"),
        ("0001.txt", "junk,junk\n", "0001.txt, line 1"),
        ("0001.txt", "1,1,1,1,1,1,1\n1,1,1,1,1,1,1\n", "duplicate"),
        ("0001.txt", "-1,1,1,1,1,1,1\n", "frame numbers"),
        ("0001.txt", b"\xff\xfe\x00", "text"),
    ],
)
def test_invalid_results(kitti, tmp_path, cli, name, text, word):
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "0002.txt").write_text("")
    if name == "0003.txt":
        (folder / "0002.txt").unlink()
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    status, _, errors = cli("evaluate", "tracks", "--truth", kitti, "--results", folder)
    assert (status, word in errors) == (1, True), errors


def test_truth_in_cvat(tmp_path, cli):
    """A car in two frames and a person, tracked without classes: all tracks count as cars."""
    box = '<box frame="{}" outside="{}" occluded="0" keyframe="1" xtl="{}" ytl="10.5" xbr="{}" ybr="50.5"/>'
    car = (
        box.format(0, 0, 100.5, 140.5)
        + box.format(1, 0, 100.5, 140.5)
        + box.format(2, 1, 100.5, 140.5)
    )
    person = box.format(0, 0, 300.5, 340.5) + box.format(1, 1, 300.5, 340.5)
    tracks = f'<track id="0" label="car">{car}</track><track id="1" label="person">{person}</track>'
    truth, results, figures = (
        tmp_path / name for name in ("truth.xml", "results.txt", "figures.json")
    )
    truth.write_text(f"<annotations>{tracks}</annotations>")
    results.write_text(mot_rows((1, 7, 100), (2, 7, 100), (1, 8, 300)))
    options = ("evaluate", "tracks", "--truth", truth, "--results", results, "--json", figures)
    assert cli(*options, "--class", "car")[0] == 0
    read = json.loads(figures.read_text())
    assert (read["combined"]["fp"], read["combined"]["fn"], read["combined"]["motp"]) == (
        1,
        0,
        100.0,
    )
    assert any("no class" in note for note in read["notes"])
    results.write_text(
        kitti_rows((0, 7, "Car", 100), (1, 7, "Car", 100), (0, 8, "Pedestrian", 300))
    )
    assert cli(*options, "--class", "car")[0] == 0
    read = json.loads(figures.read_text())
    assert (read["combined"]["hota"], read["combined"]["n"], read["notes"]) == (100.0, 2, [])
    status, _, error = cli(*options, "--format", "coco")
    assert status == 1
    assert "truth.xml" in error


def test_wrong_usage(kitti, tmp_path, cli):
    for options, expected, word in (
        (("--class", "zebra"), 1, "zebra"),
        (("--class", "bus"), 2, "car, person, bicycle"),
        (("--format", "mot", "--class", "car"), 1, "0001.txt, line 1"),
    ):
        status, _, errors = cli(
            "evaluate", "tracks", "--truth", kitti, "--results", kitti, *options
        )
        assert (status, word in errors) == (expected, True), errors
    truth = tmp_path / "gt.txt"
    truth.write_text("1,1,100,100,50,50,1,3,1\n")
    status, _, errors = cli(
        "evaluate", "tracks", "--truth", truth, "--results", truth, "--class", "car"
    )
    assert (status, "labels.txt" in errors) == (2, True)
    status, _, errors = cli("evaluate", "tracks", "--truth", tmp_path / "none", "--results", kitti)
    assert (status, "none: no such file" in errors) == (1, True)


def test_comparison_with_motmetrics(kitti, tmp_path, cli):
    results = tmp_path / "results"
    results.mkdir()
    rows = [(1, 7, 100), (2, 7, 100), (3, 8, 100), (4, 8, 100)]
    (results / "0001.txt").write_text(mot_rows(*rows))
    (results / "0002.txt").write_text(mot_rows(*((f, 1, 100) for f in (1, 2, 4))))
    arguments = (
        "evaluate",
        "tracks",
        "--truth",
        kitti,
        "--results",
        results,
        "--json",
        tmp_path / "f.json",
    )
    status, printed, errors = cli(*arguments, "--compare", "motmetrics")
    assert status == 0, errors
    assert "motmetrics" in printed
    read = json.loads((tmp_path / "f.json").read_text())
    reference = read["motmetrics"]
    assert (
        reference["combined"]["idsw"],
        reference["combined"]["fn"],
        reference["combined"]["mota"],
    ) == (1, 1, 75.0)
    assert set(reference["sequences"]) == {"0001", "0002"}
    assert (read["combined"]["frag"], reference["combined"]["frag"]) == (0, 1)
    assert "Frag" in printed
    assert cli(*arguments)[0] == 0
    assert "motmetrics" not in json.loads((tmp_path / "f.json").read_text())


def test_motmetrics_on_mot17(shared_data, tmp_path, cli):
    truth = shared_data / "mot/MOT17"
    assert cli("track", truth, "--online", "--out", tmp_path)[0] == 0
    figures = tmp_path / "f.json"
    arguments = ("evaluate", "tracks", "--truth", truth, "--results", tmp_path, "--json", figures)
    status, _, errors = cli(*arguments, "--compare", "motmetrics")
    assert status == 0, errors
    read = json.loads(figures.read_text())
    reference, combined = read["motmetrics"]["combined"], read["combined"]
    for name in ("mota", "motp", "idf1", "idsw", "fp", "fn", "ml"):
        assert reference[name] == pytest.approx(combined[name]), name
    # motmetrics counts them as mostly tracked (REASONS)
    at_80_per_cent = reference["mt"] - combined["mt"]
    assert 0 <= at_80_per_cent <= 2
    assert combined["pt"] - reference["pt"] == at_80_per_cent


def evaluated(cli, tmp_path, truth, results, *options):
    """Figures of an evaluation of two files with these texts."""
    paths = [tmp_path / name for name in ("truth.txt", "tracks.txt")]
    for path, text in zip(paths, (truth, results), strict=True):
        path.write_text(text)
    status, _, errors = cli(
        "evaluate",
        "tracks",
        "--truth",
        paths[0],
        "--results",
        paths[1],
        "--json",
        tmp_path / "f.json",
        *options,
    )
    assert status == 0, errors
    return json.loads((tmp_path / "f.json").read_text())


def test_truth_without_classes_has_the_given_class(cli, tmp_path):
    truth = mot_rows((1, 7, 100), (2, 7, 100))
    results = kitti_rows((0, 7, "Car", 100), (1, 7, "Car", 100), (1, 8, "Pedestrian", 300))
    read = evaluated(cli, tmp_path, truth, results, "--class", "car")
    assert (read["class"], read["combined"]["hota"], read["notes"]) == ("car", 100.0, [])
    read = evaluated(cli, tmp_path, truth, results.replace("Pedestrian", "Car"))
    assert (read["class"], read["combined"]["fn"]) == ("person", 2)
    assert "classes car (3)" in read["notes"][0]


def test_no_common_frame_is_noted_with_the_shift(cli, tmp_path):
    def tracks(first):
        return mot_rows(*((first + i, 1 + j, 100 * j + 3 * i) for i in range(30) for j in (1, 2)))

    (note,) = evaluated(cli, tmp_path, tracks(1), tracks(501))["notes"]
    assert "0 to 29" in note
    assert "decreased by 500" in note
    (note,) = evaluated(cli, tmp_path, tracks(1), tracks(8))["notes"]
    assert "decreased by 7" in note


def test_vans_are_no_cars_of_kitti(cli, tmp_path):
    """TrackEval and KITTI's development kit count the rows of the type Car only."""
    truth = kitti_rows((0, 1, "Car", 100), (0, 2, "Van", 300))
    results = kitti_rows((0, 1, "car", 100), (0, 2, "Van", 300), (0, 3, "Van", 500))
    read = evaluated(cli, tmp_path, truth, results)
    assert (read["combined"]["fp"], read["combined"]["fn"], read["combined"]["n"]) == (0, 0, 1)


def test_names_of_labels_txt(cli, tmp_path):
    (tmp_path / "labels.txt").write_text("truck\ncar\n")
    truth = "1,1,100,100,50,50,1,2,1\n1,2,300,100,50,50,1,1,1\n"
    read = evaluated(cli, tmp_path, truth, kitti_rows((0, 1, "Car", 100)), "--class", "truck")
    assert (read["class"], read["combined"]["fn"]) == ("truck", 1)
