"""Clips of events: their frames, durations and names, and overlays that cannot be cut."""

from fractions import Fraction

import av
import numpy as np
import pytest

import track_range as tr
from tests.support.results.events import SeenFinder, event
from tests.support.results.run_folder import write_run
from track_range.foundation.errors import UsageError
from track_range.foundation.files.output_files import OutputError
from track_range.recording.video.frame import VideoError
from track_range.results.events.event import clip_name
from track_range.results.events.files import write_event_files
from track_range.views.report.run_folders import report
from track_range.views.videos.event_clips import clip_interval_s, cut_clip, frame_at, write_clips
from track_range.views.videos.result_video import QUANTIZER
from track_range.views.videos.video_writer import VideoWriter

FPS, N_FRAMES = 10.0, 60
BAR_PX = 4
"""Width of the white bar per frame number, by which a clip's frames are recognised."""


@pytest.fixture(scope="module")
def overlay(tmp_path_factory):
    """A video of 6 s with a keyframe every second, as overlay.mp4 of a run."""
    path = tmp_path_factory.mktemp("run") / "overlay.mp4"
    with VideoWriter(path, width_px=256, height_px=48, fps=FPS, quantizer=QUANTIZER) as writer:
        for number in range(N_FRAMES):
            image = np.zeros((48, 256, 3), np.uint8)
            image[:, : BAR_PX * number] = 255
            writer.write(image, 1.0 + number / FPS)
    return path


