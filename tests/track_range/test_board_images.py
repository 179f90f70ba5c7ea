"""Which images belong to which: patterns, folders and films, of one eye and of two."""

from __future__ import annotations

import os

import cv2
import numpy as np
import pytest

from track_range.calibration.board_images import board_images
from track_range.detection.formats.labelled_images import ImageFileError
from track_range.video.frame import VideoError


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def put(folder, *names):
    folder.mkdir(exist_ok=True, parents=True)
    for name in names:
        cv2.imwrite(str(folder / name), np.full((8, 12, 3), 50, np.uint8))


def names_of(images):
    return [shot.names for shot in images]


def test_a_pattern_in_the_order_of_its_numbers(here):
    put(here, "b10.png", "b2.png", "b1.jpg", "c3.png")
    (here / "b4.txt").write_text("no image")
    images = board_images(["b*.*"])
    assert (images.n_shots, images.is_film) == (3, False)
    assert names_of(images) == [("b1.jpg",), ("b2.png",), ("b10.png",)]
    assert names_of(images) == names_of(images)  # again and again
    assert next(iter(images)).images[0].shape == (8, 12, 3)


def test_a_folder(here):
    put(here / "boards", "x.png", "y.png")
    assert names_of(board_images([str(here / "boards")])) == [("x.png",), ("y.png",)]


def test_an_image_that_is_none_is_told_later(here):
    (here / "b1.png").write_bytes(b"")
    assert next(iter(board_images(["b*.png"]))).images == (None,)


def test_partners_by_what_the_star_stands_for(here):
    put(here, *(f"img{n}_cam{eye}.png" for n in (1, 2, 12) for eye in (0, 1)))
    os.remove("img2_cam1.png")
    images = board_images(["img*_cam0.png", "img*_cam1.png"])
    assert names_of(images) == [("img1_cam0.png", "img1_cam1.png"), ("img12_cam0.png", "img12_cam1.png")]
    assert [(view.name, view.reason) for view in images.left_out] == [
        ("img2_cam0.png", "the other eye's image is missing")
    ]


def test_partners_by_folders_within_a_pattern(here):
    for n in (1, 2):
        put(here / f"day{n}", "l3.png", "r3.png")
    assert len(names_of(board_images(["day*/l?.png", "**/r[0-9].png"]))) == 2


def test_partners_by_name_by_number_and_by_order(here):
    put(here / "left", "a1.png", "a2.png")
    put(here / "right", "a2.png", "a1.png", "a3.png")
    same = board_images(["left", "right"])
    assert names_of(same) == [(f"left/a{n}.png", f"right/a{n}.png") for n in (1, 2)]  # which is which
    assert [view.name for view in same.left_out] == ["right/a3.png"]
    put(here / "r2", "b0002.png", "b0001.png")
    assert names_of(board_images(["left", "r2"])) == [("a1.png", "b0001.png"), ("a2.png", "b0002.png")]
    put(here / "r3", "x.png", "y.png")
    assert names_of(board_images(["left", "r3"])) == [("a1.png", "x.png"), ("a2.png", "y.png")]


def test_a_film_is_looked_at_a_few_times_a_second(here, film):
    film(here / "a.mp4", [i / 10 for i in range(21)])
    images = board_images(["a.mp4"])
    assert images.is_film
    assert [names[0] for names in names_of(images)] == [f"a.mp4 at {t:.2f} s" for t in np.arange(0, 2.1, 0.2)]


def test_two_films_are_paired_by_time(here, film):
    film(here / "l.mp4", [0.0, 0.3, 0.6])
    film(here / "r.mp4", [0.3, 0.6, 0.9])
    assert names_of(board_images(["l.mp4", "r.mp4"])) == [
        ("l.mp4 at 0.30 s", "r.mp4 at 0.30 s"),
        ("l.mp4 at 0.60 s", "r.mp4 at 0.60 s"),
    ]


def test_what_cannot_be_used(here, film):
    put(here / "left", "a1.png", "a2.png")
    put(here / "right", "x.png", "y.png", "z.png")
    (here / "empty").mkdir()
    (here / "text.txt").write_text("no film")
    film(here / "a.mp4", [0.0])
    for sources, error, said in (
        (["none*.png"], ImageFileError, "no image has such a name; give a pattern"),
        (["none"], ImageFileError, "there is no such file or folder; give a pattern"),
        (["empty"], ImageFileError, "no images"),
        (["left/a1.png"], ImageFileError, "one image is no set"),
        (["left", "right"], ImageFileError, "left has 2 images and right 3, and their names do not tell which belong"),
        (["left", "a.mp4"], ImageFileError, "give two videos, or two sets of images"),
        (["text.txt"], VideoError, "text.txt"),
    ):
        with pytest.raises(error) as raised:
            board_images(sources)
        assert said in str(raised.value)
