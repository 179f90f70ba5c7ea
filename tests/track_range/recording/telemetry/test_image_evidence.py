"""Motion of the images before a run: pairs at key frames, and the limit of its cost."""

from dataclasses import replace
from fractions import Fraction

import av
import cv2
import numpy as np
import pytest

from track_range.recording.telemetry.image_evidence import motion_of
from track_range.stereo.geometry.camera import PinholeCamera

WIDTH_PX, HEIGHT_PX, FPS, N = 320, 240, 15, 105
CAMERA = PinholeCamera(300.0, 300.0, 159.5, 119.5, WIDTH_PX, HEIGHT_PX)
EXPANSION_HZ = 0.3


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Writes a video of 7 s that zooms by 0.3 per second, with a number of frames between key
    frames."""
    noise = np.random.default_rng(0).integers(0, 255, (60, 80), np.uint8)
    scene = cv2.resize(noise, (8 * WIDTH_PX, 8 * HEIGHT_PX), interpolation=cv2.INTER_CUBIC)

    def write(gop, codec="libx264"):
        path = tmp_path_factory.mktemp("video") / f"{gop}.mp4"
        with av.open(str(path), "w") as container:
            stream = container.add_stream(codec, rate=FPS)
            stream.width, stream.height, stream.pix_fmt = WIDTH_PX, HEIGHT_PX, "yuv420p"
            stream.time_base, stream.gop_size = Fraction(1, FPS), gop
            for i in range(N):
                scale = 0.25 * np.exp(EXPANSION_HZ * i / FPS)
                middle = np.array(
                    [
                        [scale, 0, 159.5 - scale * 4 * WIDTH_PX],
                        [0, scale, 119.5 - scale * 4 * HEIGHT_PX],
                    ]
                )
                image = cv2.warpAffine(scene, middle, (WIDTH_PX, HEIGHT_PX), flags=cv2.INTER_AREA)
                container.mux(
                    stream.encode(
                        av.VideoFrame.from_ndarray(image, format="gray").reformat(format="yuv420p")
                    )
                )
            container.mux(stream.encode())
        return path

    return write


@pytest.mark.parametrize(("gop", "n"), [(5, 41), (60, 52)])
def test_expansion_from_pairs_and_from_all_frames(written, gop, n):
    motion = motion_of(written(gop), CAMERA, start_s=0.0)
    assert abs(len(motion.time_s) - n) <= 1
    assert np.median(motion.expansion_hz) == pytest.approx(EXPANSION_HZ, rel=0.15)
    assert np.abs(np.median(motion.yaw_rad_s)) < 0.1
    assert not motion.is_still.any()
    assert (np.diff(motion.time_s) > 0).all()


def test_part_of_a_video(written):
    motion = motion_of(written(15), CAMERA, start_s=3.0, span_s=2.0)
    assert motion.time_s[0] == pytest.approx(3.07, abs=0.01)
    assert motion.time_s[-1] < 5.0


@pytest.mark.parametrize("gop", [5, 60])
def test_large_images_are_read_in_part(written, gop):
    motion = motion_of(written(gop), CAMERA, start_s=0.0, max_images=10)
    assert 0 < len(motion.time_s) <= 10


def test_unreadable_video_has_no_motion(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"no video")
    camera = replace(CAMERA)
    assert len(motion_of(tmp_path / "a.mp4", camera, start_s=0.0).time_s) == 0
