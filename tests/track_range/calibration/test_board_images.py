"""Tests of the sources of board images (patterns, folders, videos) and of the pairing of left and
right."""

from __future__ import annotations

import os

import cv2
import numpy as np
import pytest

from track_range.calibration.board_images import board_images
from track_range.detection.formats.image_labels.labelled_images import ImageFileError
from track_range.recording.video.frame import VideoError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A temporary folder, which is the working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write_images(folder, *names):
    folder.mkdir(exist_ok=True, parents=True)
    for name in names:
        cv2.imwrite(str(folder / name), np.full((8, 12, 3), 50, np.uint8))


def names_of(images):
    return [shot.names for shot in images]


def test_pattern_is_sorted_by_number(folder):
    write_images(folder, "b10.png", "b2.png", "b1.jpg", "c3.png")
    (folder / "b4.txt").write_text("no image")
    images = board_images(["b*.*"])
    assert (images.n_shots, images.is_video) == (3, False)
    assert names_of(images) == [("b1.jpg",), ("b2.png",), ("b10.png",)]
    assert names_of(images) == names_of(images)  # can be iterated twice
    assert next(iter(images)).images[0].shape == (8, 12, 3)


def test_folder(folder):
    write_images(folder / "boards", "x.png", "y.png")
    assert names_of(board_images([str(folder / "boards")])) == [("x.png",), ("y.png",)]


def test_unreadable_image_is_none(folder):
    (folder / "b1.png").write_bytes(b"")
    assert next(iter(board_images(["b*.png"]))).images == (None,)


def test_pairs_by_wildcard(folder):
    write_images(folder, *(f"img{n}_cam{camera}.png" for n in (1, 2, 12) for camera in (0, 1)))
    os.remove("img2_cam1.png")
    images = board_images(["img*_cam0.png", "img*_cam1.png"])
    assert names_of(images) == [
        ("img1_cam0.png", "img1_cam1.png"),
        ("img12_cam0.png", "img12_cam1.png"),
    ]
    (view,) = images.unpaired
    assert view.name == "img2_cam0.png"
    assert "missing" in view.reason


def test_pairs_by_folder_in_a_pattern(folder):
    for n in (1, 2):
        write_images(folder / f"day{n}", "l3.png", "r3.png")
    assert len(names_of(board_images(["day*/l?.png", "**/r[0-9].png"]))) == 2


def test_pairs_by_name_number_and_order(folder):
    write_images(folder / "left", "a1.png", "a2.png")
    write_images(folder / "right", "a2.png", "a1.png", "a3.png")
    same = board_images(["left", "right"])
    assert names_of(same) == [
        (f"left/a{n}.png", f"right/a{n}.png") for n in (1, 2)
    ]  # with folder, since names are equal
    assert [view.name for view in same.unpaired] == ["right/a3.png"]
    write_images(folder / "r2", "b0002.png", "b0001.png")
    assert names_of(board_images(["left", "r2"])) == [
        ("a1.png", "b0001.png"),
        ("a2.png", "b0002.png"),
    ]
    write_images(folder / "r3", "x.png", "y.png")
    assert names_of(board_images(["left", "r3"])) == [("a1.png", "x.png"), ("a2.png", "y.png")]


def test_video_is_sampled_five_times_per_second(folder, film):
    film(folder / "a.mp4", [i / 10 for i in range(21)])
    images = board_images(["a.mp4"])
    assert images.is_video
    assert [names[0] for names in names_of(images)] == [
        f"a.mp4 at {t:.2f} s" for t in np.arange(0, 2.1, 0.2)
    ]


def test_two_videos_are_paired_by_time(folder, film):
    film(folder / "l.mp4", [0.0, 0.3, 0.6])
    film(folder / "r.mp4", [0.3, 0.6, 0.9])
    assert names_of(board_images(["l.mp4", "r.mp4"])) == [
        ("l.mp4 at 0.30 s", "r.mp4 at 0.30 s"),
        ("l.mp4 at 0.60 s", "r.mp4 at 0.60 s"),
    ]


def test_unusable_sources(folder, film):
    write_images(folder / "left", "a1.png", "a2.png")
    write_images(folder / "right", "x.png", "y.png", "z.png")
    (folder / "empty").mkdir()
    (folder / "text.txt").write_text("not a video")
    film(folder / "a.mp4", [0.0])
    for sources, error, word in (
        (["none*.png"], ImageFileError, "name"),
        (["none"], ImageFileError, "no such file"),
        (["empty"], ImageFileError, "images"),
        (["left/a1.png"], ImageFileError, "several images"),
        (["left", "right"], ImageFileError, "paired"),
        (["left", "a.mp4"], ImageFileError, "two videos"),
        (["text.txt"], VideoError, "video"),
    ):
        with pytest.raises(error, match=word) as raised:
            board_images(sources)
        assert str(raised.value).startswith(sources[0])


def halves(seed=0, size_px=(96, 40)):
    """Two images of noise of one size."""
    generator = np.random.default_rng(seed)
    return [generator.integers(0, 255, (size_px[1], size_px[0], 3), np.uint8) for _ in range(2)]


@pytest.mark.parametrize(
    ("given", "stack", "order"),
    [
        ("auto", np.hstack, (0, 1)),
        ("right-left", np.hstack, (1, 0)),
        ("top-bottom", np.vstack, (0, 1)),
    ],
)
def test_images_of_both_cameras_in_each_file(folder, given, stack, order):
    images = halves()
    cv2.imwrite("b1.png", stack(images))
    (shot,) = board_images(["b*.png", "b*.png"], given)
    assert shot.names == ("b1.png", "b1.png")
    for found, number in zip(shot.images, order, strict=True):
        assert (found == images[number]).all()


def test_images_of_unknown_layout(folder):
    cv2.imwrite("b1.png", np.vstack(halves()))
    with pytest.raises(ImageFileError, match=r"b\*\.png: .*--stereo-layout"):
        board_images(["b*.png", "b*.png"])


def test_video_of_both_cameras(folder, film):
    left, right = (np.full((48, 64, 3), level, np.uint8) for level in (60, 180))
    film(folder / "both.mp4", [0, 0.5], images=[np.hstack((left, right))] * 2)
    images = board_images(["both.mp4", "both.mp4"], "side-by-side")
    shots = list(images)
    assert [shot.names for shot in shots] == [
        ("both.mp4 at 0.00 s",) * 2,
        ("both.mp4 at 0.50 s",) * 2,
    ]
    assert [round(float(image.mean()), -1) for image in shots[1].images] == [60, 180]
