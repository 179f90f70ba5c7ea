"""Tests of anonymization: regions, blur, look-ahead, and what a run writes."""

import json
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from mcap.reader import make_reader

import track_range as tr
from tests.support.results.frame_results import frame_result
from track_range.detection.catalogue.lookup import DEFAULT_MODEL, find_model
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.foundation.errors import ConfigError
from track_range.run.options.anonymity import without_folders
from track_range.run.options.opened import DetectorOptions, open_detector
from track_range.run.options.precedence import settings_from
from track_range.run.options.settings_file import save_settings
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.rig_formats.rig_yaml import save_rig
from track_range.tracking.tracks import Tracks
from track_range.views.anonymization.blur import STEP_GREY, blurred, cell_colours
from track_range.views.anonymization.look_ahead import (
    LIVE,
    OFFLINE,
    LookAhead,
    anonymized_results,
    with_regions,
)
from track_range.views.anonymization.regions import MIN_CELL_PX, Boxes, Regions, regions_of

PERSON, BICYCLE, CAR, LIGHT = (
    ROAD_CLASSES.index(name) for name in ("person", "bicycle", "car", "traffic light")
)
SHAPE = (120, 200, 3)


def boxes(*rows, margin_px=0.0):
    """Boxes from (class, x1, y1, x2, y2)."""
    return Boxes(
        np.array([row[1:] for row in rows], np.float64).reshape(-1, 4),
        np.array([row[0] for row in rows], np.int64),
        np.full(len(rows), margin_px),
    )


def contains(regions, x, y):
    x1, y1, x2, y2 = regions.xyxy_px.T
    return bool(((x1 <= x) & (x <= x2) & (y1 <= y) & (y <= y2)).any())


def result(index, *tracks, candidates=(), step_s=0.1):
    """A frame result with tracks (id, class, x1, y1, x2, y2, observed) and candidates (class, x1,
    y1, x2, y2)."""
    shown = Tracks(
        np.array([row[0] for row in tracks], np.int64),
        np.array([row[2:6] for row in tracks], np.float64).reshape(-1, 4),
        np.array([row[1] for row in tracks], np.int64),
        np.ones(len(tracks)),
        np.array([row[6] for row in tracks], np.bool_),
    )
    detected = Detections.of(
        [row[1:] for row in candidates], [0.05] * len(candidates), [row[0] for row in candidates]
    )
    image = np.random.default_rng(index).integers(0, 256, SHAPE, dtype=np.uint8)
    frame = Frame(index, index * step_s, image, image)
    return frame_result(frame, shown, {}, candidates=detected)


# -- regions
# ---------------------------------------------------------------------------------------------------------


def test_head_of_a_person():
    regions = regions_of(boxes((PERSON, 50, 20, 90, 120)))
    assert contains(regions, 70, 21)
    assert contains(regions, 70, 38)
    assert not contains(regions, 70, 60)
    assert regions.cell_px[0] == MIN_CELL_PX


def test_upper_body_has_a_larger_head():
    regions = regions_of(boxes((PERSON, 50, 20, 110, 80)))
    assert contains(regions, 80, 20 + 0.22 * 2.2 * 60)


def test_rider_above_a_bicycle():
    regions = regions_of(boxes((BICYCLE, 50, 60, 110, 100)))
    assert contains(regions, 80, 32)
    assert contains(regions, 80, 70)
    assert not contains(regions, 80, 90)


def test_plate_of_a_vehicle():
    regions = regions_of(boxes((CAR, 40, 20, 180, 120)))
    assert contains(regions, 100, 72)
    assert contains(regions, 42, 100)
    assert not contains(regions, 100, 40)
    frontal = regions_of(boxes((CAR, 50, 20, 150, 120)))
    assert contains(frontal, 100, 72)
    assert not contains(frontal, 52, 72)


def test_uncertain_boxes_have_larger_regions():
    assert not contains(regions_of(boxes((PERSON, 50, 20, 90, 120))), 110, 25)
    assert contains(regions_of(boxes((PERSON, 50, 20, 90, 120), margin_px=25)), 110, 25)


def test_no_regions():
    assert len(regions_of(boxes((LIGHT, 50, 20, 90, 120), (CAR, np.nan, 20, 90, 120)))) == 0
    assert len(regions_of(boxes())) == 0


# -- blur
# ------------------------------------------------------------------------------------------------------------


def test_only_regions_change():
    image = np.random.default_rng(0).integers(0, 256, SHAPE, dtype=np.uint8)
    before = image.copy()
    covered = blurred(
        image,
        Regions(np.array([[49.6, 19.6, 90.4, 50.2]]), np.array([6.0])),
        np.random.default_rng(1),
    )
    assert (image == before).all()
    inside = np.zeros(SHAPE[:2], bool)
    inside[20:51, 50:91] = True
    assert (covered[~inside] == image[~inside]).all()
    assert (covered[inside] != image[inside]).mean() > 0.9


