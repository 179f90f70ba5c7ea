"""Tests of one recording with the images of two cameras: the frames must be those of two
recordings."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.recordings import recording_files
from tests.support.recordings.live_servers import cameras
from tests.support.recordings.recording_files import (
    PACKED,
    Pair,
    box,
    with_box,
    write_folder,
    write_video,
)
from tests.track_range.recording.bag_writers import write_foxglove
from track_range.foundation.errors import UsageError
from track_range.recording.pairs.packed_pair import PackedPair
from track_range.recording.pairs.stereo_layout import has_second_view, matching_halves
from track_range.recording.recording import open_recording
from track_range.recording.sources.names import Half
from track_range.recording.sources.open_video import open_video
from track_range.recording.video.frame import VideoError
from track_range.run.options.precedence import settings_from
from track_range.run.options.settings_file import save_settings
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rig import RigError, StereoRig

WIDTH_PX, HEIGHT_PX = 320, 160
RIG = StereoRig.rectified(PinholeCamera(300.0, 300.0, 159.5, 79.5, WIDTH_PX, HEIGHT_PX), 0.5)


def road_images(sign: int, n: int = 3) -> list[np.ndarray]:
    """Images of a moving wall with coarse and fine noise, and of a road on which disparities grow
    downwards."""
    noise = np.random.default_rng(0).integers(0, 255, (HEIGHT_PX, 700, 3), np.uint8)
    coarse = cv2.resize(noise[:8, :35], (700, HEIGHT_PX), interpolation=cv2.INTER_CUBIC)
    wall = (
        cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX) // 2
        + coarse // 2
    )
    shift_px = 100 + sign * np.round(
        4 + 0.1 * np.maximum(np.arange(HEIGHT_PX) - HEIGHT_PX / 2, 0)
    ).astype(int)
    return [
        np.stack(
            [
                row[s : s + WIDTH_PX]
                for row, s in zip(wall, (shift_px + 3 * number).tolist(), strict=True)
            ]
        )
        for number in range(n)
    ]


LEFT, RIGHT = road_images(-1), road_images(1)


def packed(layout: str, n: int = 3) -> list[np.ndarray]:
    return recording_files.packed(layout, Pair(LEFT[:n], RIGHT[:n]))


def frames_of(*names: object, **options: object) -> list[Frame]:
    recording = open_recording(*names, **{"rig": RIG, "align": "off", **options})  # type: ignore[arg-type]
    frames = list(recording.frames)
    assert frames
    return frames


def assert_equal(frames: Sequence[Frame], others: Sequence[Frame]) -> None:
    assert [(a.index, a.time_s) for a in frames] == [(b.index, b.time_s) for b in others]
    for one, other in zip(frames, others, strict=True):
        assert one.right is not None
        assert other.right is not None
        assert np.array_equal(one.left, other.left)
        assert np.array_equal(whole_image(one.right), whole_image(other.right))


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> list[Frame]:
    """The frames of two folders."""
    folder = tmp_path_factory.mktemp("two")
    return frames_of(write_folder(folder / "left", LEFT), write_folder(folder / "right", RIGHT))


@pytest.mark.parametrize("layout", PACKED)
@pytest.mark.parametrize("option", ["given", "auto"])
def test_frames_of_a_folder_are_those_of_two(
    tmp_path: Path, two: list[Frame], layout: str, option: str
) -> None:
    folder = write_folder(tmp_path / "both", packed(layout))
    recording = open_recording(
        folder, rig=RIG, align="off", stereo_layout=layout if option == "given" else "auto"
    )
    assert isinstance(recording.pair, PackedPair)
    assert (recording.size_px, recording.n_frames, recording.fps) == (
        (WIDTH_PX, HEIGHT_PX),
        3,
        10.0,
    )
    assert recording.sync is not None
    assert_equal(list(recording.frames), two)
    assert any(
        "as given" in note if option == "given" else "matching points" in note
        for note in recording.notes
    )


def test_part_of_a_recording(tmp_path: Path, two: list[Frame]) -> None:
    folder = write_folder(tmp_path / "both", packed("side-by-side"))
    (frame,) = frames_of(folder, folder, stereo_layout="auto", start_s=0.1, duration_s=0.1)
    assert (frame.index, frame.time_s) == (1, pytest.approx(0.1))
    assert np.array_equal(frame.left, two[1].left)


@pytest.mark.parametrize(("layout", "squeeze"), [("side-by-side", (2, 1)), ("top-bottom", (1, 2))])
def test_squeezed_images_are_recognised_by_the_rig(
    tmp_path: Path, layout: str, squeeze: tuple[int, int]
) -> None:
    size_px = WIDTH_PX // squeeze[0], HEIGHT_PX // squeeze[1]
    small = [
        [cv2.resize(im, size_px, interpolation=cv2.INTER_AREA) for im in images]
        for images in (LEFT, RIGHT)
    ]
    folder = write_folder(
        tmp_path / "half", [PACKED[layout](*pair) for pair in zip(*small, strict=True)]
    )
    recording = open_recording(folder, rig=RIG, align="off", stereo_layout=layout)  # type: ignore[arg-type]
    assert recording.size_px == (WIDTH_PX, HEIGHT_PX)
    assert recording.rig is not None
    assert recording.rig.left.fx_px == pytest.approx(300.0, rel=1e-3)
    frame = next(recording.frames)
    assert np.abs(frame.left.astype(int) - LEFT[0]).mean() < 25  # a wrong half or aspect gives 60


def test_tracks_of_a_file(tmp_path: Path) -> None:
    both = write_video(tmp_path / "both.mkv", [LEFT, RIGHT])
    left, right = write_video(tmp_path / "l.mkv", [LEFT]), write_video(tmp_path / "r.mkv", [RIGHT])
    for layout in ("auto", "tracks"):
        assert_equal(frames_of(both, stereo_layout=layout), frames_of(left, right))


def test_tracks_that_are_missing(tmp_path: Path) -> None:
    path = write_video(tmp_path / "one.mkv", [LEFT])
    with pytest.raises(VideoError, match=r"one\.mkv: .*320x160"):
        open_recording(path, stereo_layout="tracks")


def test_both_cameras_in_a_chosen_track(tmp_path: Path) -> None:
    both = write_video(tmp_path / "both.mkv", [packed("top-bottom"), packed("side-by-side")])
    one = write_video(tmp_path / "one.mkv", [packed("side-by-side")])
    chosen = frames_of(both, stereo_layout="side-by-side", track=1)
    assert_equal(chosen, frames_of(one, stereo_layout="side-by-side"))
    with pytest.raises(VideoError, match="two video tracks of equal size, found none"):
        open_recording(both, stereo_layout="tracks", track=1)


def test_pairs_read_ahead_are_those_read_later(tmp_path: Path) -> None:
    both = write_video(tmp_path / "both.mkv", [packed("right-left")])
    pair = PackedPair(open_video(both), both, "right-left")
    with closing(pair.read_ahead()) as ahead:
        first = list(itertools.islice(ahead, 2))
    later = list(pair)
    assert len(later) == 3
    for early, late, images in zip(first, later, zip(LEFT, RIGHT, strict=True), strict=False):
        for one, other, image in zip(early, late, images, strict=True):
            assert (one.index, one.time_s) == (other.index, other.time_s)
            assert np.array_equal(one.image, other.image)
            assert np.abs(one.image.astype(int) - image).mean() < 3
        assert late[0].image.base is late[1].image.base is not None


@pytest.mark.parametrize(
    ("name", "stereo_mode", "options", "layout"),
    [
        ("both.mkv", "right_left", {}, "right-left"),
        ("both.mkv", "bottom_top", {}, "bottom-top"),
        ("drive_SBS.mp4", "", {}, "side-by-side"),
        ("drive.OU.mp4", "", {}, "top-bottom"),
        ("both.mp4", "", {"x264-params": "frame-packing=3"}, "side-by-side"),
        ("both.mp4", "", {"x264-params": "frame-packing=4"}, "top-bottom"),
    ],
)
def test_stated_layouts(
    tmp_path: Path, name: str, stereo_mode: str, options: dict[str, str], layout: str
) -> None:
    grey = np.full((160, 320, 3), 90, np.uint8)  # nothing to match
    path = write_video(tmp_path / name, [[grey] * 2], stereo_mode=stereo_mode, options=options)
    recording = open_recording(path, stereo_layout="auto", focal_px=300.0)
    assert isinstance(recording.videos[0].path, Half)
    assert recording.videos[0].path.layout == layout
    assert any("states" in note for note in recording.notes)
    recording.close()


@pytest.mark.parametrize(
    ("added", "layout"),
    [
        # Google's Spherical Video V2: version and flags 0, then 1 = top-bottom, 2 = left-right
        (box(b"st3d", bytes([0, 0, 0, 0, 1])), "top-bottom"),
        (box(b"st3d", bytes([0, 0, 0, 0, 2])), "side-by-side"),
        # Apple's video extended usage: both eyes, packed "side" by side or "over" and under
        *(
            (
                box(
                    b"vexu",
                    box(b"eyes", box(b"stri", bytes([0, 0, 0, 0, 3])))
                    + box(b"pack", box(b"pkin", bytes(4) + kind)),
                ),
                layout,
            )
            for kind, layout in ((b"side", "side-by-side"), (b"over", "top-bottom"))
        ),
    ],
)
def test_layouts_in_boxes_of_mp4(tmp_path: Path, added: bytes, layout: str) -> None:
    grey = [np.full((160, 320, 3), 90, np.uint8)] * 2
    assert (
        open_video(with_box(write_video(tmp_path / "both.mp4", [grey]), added)).stated_layout
        == layout
    )


def test_second_view_of_spatial_video(tmp_path: Path) -> None:
    path = write_video(tmp_path / "both.mp4", [LEFT])
    assert not has_second_view(path)
    assert has_second_view(with_box(path, box(b"lhvC", bytes([1, 0xF0, 0, 0xFC, 0xCB, 0]))))
    assert not has_second_view(tmp_path)


def test_images_of_one_camera_are_refused(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "left", LEFT)
    with pytest.raises(VideoError, match=r"left: .*--stereo-layout.*--mono"):
        open_recording(folder, stereo_layout="auto")


def test_swapped_halves_are_an_error(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "both", packed("right-left", 1) * 3)
    with pytest.raises(RigError, match=r"swapped.*--stereo-layout"):
        open_recording(folder, rig=RIG, stereo_layout="side-by-side")


def test_one_camera_that_looks_like_two(tmp_path: Path) -> None:
    (note,) = open_recording(write_folder(tmp_path / "both", packed("top-bottom"))).layout_notes
    assert f"--stereo {tmp_path / 'both'} --stereo-layout top-bottom" in note
    assert open_recording(write_folder(tmp_path / "left", LEFT)).layout_notes == ()


@pytest.mark.parametrize("stack", [np.hstack, np.vstack])
def test_unlike_and_mirrored_halves_are_one_image(stack: Callable[..., np.ndarray]) -> None:
    left = LEFT[0]
    other = np.ascontiguousarray(left[:, ::-1])
    for second in (other, left[::-1], np.roll(left, (80, 160), (0, 1))):
        assert matching_halves([stack((left, second))]) is None


def test_largest_track_is_used(tmp_path: Path) -> None:
    preview = [cv2.resize(image, (80, 40)) for image in LEFT]
    path = write_video(tmp_path / "drive.mp4", [preview, LEFT])
    video = open_video(path)
    assert (video.width_px, video.height_px) == (WIDTH_PX, HEIGHT_PX)
    assert np.abs(next(iter(video)).image.astype(int) - LEFT[0]).max() < 12
    assert any(
        "track 0 (80x40 px) is left out" in note and "--track" in note for note in video.notes
    )
    chosen = open_video(path, track=0)
    assert (chosen.width_px, chosen.height_px, chosen.notes) == (80, 40, ())
    assert open_recording(path, track=0).videos[0].width_px == 80
    with pytest.raises(VideoError, match=r"drive\.mp4: .* 2.*--track"):
        open_video(path, track=2)


def test_several_files(tmp_path: Path, two: list[Frame]) -> None:
    images = packed("side-by-side")
    paths = [write_video(tmp_path / f"{n}.mkv", [[image] * 2]) for n, image in enumerate(images)]
    frames = frames_of(paths, stereo_layout="side-by-side")
    assert [frame.index for frame in frames] == list(range(6))
    assert np.abs(frames[4].left.astype(int) - two[2].left).mean() < 3


def test_topic_of_a_bag(tmp_path: Path) -> None:
    images = packed("side-by-side")
    bag = write_foxglove(tmp_path / "drive.mcap", ["/both"], images)
    frames = frames_of(bag, stereo_layout="auto")
    assert len(frames) == 3
    assert [frame.left.shape for frame in frames] == [(HEIGHT_PX, WIDTH_PX, 3)] * 3


@pytest.mark.parametrize("layout", ["side-by-side", "bottom-top"])
def test_live_source(layout: str) -> None:
    with cameras(1, 120) as (camera,):
        recording = open_recording(camera.url, focal_px=50.0, stereo_layout=layout)  # type: ignore[arg-type]
        assert recording.live is not None
        frames = list(itertools.islice(recording.frames, 4))
        recording.close()
    assert recording.size_px == ((32, 48) if layout == "side-by-side" else (64, 24))
    assert (np.diff([frame.index for frame in frames]) > 0).all()
    assert all(frame.time_s >= 0 for frame in frames)


def test_settings(tmp_path: Path) -> None:
    path = write_video(tmp_path / "both.mp4", [packed("side-by-side")])
    settings = settings_from({"stereo": str(path), "stereo_layout": "side-by-side"})
    save_settings(settings, tmp_path / "settings.yaml")
    again = settings_from({}, tmp_path / "settings.yaml")
    assert (again.stereo, again.stereo_layout) == ((path, path), "side-by-side")
    assert again.out_dir == Path("both-track-range")
    camera = settings_from({"stereo": "0", "stereo_layout": "side-by-side"})
    assert camera.has_both_in_one
    for given in (
        {"stereo": ("a.mp4", "b.mp4"), "stereo_layout": "tracks"},
        {"mono": "a.mp4", "stereo_layout": "auto"},
        {"stereo": "a.mp4", "track": 1},
        {"stereo": "a.mp4", "stereo_layout": "diagonal"},
    ):
        with pytest.raises(UsageError, match=r"layout|track"):
            settings_from(given)