def frames_of(path):
    """Numbers of the overlay's frames in a clip, their times, and the duration of the clip in
    seconds."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        duration_s = float(stream.duration * stream.time_base)
        frames = list(container.decode(stream))
    numbers = [
        round((frame.to_ndarray(format="gray")[24] > 127).sum() / BAR_PX) for frame in frames
    ]
    return numbers, [float(frame.pts * frame.time_base) for frame in frames], duration_s


@pytest.mark.parametrize(("time_s", "number"), [(0.0, 0), (2.3, 23), (5.9, 59)])
def test_frame_at_a_time(overlay, time_s, number):
    assert round((frame_at(overlay, time_s)[24, :, 0] > 127).sum() / BAR_PX) == number


def test_no_frame_after_the_end_or_of_a_damaged_video(overlay, tmp_path):
    assert frame_at(overlay, 7.0) is None
    (tmp_path / "overlay.mp4").write_bytes(b"damaged")
    assert frame_at(tmp_path / "overlay.mp4", 0.0) is None


def packets_of(path):
    with av.open(str(path)) as container:
        return [bytes(packet) for packet in container.demux(video=0) if packet.pts is not None]


@pytest.mark.parametrize(
    ("start_s", "end_s", "first", "last"),
    [
        (0.0, 1.0, 0, 10),
        (2.0, 3.5, 20, 35),  # starts at a keyframe
        (2.3, 4.1, 23, 41),
        (2.35, 2.65, 24, 26),  # without a keyframe
        (-2.0, 0.5, 0, 5),
        (5.5, 9.0, 55, 59),
    ],
)
def test_frames_and_duration(overlay, tmp_path, start_s, end_s, first, last):
    path = tmp_path / "clip.mp4"
    assert cut_clip(overlay, path, start_s, end_s)
    numbers, times_s, duration_s = frames_of(path)
    assert numbers == list(range(first, last + 1))
    assert times_s == pytest.approx([i / FPS for i in range(len(numbers))], abs=1e-4)
    assert duration_s == pytest.approx(len(numbers) / FPS, abs=1e-3)
    assert list(tmp_path.iterdir()) == [path]


def test_packets_are_copied_from_the_first_keyframe(overlay, tmp_path):
    cut_clip(overlay, tmp_path / "clip.mp4", 2.3, 4.1)
    assert packets_of(tmp_path / "clip.mp4")[7:] == packets_of(overlay)[30:42]


def test_index_comes_first(overlay, tmp_path):
    cut_clip(overlay, tmp_path / "clip.mp4", 2.3, 4.1)
    content = (tmp_path / "clip.mp4").read_bytes()
    assert 0 < content.index(b"moov") < content.index(b"mdat")


def test_other_encoder(overlay, tmp_path):
    other = tmp_path / "other.mp4"
    with av.open(str(overlay)) as source, av.open(str(other), "w") as target:
        stream = target.add_stream(
            "libx264", rate=10, options={"profile": "baseline", "g": "10", "crf": "10"}
        )
        stream.width, stream.height, stream.pix_fmt = 256, 48, "yuv420p"
        for number, frame in enumerate(source.decode(video=0)):
            frame.pts, frame.time_base = number, Fraction(1, 10)
            target.mux(stream.encode(frame))
        target.mux(stream.encode())
    cut_clip(other, tmp_path / "clip.mp4", 2.3, 4.1)
    numbers, _, duration_s = frames_of(tmp_path / "clip.mp4")
    assert numbers == list(range(23, 42))
    assert duration_s == pytest.approx(1.9, abs=1e-3)


@pytest.mark.parametrize(("start_s", "end_s"), [(7.0, 9.0), (-5.0, -1.0)])
def test_time_without_frames(overlay, tmp_path, start_s, end_s):
    assert not cut_clip(overlay, tmp_path / "clip.mp4", start_s, end_s)
    assert list(tmp_path.iterdir()) == []


def test_clips_of_events(overlay, tmp_path):
    events = [
        event(start_s=4.6, end_s=4.8),
        event(kind="cut_in", start_s=1.0, end_s=2.0),
        event(start_s=99, end_s=99),
    ]
    written = write_clips(overlay, events, tmp_path / "clips", starts_s=1.0)
    assert [path.name for path in written] == ["01-forward_collision-7.mp4", "02-cut_in-7.mp4"]
    assert [frames_of(path)[0] for path in written] == [list(range(6, 59)), list(range(31))]
    (tmp_path / "clips" / "01-own-7.mp4").touch()
    (tmp_path / "clips" / ".02-cut_in-7.mp4.x_1").mkdir()  # of a run that was killed
    assert write_clips(overlay, (), tmp_path / "clips", starts_s=1.0) == ()
    assert [path.name for path in (tmp_path / "clips").iterdir()] == ["01-own-7.mp4"]


def test_interval_of_a_long_event():
    assert clip_interval_s(event(start_s=10, end_s=12)) == (7, 14)
    assert clip_interval_s(event(start_s=10, peak_s=100, end_s=200)) == (80, 110)
    assert clip_interval_s(event(start_s=10, peak_s=10, end_s=200)) == (7, 37)
    assert clip_interval_s(event(start_s=10, peak_s=200, end_s=200)) == (172, 202)
    assert clip_name(123, "cut_in", 7) == "123-cut_in-7.mp4"


def test_overlay_that_cannot_be_cut(tmp_path):
    with pytest.raises(VideoError, match=r"overlay.mp4: no such file.*--no-overlay"):
        write_clips(tmp_path / "overlay.mp4", [event()], tmp_path / "clips", starts_s=0.0)
    (tmp_path / "overlay.mp4").write_bytes(b"a film")
    with pytest.raises(VideoError, match=r"overlay.mp4: expected the overlay"):
        write_clips(tmp_path / "overlay.mp4", [event()], tmp_path / "clips", starts_s=0.0)


def test_cut_overlay(overlay, tmp_path):
    path = tmp_path / "overlay.mp4"
    content = overlay.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    assert cut_clip(path, tmp_path / "clip.mp4", 1.5, 9.0)
    numbers, _, _ = frames_of(tmp_path / "clip.mp4")
    assert numbers == list(range(15, 15 + len(numbers)))


def test_folder_of_clips_is_a_file(overlay, tmp_path):
    (tmp_path / "clips").touch()
    with pytest.raises(OutputError, match="clips"):
        write_clips(overlay, [event()], tmp_path / "clips", starts_s=0.0)


def test_clips_need_the_overlay():
    with pytest.raises(UsageError, match=r"^clips=True"):
        tr.Run.mono("a.mp4", focal_px=700, clips=True, overlay=False)


@pytest.mark.slow
def test_run_writes_clips(small_drive, tmp_path):
    run = tr.Run.stereo(
        small_drive.left,
        small_drive.right,
        detections=small_drive.detections,
        align="off",
        sgbm=False,
        clips=True,
    )
    run.session.rows.finder = SeenFinder()
    run.write(tmp_path)
    written = sorted(path.name for path in (tmp_path / "clips").iterdir())
    assert written == [clip_name(i + 1, one.kind, one.track_id) for i, one in enumerate(run.events)]
    assert [one.clip_file for one in run.events] == [f"clips/{name}" for name in written]
    for name in ("events.csv", "events.parquet"):
        assert [one.clip_file for one in tr.read_events(tmp_path / name)] == [
            f"clips/{name}" for name in written
        ]
    assert frames_of(tmp_path / "clips" / written[0])[2] == pytest.approx(1.2, abs=0.01)
    assert (tmp_path / "report.html").read_text().count('href="clips/') == len(written)


def test_report_cuts_clips(overlay, tmp_path):
    run = write_run(tmp_path / "run")
    (run / "overlay.mp4").write_bytes(overlay.read_bytes())
    write_event_files(run, [event(start_s=0.2, end_s=0.4)], {})
    assert [path.name for path in report([run], has_clips=True).clips] == [
        "01-forward_collision-7.mp4"
    ]
    assert 'href="clips/01-forward_collision-7.mp4"' in (run / "report.html").read_text()
    for name in ("events.csv", "events.parquet"):
        (one,) = tr.read_events(run / name)
        assert (one.clip_file, one.start_s) == ("clips/01-forward_collision-7.mp4", 0.2)
    report([run], tmp_path / "elsewhere.html")
    assert (
        'href="run/clips/01-forward_collision-7.mp4"' in (tmp_path / "elsewhere.html").read_text()
    )
    (run / "overlay.mp4").unlink()
    with pytest.raises(VideoError, match=r"overlay.mp4: no such file"):
        report([run], has_clips=True)
