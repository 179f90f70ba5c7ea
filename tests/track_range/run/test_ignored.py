"""Regions without detections (`--ignore`), and the note that proposes them."""

from pathlib import Path

import cv2
import numpy as np
import pytest

import track_range as tr
from track_range.detection.detections import Detections
from track_range.fleet.engine.plan import _shared_files
from track_range.foundation.errors import UsageError
from track_range.recording.cameras.calibration import calibration_of
from track_range.results.rows.rows import Rows
from track_range.run.box_source import boxes_of, outside_regions, region_mask
from track_range.run.options.anonymity import without_folders
from track_range.run.options.precedence import settings_from
from track_range.run.reports.still_boxes import StillBoxes
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame

SIZE_PX = (200, 100)
CALIBRATION = calibration_of(PinholeCamera.of_focal_length(150.0, SIZE_PX), (SIZE_PX,))
IMAGE = np.zeros((100, 200, 3), np.uint8)
BONNET = "0,80 199,80 199,99 0,99"  # rows from 80 on
BOXES = np.array(
    [
        [20.0, 82, 60, 99],  # on the bonnet
        [20.0, 71, 60, 99],  # 20 of 29 rows on it
        [100.0, 30, 140, 99],  # a car ahead whose lower end is behind the bonnet
        [100.0, 0, 140, 40],
        [-60.0, 85, 20, 130],  # partly outside of the image
    ]
)


class Boxes:
    def detect(self, image):
        n = len(BOXES)
        return Detections.of(BOXES, np.linspace(0.9, 0.5, n), np.full(n, 2))


@pytest.mark.parametrize(
    ("regions", "kept"),
    [
        (None, [0, 1, 2, 3, 4]),
        (BONNET, [2, 3]),
        (f"{BONNET} / 90,0 150,0 150,25 90,25", [2]),  # 26 of 41 rows of the fourth box
        (f"{BONNET} / 90,0 150,0 150,15 90,15", [2, 3]),
        ("mask", [2, 3]),
    ],
)
def test_boxes_mostly_in_regions(regions, kept, tmp_path):
    if regions == "mask":
        regions = str(tmp_path / "mask.png")
        cv2.imwrite(
            regions,
            np.where(np.arange(100)[:, None] >= 80, 255, np.zeros((100, 200))).astype(np.uint8),
        )
    source = outside_regions(boxes_of(Boxes()), regions, CALIBRATION)
    frame = Frame(0, 0.0, IMAGE, None)
    np.testing.assert_array_equal(source.detect(frame).xyxy_px, BOXES[kept])
    assert len(source.candidates(frame)) == 5  # what is hidden for anonymity stays hidden
    with tr.Pipeline.mono(focal_px=150, detector=Boxes(), ignore=regions) as pipeline:
        assert len(pipeline.step(IMAGE, 0.0).tracks) == len(kept)


