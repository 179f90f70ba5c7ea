"""Videos and folders of images that change while a run reads them: the finished frames are kept,
the status is 1."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from track_range.recording.pairs.recorded_pair import RecordedPair
from track_range.recording.sources.open_video import open_video
from track_range.recording.video.frame import VideoError
from track_range.run.run import Run

Film = Callable[..., Path]
Level = Callable[..., np.ndarray]

N_FRAMES = 24


@pytest.fixture
def noise(tmp_path: Path, film: Film) -> Path:
    """A video of which FFmpeg has read only a part after the first frames."""
    return noisy_film(tmp_path / "film.mkv", film)


def noisy_film(path: Path, film: Film, seed: int = 0) -> Path:
    images = np.random.default_rng(seed).integers(0, 255, (N_FRAMES, 96, 128, 3)).astype(np.uint8)
    return film(
        path, [number / 10 for number in range(N_FRAMES)], images=list(images), codec="mjpeg"
    )


def shortened(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def replaced(path: Path) -> None:
    other = path.with_name("other.part")
    other.write_bytes(path.read_bytes()[::-1])
    other.replace(path)


def overwritten(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[:4096] + content[4096:][::-1])


CHANGES = [shortened, replaced, overwritten]


@pytest.mark.slow
def test_finished_frames_are_kept(tmp_path: Path, noise: Path) -> None:
    detections = tmp_path / "detections.txt"
    detections.write_text(
        "".join(f"{frame},-1,20,20,40,40,0.9,1,1\n" for frame in range(1, N_FRAMES + 1)),
        encoding="ascii",
    )
    out = tmp_path / "out"
    run = Run.mono(noise, detections=detections, out=out, focal_px=100, overlay=False, lanes="off")
    results = iter(run)
    frames = [next(results).frame.index, next(results).frame.index]
    shortened(noise)
    with pytest.raises(VideoError, match=r"film\.mkv: .*shortened") as error:
        frames.extend(result.frame.index for result in results)
    assert len(str(error.value)) < 300 + len(str(noise))
    assert frames[:5] == [0, 1, 2, 3, 4]
    rows = (out / "tracks.csv").read_text(encoding="utf-8").splitlines()
    assert rows[-1].startswith(f"{frames[-1]},")
    assert json.loads((out / "summary.json").read_text(encoding="utf-8"))["frames"] == len(frames)


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("side", ["left", "right"])
def test_changed_video_of_a_pair(
    tmp_path: Path, film: Film, change: Callable[[Path], None], side: str
) -> None:
    paths = {name: noisy_film(tmp_path / f"{name}.mkv", film) for name in ("left", "right")}
    pairs = iter(RecordedPair(open_video(paths["left"]), open_video(paths["right"])))
    indices = [next(pairs)[0].index]
    change(paths[side])
    with pytest.raises(VideoError, match=rf"{side}\.mkv: .*while it was read"):
        indices.extend(left.index for left, _ in pairs)
    assert indices == list(range(max(2, len(indices))))


def test_deleted_video_is_read_to_its_end(noise: Path) -> None:
    reader = open_video(noise)
    frames = iter(reader)
    next(frames)
    noise.unlink()
    assert len(list(frames)) == N_FRAMES - 1


def test_growing_video_is_noted(noise: Path) -> None:
    reader = open_video(noise)
    frames = iter(reader)
    next(frames)
    with noise.open("ab") as file:
        file.write(bytes(20_000))
    assert len(list(frames)) == N_FRAMES - 1
    assert any("grew" in note for note in reader.notes)


def test_touched_video_is_unchanged(noise: Path) -> None:
    reader = open_video(noise)
    frames = iter(reader)
    next(frames)
    os.utime(noise, ns=(0, 0))
    copy = noise.with_name("copy.mkv")
    shutil.copy(noise, copy)
    copy.replace(noise)
    assert len(list(frames)) == N_FRAMES - 1
    assert reader.notes == ()


def test_video_replaced_before_the_second_reading(noise: Path) -> None:
    reader = open_video(noise)
    assert len(list(reader)) == N_FRAMES
    replaced(noise)
    with pytest.raises(VideoError, match="replaced"):
        next(iter(reader))


@pytest.fixture
def folder(tmp_path: Path, level: Level) -> Path:
    folder = tmp_path / "images"
    folder.mkdir()
    for number in range(4):
        write_image(folder / f"{number:06}.bmp", level(number))
    return folder


def write_image(path: Path, image: np.ndarray) -> None:
    assert cv2.imwrite(str(path), image)


def after_two_images(folder: Path, change: Callable[[], None]) -> list[int]:
    frames = iter(open_video(folder))
    indices = [next(frames).index, next(frames).index]
    change()
    indices.extend(frame.index for frame in frames)
    return indices


def test_deleted_image(folder: Path) -> None:
    with pytest.raises(VideoError, match=r"000003\.bmp: .*deleted"):
        after_two_images(folder, (folder / "000003.bmp").unlink)
    assert after_two_images(folder, (folder / "000000.bmp").unlink) == [0, 1, 2]


@pytest.mark.parametrize("number", [0, 3])
def test_overwritten_image(folder: Path, level: Level, number: int) -> None:
    image = folder / f"{number:06}.bmp"
    os.utime(image, ns=(0, 0))
    with pytest.raises(VideoError, match=rf"{image.name}: .*overwritten"):
        after_two_images(folder, lambda: write_image(image, level(9)))


def test_shortened_image(folder: Path) -> None:
    with pytest.raises(VideoError, match=r"000003\.bmp: "):
        after_two_images(folder, lambda: os.truncate(folder / "000003.bmp", 100))