def test_cells_are_flat_and_quantized():
    image = np.random.default_rng(0).integers(0, 256, SHAPE, dtype=np.uint8)
    covered = blurred(
        image,
        Regions(np.array([[-0.5, -0.5, 59.5, 35.5]]), np.array([12.0])),
        np.random.default_rng(1),
    )
    cells = covered[:36, :60].reshape(3, 12, 5, 12, 3)
    assert (cells == cells[:, :1, :, :1]).all()
    assert (covered[:36, :60] % STEP_GREY == STEP_GREY // 2).all()


@pytest.mark.parametrize("waves_per_cell", [0.5, 0.75, 1.0, 1.84, 3.75])
def test_details_smaller_than_a_cell_are_lost(waves_per_cell):
    """The colours of cells hardly depend on the phase of a sine, so that many images reveal no
    details."""
    cell_px, columns = 16, np.arange(12 * 16)
    cells = []
    for phase in np.linspace(0, 2 * np.pi, 12, endpoint=False):
        wave = 127.5 + 120 * np.sin(2 * np.pi * waves_per_cell * columns / cell_px + phase)
        image = np.broadcast_to(
            np.rint(wave)[None, :, None], (4 * cell_px, len(columns), 3)
        ).astype(np.uint8)
        cells.append(cell_colours(image, cell_px)[1, 4:8, 0])
    assert np.ptp(cells, axis=0).max() / 240 < (0.01 if waves_per_cell == 0.5 else 0.005)


def test_noise_is_not_repeatable():
    image = np.full(SHAPE, 120, np.uint8)
    shown = [result(0, (1, PERSON, 50, 20, 90, 119, True))]
    shown[0] = replace(shown[0], frame=replace(shown[0].frame, left=image))
    one, other = (next(iter(anonymized_results(shown, OFFLINE))).frame.left for _ in range(2))
    assert (one != other).any()


@pytest.mark.parametrize(
    "box", [(-50, -50, -10, -10), (190, 100, 400, 300), (-1e6, -1e6, 1e6, 1e6), (5, 5, 5, 5)]
)
def test_regions_beyond_the_image(box):
    image = np.zeros(SHAPE, np.uint8)
    assert (
        blurred(
            image, Regions(np.array([box], float), np.array([1e5])), np.random.default_rng(0)
        ).shape
        == SHAPE
    )


# -- look-ahead
# ------------------------------------------------------------------------------------------------------


def regions_by_frame(results, look_ahead=OFFLINE):
    return [regions for _, regions in with_regions(results, look_ahead)]


def test_results_are_delivered_in_order_without_the_right_image():
    shown = list(anonymized_results((result(k) for k in range(12)), OFFLINE))
    assert [item.index for item in shown] == list(range(12))
    assert all(item.frame.right is None and item.candidates is None for item in shown)


def test_results_held_back_are_bounded():
    n_read = 0

    def results():
        nonlocal n_read
        for k in range(100):
            n_read += 1
            yield result(k, step_s=0.001)

    for index, _ in enumerate(with_regions(results(), LookAhead(time_s=1.0, max_frames=8))):
        assert n_read <= index + 9


def test_live_results_are_not_held_back():
    frames = iter([result(0), result(1)])
    assert next(with_regions(frames, LIVE))[0].index == 0
    assert next(frames).index == 1


def test_track_is_covered_before_its_first_frame():
    results = [
        result(k, *([(1, CAR, 50 + 5 * k, 20, 100 + 5 * k, 60, True)] if k >= 3 else []))
        for k in range(8)
    ]
    regions = regions_by_frame(results)
    assert contains(regions[0], 75, 45)
    assert len(regions_by_frame(results, LIVE)[0]) == 0


def test_gaps_are_interpolated():
    results = [
        result(k, *([(1, CAR, 20 + 10 * k, 20, 60 + 10 * k, 60, True)] if k not in (3, 4) else []))
        for k in range(8)
    ]
    for k in (3, 4):
        assert contains(regions_by_frame(results)[k], 40 + 10 * k, 45)


def test_predicted_boxes_are_covered():
    results = [
        result(0, (1, CAR, 20, 20, 60, 60, True)),
        result(1, (1, CAR, 120, 20, 160, 60, False)),
    ]
    assert contains(regions_by_frame(results)[1], 140, 45)


def test_lost_track_is_covered_for_a_while():
    results = [result(0, (1, CAR, 20, 20, 60, 60, True)), *(result(k) for k in range(1, 12))]
    for look_ahead in (OFFLINE, LIVE):
        regions = regions_by_frame(results, look_ahead)
        assert contains(regions[3], 40, 45)
        assert len(regions[11]) == 0


def test_detections_without_track_are_covered():
    results = [
        result(k, candidates=[(PERSON, 50, 20, 90, 110)] if k == 2 else []) for k in range(6)
    ]
    regions = regions_by_frame(results)
    assert [contains(part, 70, 30) for part in regions] == [False, True, True, True, False, False]
    assert contains(regions_by_frame(results, LIVE)[2], 70, 30)


def test_results_before_an_error_are_delivered():
    def results():
        yield from (result(k) for k in range(3))
        raise tr.errors.UserError("camera lost")

    shown = []
    with pytest.raises(tr.errors.UserError):
        shown.extend(item.index for item in anonymized_results(results(), OFFLINE))
    frames = anonymized_results(results(), OFFLINE)
    assert [next(frames).index for _ in range(3)] == [0, 1, 2]
    with pytest.raises(tr.errors.UserError):
        next(frames)


@pytest.mark.slow
def test_candidates_are_independent_of_the_settings():
    path = find_model(DEFAULT_MODEL).path
    image = np.random.default_rng(0).integers(0, 256, (96, 160, 3), dtype=np.uint8)
    every = open_detector(path, DetectorOptions(min_score="0.001"))
    cars = open_detector(path, DetectorOptions(min_score="0.5", classes=("car",)))
    expected = every.detect(image)
    assert len(cars.detect(image)) == 0
    candidates = cars.candidates(np.full(len(ROAD_CLASSES), 0.001))
    assert len(candidates) > 0
    np.testing.assert_array_equal(candidates.xyxy_px, expected.xyxy_px)
    np.testing.assert_array_equal(candidates.class_id, expected.class_id)


# -- runs
# ------------------------------------------------------------------------------------------------------------

HEAD = (slice(24, 44), slice(70, 90))
"""Head of the person in the film, of the box 60, 20, 100, 110."""


@pytest.fixture(scope="module")
def shared(tmp_path_factory, film):
    """A film with private metadata in a folder with a private name, and boxes of a person in each
    of its frames."""
    folder = tmp_path_factory.mktemp("shared") / "Jane Doe"
    folder.mkdir()
    checks = (np.indices((120, 160)).sum(axis=0) // 4 % 2 * 200 + 20).astype(np.uint8)
    video = film(
        folder / "film.mp4",
        [0.1 * k for k in range(12)],
        images=[np.repeat(checks[:, :, None], 3, axis=2)] * 12,
        metadata={
            "title": "Jane Doe on holiday",
            "artist": "Jane Doe",
            "location": "+48.8577+002.2950/",
            "com.apple.quicktime.location.ISO6709": "+48.8577+002.2950+035.000/",
            "com.apple.quicktime.make": "JanePhone",
        },
        options={"movflags": "use_metadata_tags"},
    )
    with av.open(str(video)) as container:
        assert "48.8577" in str(container.metadata)
    row = "{} 1 Pedestrian 0 0 0 60 20 100 110 -1 -1 -1 -1000 -1000 -1000 -10 0.9\n"
    (folder / "boxes.txt").write_text("".join(row.format(k) for k in range(12)))
    save_rig(kitti_like_rig(width_px=160, height_px=120), folder / "rig.yaml")
    return folder


def options(folder, **others):
    return {"detections": folder / "boxes.txt", "focal_px": 150, "lanes": "off", **others}


def test_settings_without_folders():
    settings = {
        "stereo": ["/drives/a.mp4", ["/drives/b.mp4", "/drives/c.mp4"]],
        "mono": "rtsp://camera/stream",
        "detector": "road",
        "rig": "/drives/rig.yaml",
        "ego_speed": "50",
        "focal_px": 700.0,
    }
    assert without_folders(settings) == {
        "stereo": ["a.mp4", ["b.mp4", "c.mp4"]],
        "mono": "rtsp://camera/stream",
        "detector": "road",
        "rig": "rig.yaml",
        "ego_speed": "50",
        "focal_px": 700.0,
    }


@pytest.mark.slow
def test_results_of_a_run_are_anonymized(shared):
    run = tr.Run.mono(shared / "film.mp4", **options(shared, anonymize=True, overlay=False))
    frames = list(run)
    assert [frame.index for frame in frames] == list(range(12))
    for frame in frames:
        assert np.abs(np.diff(frame.frame.left[HEAD].astype(int), axis=0)).mean() < 10
        assert np.abs(np.diff(frame.frame.left[60:100].astype(int), axis=0)).mean() > 30
        assert not frame.frame.left.flags.writeable
    assert run.summary["inputs"]["mono"] == "film.mp4"
    assert any("Undetected" in note for note in run.summary["notes"])


@pytest.mark.slow
def test_files_contain_neither_folders_nor_metadata(shared, cli, tmp_path):
    out = tmp_path / "out"
    inputs = ("--mono", shared / "film.mp4", "--detections", shared / "boxes.txt", "--lanes", "off")
    formats = ("--write", "csv,mot,parquet,kitti,mcap,rrd", "--mcap-images")
    status, printed, complaint = cli(*inputs, *formats, "--anonymize", "--out", out)
    assert status == 0, complaint
    assert "Undetected" in printed
    assert any(
        "rig.yaml" in note for note in json.loads((out / "summary.json").read_text())["notes"]
    )
    for file in out.iterdir():
        content = file.read_bytes()
        for private in (b"Jane", b"48.8577", str(tmp_path).encode(), b"holiday"):
            assert private not in content, (file.name, private)
    status, _, complaint = cli(
        "export", out, "--to", "yolo", "--images", "--out", tmp_path / "yolo"
    )
    assert status == 2
    assert "anonymized" in complaint
    plain = tmp_path / "plain"
    assert cli(*inputs, "--out", plain)[0] == 0
    assert (plain / "tracks.csv").read_bytes() == (out / "tracks.csv").read_bytes()
    assert str(shared) in (plain / "settings.yaml").read_text()
    for file in plain.glob("*.mp4"):
        assert b"48.8577" not in file.read_bytes()
    with (out / "run.mcap").open("rb") as file:
        messages = [
            message.data
            for _, _, message in make_reader(file).iter_messages(topics=["/camera/image"])
        ]
    assert len(messages) == 12
    for data in messages:
        image = cv2.imdecode(
            np.frombuffer(data[data.index(b"\xff\xd8") :], np.uint8), cv2.IMREAD_GRAYSCALE
        )
        assert np.abs(np.diff(image[HEAD].astype(int), axis=0)).mean() < 12
    contrast = {}
    for folder in (plain, out):
        with av.open(str(folder / "overlay.mp4")) as container:
            images = [
                frame.to_ndarray(format="gray")[HEAD].astype(int)
                for frame in container.decode(video=0)
            ]
        assert len(images) == 12
        contrast[folder] = max(np.abs(np.diff(image[8:], axis=0)).mean() for image in images)
    assert contrast[out] < 0.3 * contrast[plain]
    assert json.loads((out / "summary.json").read_text())["inputs"]["mono"] == "film.mp4"


@pytest.mark.parametrize(
    ("name", "part_fraction", "max_cells"),
    [("person", 0.155, 3.2), ("car", 0.52 / 1.5, 3.0), ("truck", 0.52 / 2.5, 3.0)],
)
def test_cells_are_large_relative_to_what_they_cover(name, part_fraction, max_cells):
    """A head is 0.155 of a person's height; a plate is 0.52 m wide, a car 1.5 m high, a truck at
    least 2.5 m."""
    box = Boxes(
        np.array([[100.0, 100.0, 300.0, 700.0]]), np.array([ROAD_CLASSES.index(name)]), np.zeros(1)
    )
    assert part_fraction * 600.0 / regions_of(box).cell_px[0] <= max_cells


def test_colours_are_quantized():
    image = np.random.default_rng(0).integers(0, 256, (160, 160, 3)).astype(np.uint8)
    regions = Regions(np.array([[-0.5, -0.5, 159.5, 159.5]]), np.array([8.0]))
    assert len(np.unique(blurred(image, regions, np.random.default_rng(1)))) <= 16


def test_settings_require_the_inputs_again(tmp_path, monkeypatch):
    (tmp_path / "drive").mkdir()
    film = tmp_path / "drive" / "film.mp4"
    film.write_bytes(b"-")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    file = tmp_path / "settings.yaml"
    save_settings(settings_from({"mono": film, "anonymize": True}), file)
    with pytest.raises(ConfigError, match=r"settings\.yaml: .*anonymized.*--mono"):
        settings_from({}, file)
    assert settings_from({"mono": film}, file).anonymize
    monkeypatch.chdir(tmp_path / "drive")
    assert settings_from({}, file).mono == Path("film.mp4")


@pytest.mark.slow
def test_classes_that_are_not_tracked_are_covered(shared):
    run = tr.Run.mono(
        shared / "film.mp4", **options(shared, anonymize=True, classes=["car"], overlay=False)
    )
    for frame in run:
        assert len(frame.tracks) == 0
        assert np.abs(np.diff(frame.frame.left[HEAD].astype(int), axis=0)).mean() < 10