@pytest.mark.parametrize(
    ("regions", "words"),
    [
        ("0,0 10,10", "found '0,0 10,10'"),
        ("0,0 10,10 5", "found '0,0 10,10 5'"),
        ("0,0 10,0 10,10 / a,b", "found 'a,b'"),
        ("0,0 10,0 10,nan", "found"),
        ("", "found"),
        ("300,300 310,300 310,310", "no pixel of the image"),
        ("no.png", "no readable image"),
        ("small.png", "of the video, 200x100 px, found one of 100x50 px"),
        ("black.png", "no pixel of the image"),
    ],
)
def test_invalid_regions(regions, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("small.png", np.full((50, 100), 255, np.uint8))
    cv2.imwrite("black.png", np.zeros((100, 200), np.uint8))
    with pytest.raises(UsageError, match=r"--ignore \(Python ignore\): ") as error:
        region_mask(regions, SIZE_PX)
    assert words in str(error.value)


def rows(box, *, jitter_px=0.0, speed_mps=10.0, seconds=12.0):
    n = round(10 * seconds)
    moved = np.array(box, float) + np.random.default_rng(0).normal(0, 1, (n, 4)) * jitter_px
    columns = dict(zip(("x1_px", "y1_px", "x2_px", "y2_px"), moved.T, strict=True))
    return columns | {
        "time_s": np.arange(n) / 10,
        "track_id": np.full(n, 3),
        "observed": np.ones(n),
        "ego_mps": np.full(n, speed_mps),
    }


@pytest.mark.parametrize(
    ("columns", "is_noted"),
    [
        (rows(BOXES[0], jitter_px=0.1), True),
        (rows([100, 2, 140, 12], jitter_px=0.1), True),  # text at the top
        (rows(BOXES[0], jitter_px=0.4), False),  # a car that follows, as the pitch moves it
        (rows([90, 40, 110, 60], jitter_px=0.1), False),  # in the middle
        (rows(BOXES[0], speed_mps=0.0), False),
        (rows(BOXES[0], speed_mps=np.nan), False),
        (rows(BOXES[0], seconds=9.0), False),
    ],
)
def test_boxes_that_do_not_move(columns, is_noted):
    notes = StillBoxes(Rows(columns), CALIBRATION).notes()
    assert len(notes) == is_noted
    if is_noted and columns["y1_px"][0] > 50:
        assert "Track 3 did not move" in notes[0]
        assert "--ignore '20,82 60,82 60,99 20,99'" in notes[0]
        assert region_mask(notes[0].split("'")[1], SIZE_PX).sum() == 41 * 18


def test_still_boxes_of_several_tracks():
    one, other = rows(BOXES[0]), rows([90, 40, 110, 60]) | {"track_id": np.full(120, 1)}
    order = np.argsort(np.concatenate([one["time_s"], other["time_s"]]), kind="stable")
    both = {name: np.concatenate([one[name], other[name]])[order] for name in one}
    assert "Track 3 did" in StillBoxes(Rows(both), CALIBRATION).notes()[0]
    assert StillBoxes(Rows(both).select(slice(0)), CALIBRATION).notes() == ()


def test_ignored_boxes_of_a_run(cli, tmp_path):
    (tmp_path / "images").mkdir()
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"images/{number}.png"), IMAGE)
    lines = (
        f"{n},-1,{x1},{y1},{x2 - x1},{y2 - y1},0.9"
        for n in (1, 2, 3)
        for x1, y1, x2, y2 in BOXES[[0, 2]]
    )
    (tmp_path / "det.txt").write_text("\n".join(lines) + "\n")
    options = (
        "--detections",
        tmp_path / "det.txt",
        "--focal-px",
        150,
        "--no-overlay",
        "--lanes",
        "off",
    )
    for ignored, n_tracks in ((), 2), (("--ignore", BONNET), 1):
        out = tmp_path / f"out{n_tracks}"
        status, printed, complaint = cli(
            "--mono", tmp_path / "images", *options, *ignored, "--write", "mot", "--out", out
        )
        assert status == 0, complaint
        assert "not used with --detections" not in printed
        assert len(np.unique(np.loadtxt(out / "mot.txt", delimiter=",")[:, 1])) == n_tracks
    status, _, complaint = cli("--mono", tmp_path / "images", *options, "--ignore", "1,1")
    assert (status, "Python ignore" in complaint) == (2, True)


def test_polygons_are_no_files():
    regions = "1,2 9,2 9,9.5 / 20,20.5 30,20 30,30.5"
    settings = settings_from({"mono": Path("a/m.mp4"), "detector": "road", "ignore": regions})
    assert without_folders({"ignore": settings.ignore, "mono": "a/m.mp4"}) == {
        "ignore": settings.ignore,
        "mono": "m.mp4",
    }
    assert without_folders({"ignore": "a/mask.PNG"}) == {"ignore": "mask.PNG"}
    assert "ignore" not in _shared_files(settings)
    with_mask = settings.model_copy(update={"ignore": "a/mask.PNG"})
    assert _shared_files(with_mask)["ignore"] == [Path("a/mask.PNG").absolute()]
