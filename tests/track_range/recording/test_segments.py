"""Recordings in several files: order, times, gaps and overlaps, and files that cannot be used."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.foundation.errors import UsageError
from track_range.recording.pairs.recorded_pair import RecordedPair
from track_range.recording.sources.open_video import open_video
from track_range.recording.sources.segments.segment_times import (
    SegmentFacts,
    SegmentPlan,
    arranged,
    paired_starts_s,
)
from track_range.recording.sources.segments.segments import Segments
from track_range.recording.video.file_names import natural_key
from track_range.recording.video.frame import VideoError
from track_range.recording.video.utc import Stamp, stamp_in_name
from track_range.run.options.precedence import settings_from
from track_range.run.options.settings_file import save_settings

Film = Callable[..., Path]
Trip = Callable[..., list[Path]]
N_FRAMES = 10
"""Frames per file, at 10 Hz."""


@pytest.fixture
def trip(film: Film, level: Callable[..., np.ndarray]) -> Trip:
    """Writes files of one second: `trip(folder, names)`; their images have continuous numbers."""

    def write(
        folder: Path,
        names: list[str],
        *,
        first_s: float = 0.0,
        step_s: float = 0.0,
        **options: object,
    ) -> list[Path]:
        folder.mkdir(exist_ok=True)
        return [
            film(
                folder / name,
                [first_s + number * step_s + frame / 10 for frame in range(N_FRAMES)],
                images=[level(number * N_FRAMES + frame) for frame in range(N_FRAMES)],
                **options,
            )
            for number, name in enumerate(names)
        ]

    return write


NAMES = ["20260131_142530.mp4", "20260131_142531.mp4", "20260131_142532.mp4"]


def test_files_of_a_folder_are_one_video(
    tmp_path: Path, trip: Trip, number_in: Callable[..., int]
) -> None:
    trip(tmp_path / "trip", NAMES)
    reader = open_video(tmp_path / "trip")
    frames = list(reader)
    assert [frame.index for frame in frames] == list(range(30))
    assert [frame.time_s for frame in frames] == pytest.approx(
        [number / 10 for number in range(30)]
    )
    assert [number_in(frame.image) for frame in frames] == list(range(30))
    assert (reader.n_frames, reader.notes) == (30, ())
    assert reader.utc is not None
    assert reader.utc.summary()["start"] == "2026-01-31T14:25:30.000Z"
    assert [frame.index for frame in reader] == list(range(30))  # a second iteration


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts"])
@pytest.mark.parametrize(
    ("start_s", "duration_s"), [(0.0, 0.5), (0.5, 1.0), (1.0, 1.0), (2.35, None), (2.9, None)]
)
def test_part_of_a_recording(
    tmp_path: Path,
    trip: Trip,
    number_in: Callable[..., int],
    suffix: str,
    start_s: float,
    duration_s: float | None,
) -> None:
    trip(tmp_path / "trip", [name.replace("mp4", suffix) for name in NAMES])
    whole = open_video(tmp_path / "trip")
    until_s = whole.first_time_s + start_s + (duration_s or 9.0) - 1e-6
    expected = [
        (frame.index, round(frame.time_s, 3), number_in(frame.image))
        for frame in whole
        if whole.first_time_s + start_s - 1e-6 <= frame.time_s < until_s
    ]
    part = open_video(tmp_path / "trip", start_s=start_s, duration_s=duration_s)
    assert [
        (frame.index, round(frame.time_s, 3), number_in(frame.image)) for frame in part
    ] == expected
    assert expected[0][0] == expected[0][2]


def test_gap_between_files(tmp_path: Path, trip: Trip) -> None:
    trip(tmp_path / "trip", [NAMES[0], "20260131_142601.mp4"])
    reader = open_video(tmp_path / "trip")
    frames = list(reader)
    assert [frame.index for frame in frames] == list(range(20))
    assert frames[10].time_s == pytest.approx(31.0)
    assert "1 gap between the files, 30.0 s" in reader.notes[0]
    assert [frame.index for frame in open_video(tmp_path / "trip", start_s=20.0)] == list(
        range(10, 20)
    )


def test_order_by_creation_times(tmp_path: Path, film: Film) -> None:
    for name, time in (("b.mp4", "2026-01-31T14:25:30Z"), ("a.mp4", "2026-01-31T14:25:31Z")):
        film(
            tmp_path / name, [number / 10 for number in range(10)], metadata={"creation_time": time}
        )
    reader = open_video(Segments((tmp_path / "a.mp4", tmp_path / "b.mp4")))
    assert [segment.path.name for segment in reader._segments] == ["b.mp4", "a.mp4"]  # type: ignore[union-attr]
    assert "order of the given files" in reader.notes[0]


def test_order_without_times(tmp_path: Path, trip: Trip, number_in: Callable[..., int]) -> None:
    files = trip(tmp_path / "trip", ["GX2.mp4", "GX10.mp4", "GX11.mp4"])
    reader = open_video(tmp_path / "trip")
    assert [number_in(frame.image) for frame in reader][::10] == [0, 10, 20]
    assert "without usable dates" in reader.notes[0]
    given = open_video(Segments((files[2], files[0])))
    assert [number_in(frame.image) for frame in given][::10] == [20, 0]


def test_time_stamps_that_continue(tmp_path: Path, trip: Trip) -> None:
    trip(tmp_path / "trip", ["c.ts", "a.ts", "b.ts"], first_s=100.0, step_s=1.5)
    reader = open_video(tmp_path / "trip")
    times_s = [frame.time_s - reader.first_time_s for frame in reader]
    assert times_s[::10] == pytest.approx([0.0, 1.5, 3.0])
    assert "2 gaps between the files, 1.0 s" in reader.notes[0]


def test_files_of_two_cameras(tmp_path: Path, trip: Trip) -> None:
    names = [name.replace(".", f"_{camera}.") for name in NAMES[:2] for camera in "FR"]
    trip(tmp_path / "trip", names)
    with pytest.raises(VideoError, match=r"--mono '.*\*_F\.mp4'") as raised:
        open_video(tmp_path / "trip")
    assert len(str(raised.value)) < 300 + 2 * len(str(tmp_path))
    front = open_video(tmp_path / "trip" / "*_F.mp4")
    assert [frame.index for frame in front] == list(range(20))
    assert settings_from({"mono": str(tmp_path / "trip" / "*_F.mp4")}).out_dir == Path(
        "trip-track-range"
    )


def test_empty_and_damaged_files_are_skipped(tmp_path: Path, trip: Trip) -> None:
    files = trip(tmp_path / "trip", [*NAMES, "20260131_142545.mp4"])
    files[0].write_bytes(b"")
    files[2].write_bytes(files[2].read_bytes()[:300])
    reader = open_video(tmp_path / "trip")
    assert [frame.time_s for frame in reader][::10] == pytest.approx([0.0, 14.0])
    assert sum(note.startswith("Skipped: ") for note in reader.notes) == 2


def test_missing_and_vanished_files(tmp_path: Path, trip: Trip) -> None:
    files = trip(tmp_path / "trip", NAMES)
    with pytest.raises(VideoError, match="no such file"):
        open_video(Segments((files[0], tmp_path / "missing.mp4")))
    with pytest.raises(VideoError, match="pattern"):
        open_video(tmp_path / "trip" / "*.avi")
    frames = iter(open_video(tmp_path / "trip"))
    next(frames)
    files[1].unlink()
    with pytest.raises(VideoError, match=r"142531\.mp4.*deleted"):
        list(frames)


def test_file_replaced_while_reading(tmp_path: Path, trip: Trip) -> None:
    files = trip(tmp_path / "trip", NAMES)
    frames = iter(open_video(tmp_path / "trip"))
    next(frames)
    files[1].write_bytes(files[1].read_bytes()[:-100])
    with pytest.raises(VideoError, match="shortened"):
        list(frames)


def test_copies_are_used_once(tmp_path: Path, trip: Trip) -> None:
    files = trip(tmp_path / "trip", NAMES[:2])
    shutil.copy(files[0], tmp_path / "trip" / "copy of it.mp4")
    reader = open_video(tmp_path / "trip")
    assert len(list(reader)) == 20
    assert "same content" in reader.notes[0]
    assert len(list(open_video(Segments((files[0], files[1], files[0]))))) == 20


def test_files_that_do_not_fit(
    tmp_path: Path, film: Film, trip: Trip, level: Callable[..., np.ndarray]
) -> None:
    trip(tmp_path / "trip", NAMES[:2])
    film(tmp_path / "trip" / "20260131_142533.mp4", [0.0], images=[level(0, width_px=96)])
    with pytest.raises(VideoError, match="96x48"):
        open_video(tmp_path / "trip")
    (tmp_path / "trip" / "20260131_142533.mp4").unlink()
    (tmp_path / "trip" / "000001.png").write_bytes(b"")
    with pytest.raises(VideoError, match="both"):
        open_video(tmp_path / "trip")


def test_other_frame_rate_is_noted(tmp_path: Path, film: Film, trip: Trip) -> None:
    trip(tmp_path / "trip", NAMES[:1])
    film(tmp_path / "trip" / NAMES[1], [number / 20 for number in range(20)], rate=20)
    reader = open_video(tmp_path / "trip")
    assert len(list(reader)) == 30
    assert "20 frames/s instead of 10" in reader.notes[0]


def test_pair_in_several_files(tmp_path: Path, trip: Trip) -> None:
    trip(tmp_path / "left", [NAMES[0], "20260131_142601.mp4"])
    # the dates are truncated to seconds
    trip(tmp_path / "right", [NAMES[0], "20260131_142602.mp4"])
    left = open_video(tmp_path / "left")
    pair = RecordedPair(left, open_video(tmp_path / "right", left=left))
    assert [(one.index, other.index) for one, other in pair] == [(n, n) for n in range(20)]
    pair.close()


def test_results_in_the_folder_of_the_input(tmp_path: Path, trip: Trip) -> None:
    trip(tmp_path / "trip", [*NAMES, "overlay.mp4"])
    (tmp_path / "trip" / "settings.yaml").touch()
    assert len(list(open_video(tmp_path / "trip"))) == 30


def test_one_file_in_a_folder(tmp_path: Path, trip: Trip) -> None:
    trip(tmp_path / "trip", ["drive.mp4"])
    assert open_video(tmp_path / "trip").notes == ()


def test_settings_of_several_files(tmp_path: Path) -> None:
    one = settings_from({"mono": ["a.mp4"], "focal_px": 700.0})
    assert (one.mono, one.out_dir) == (Path("a.mp4"), Path("a-track-range"))
    several = settings_from({"stereo": (["a.mp4", "b.mp4"], "right/")})
    assert several.stereo == (Segments((Path("a.mp4"), Path("b.mp4"))), Path("right"))
    save_settings(several, tmp_path / "settings.yaml")
    again = settings_from({}, tmp_path / "settings.yaml")
    assert str(again.stereo[0]).startswith(f"{Path.cwd() / 'a.mp4'} and 1 other")  # type: ignore[index]
    save_settings(again, tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_text() == (tmp_path / "settings.yaml").read_text()
    with pytest.raises(UsageError, match="video files"):
        settings_from({"mono": ["0", "1"], "focal_px": 700.0})


def facts(name: str, duration_s: float, *, created_s: float | None = None) -> SegmentFacts:
    header = None if created_s is None else Stamp(created_s, "header", is_start=False)
    return SegmentFacts(Path(name), 0.0, duration_s, header, stamp_in_name(name))


def starts_s(plan: SegmentPlan) -> list[tuple[str, float]]:
    return [
        (file.path.stem, round(start_s, 3))
        for file, start_s in zip(plan.facts, plan.starts_s, strict=True)
    ]


def test_creation_times_of_the_ends() -> None:
    files = [
        facts("a", 60.0, created_s=1e9 + 60),
        facts("b", 60.0, created_s=1e9 + 121),
        facts("c", 20.0, created_s=1e9 + 141),
    ]
    plan = arranged(files, is_given_order=False)
    assert starts_s(plan) == [("a", 0.0), ("b", 60.0), ("c", 120.0)]
    assert plan.utc is not None
    assert plan.utc.start_s == 1e9


CHAPTERS = (  # given by name; the order; with the dates of their recordings, and the starts
    (["GX010001", "GX010002", "GX020001"], ["GX010001", "GX020001", "GX010002"]),
    (["GH010012", "GH010013", "GH020012"], ["GH010012", "GH020012", "GH010013"]),
    (
        ["GF010001", "GF020001", "GPFR0001", "GPFR0002"],
        ["GPFR0001", "GF010001", "GF020001", "GPFR0002"],
    ),
    (
        ["GOPR0001", "GOPR0002", "GP010001", "GP020001"],
        ["GOPR0001", "GP010001", "GP020001", "GOPR0002"],
    ),
    (["DJI_0009", "DJI_0010"], ["DJI_0009", "DJI_0010"]),
    (["C0001", "C0002"], ["C0001", "C0002"]),
)


@pytest.mark.parametrize(("names", "ordered"), CHAPTERS)
def test_chapters_of_recordings(names: list[str], ordered: list[str]) -> None:
    undated = arranged([facts(name, 8.0) for name in names], is_given_order=False)
    assert [name for name, _ in starts_s(undated)] == ordered
    assert "order of their names" in undated.notes[0]
    if not ordered[0].startswith("G"):
        return
    # all chapters have the date of their recording, and the second one starts 100 s later
    dated = arranged(
        [facts(name, 8.0, created_s=1e9 + 100 * (name[-1] in ordered[-1][-1])) for name in names],
        is_given_order=False,
    )
    first = [(name, 8.0 * number) for number, name in enumerate(ordered[:-1])]
    assert starts_s(dated) == [*first, (ordered[-1], 100.0)]


def test_small_gaps_do_not_accumulate() -> None:
    files = [facts(f"{number}", 59.5, created_s=1e9 + 60 * number) for number in range(100)]
    plan = arranged(files, is_given_order=False)
    assert max(abs(start_s - 60 * number) for number, start_s in enumerate(plan.starts_s)) <= 1.5
    assert "gaps" in plan.notes[0]


def test_rounded_dates_are_no_gaps() -> None:
    files = [
        facts(f"{number}", 59.97, created_s=float(int(1e9 + 59.97 * number)))
        for number in range(200)
    ]
    plan = arranged(files, is_given_order=False)
    assert plan.notes == ()
    assert plan.starts_s == pytest.approx([59.97 * number for number in range(200)])


def test_contradictory_dates() -> None:
    files = [
        facts("20260131_142530.mp4", 60.0, created_s=2e9 + 3),  # written when the files were copied
        facts("20260131_142630.mp4", 60.0, created_s=2e9 + 1),
    ]
    plan = arranged(files, is_given_order=False)
    assert [name for name, _ in starts_s(plan)] == ["20260131_142530", "20260131_142630"]
    assert "contradict" in plan.notes[0]


def test_pair_with_dates_in_utc_and_in_local_time() -> None:
    left = arranged(
        [facts("a", 60.0, created_s=1769869530.0), facts("b", 60.0, created_s=1769869690.0)],
        is_given_order=False,
    )
    right = arranged(
        [facts("20260131_152530.mp4", 60.0), facts("20260131_152811.mp4", 60.0)],
        is_given_order=False,
    )
    assert right.starts_s == (0.0, 161.0)
    assert paired_starts_s(right, left) == left.starts_s == (0.0, 160.0)


@given(
    st.lists(
        st.tuples(
            st.floats(0.1, 300.0),
            st.one_of(st.none(), st.integers(0, 10_000)),
            st.floats(-10.0, 1e6),
        ),
        min_size=1,
        max_size=8,
    )
)
@settings(max_examples=50)
def test_times_increase(files: list[tuple[float, int | None, float]]) -> None:
    given_files = [
        SegmentFacts(
            Path(f"{number}.mp4"),
            first_s,
            duration_s,
            None if at is None else Stamp(at, "header"),
            None,
        )
        for number, (duration_s, at, first_s) in enumerate(files)
    ]
    try:
        plan = arranged(given_files, is_given_order=True)
    except VideoError as error:
        assert "one camera" in str(error)  # noqa: PT017
        return
    assert sorted(file.path.name for file in plan.facts) == sorted(
        file.path.name for file in given_files
    )
    assert all(later_s > earlier_s for earlier_s, later_s in itertools.pairwise(plan.starts_s))


def test_overlap_is_noted() -> None:
    plan = arranged(
        [facts("20260131_142530.mp4", 60.0), facts("20260131_142627.mp4", 60.0)],
        is_given_order=False,
    )
    assert [start_s for _, start_s in starts_s(plan)] == [0.0, 57.0]
    assert "1 overlap" in plan.notes[0]
    with pytest.raises(VideoError, match="one camera"):
        arranged(
            [facts("cam0_20260131_142530", 60.0), facts("cam1_20260131_142531", 60.0)],
            is_given_order=False,
        )


def test_thousand_files_are_arranged() -> None:
    files = [facts(f"20260131_{h:02}{m:02}00.mp4", 60.0) for h in range(17) for m in range(60)]
    plan = arranged(files[::-1], is_given_order=False)
    assert plan.starts_s[-1] == 60.0 * (len(files) - 1)
    assert sorted(["a10", "a9", "b1"], key=natural_key) == ["a9", "a10", "b1"]


def copied(source: Path, target: Path, from_s: float, until_s: float) -> Path:
    """A part of a video without encoding it again, with time stamps from 0."""
    with av.open(str(source)) as whole, av.open(str(target), "w") as part:
        stream = whole.streams.video[0]
        copy = part.add_stream_from_template(stream)
        first = None
        for packet in whole.demux(stream):
            if (
                packet.pts is None
                or not from_s - 1e-6 <= float(packet.pts * packet.time_base) < until_s - 1e-6
            ):
                continue
            first = packet.dts if first is None else first
            packet.pts, packet.dts, packet.stream = packet.pts - first, packet.dts - first, copy
            part.mux(packet)
    return target


@pytest.mark.parametrize("names", [("1.mp4", "2.mp4", "3.mp4"), tuple(NAMES)])
def test_repeated_second_is_skipped(tmp_path: Path, film: Film, names: tuple[str, ...]) -> None:
    rng = np.random.default_rng(1)
    pictures = [rng.integers(0, 255, (48, 64, 3), dtype=np.uint8) for _ in range(40)]
    whole = film(
        tmp_path / "whole.mp4", [k / 10 for k in range(40)], images=pictures, codec="mjpeg"
    )
    (tmp_path / "trip").mkdir()
    parts_s = ((0.0, 2.0), (1.0, 3.0), (2.0, 4.0))
    for name, (from_s, until_s) in zip(names, parts_s, strict=True):
        copied(whole, tmp_path / "trip" / name, from_s, until_s)
    reader = open_video(tmp_path / "trip")
    frames, expected = list(reader), list(open_video(whole))
    assert [frame.time_s for frame in frames] == pytest.approx(
        [frame.time_s for frame in expected], abs=1e-4
    )
    assert all(np.array_equal(a.image, b.image) for a, b in zip(frames, expected, strict=True))
    assert any("2 overlaps" in note for note in reader.notes)


@pytest.mark.parametrize("case", ["static picture", "one equal frame", "flat pictures"])
def test_equal_frames_that_are_no_overlap(
    tmp_path: Path, film: Film, level: Callable[..., np.ndarray], case: str
) -> None:
    rng = np.random.default_rng(1)
    pictures = [rng.integers(0, 255, (48, 64, 3), dtype=np.uint8) for _ in range(22)]
    one, other = {
        "static picture": (pictures[:1] * 12, pictures[:1] * 11),
        "one equal frame": (pictures[:12], [pictures[9], *pictures[12:]]),
        "flat pictures": ([level(k) for k in range(12)], [level(k) for k in range(11, 22)]),
    }[case]
    (tmp_path / "trip").mkdir()
    for name, images in (("1.mp4", one), ("2.mp4", other)):
        film(
            tmp_path / "trip" / name,
            [k / 10 for k in range(len(images))],
            images=images,
            codec="mjpeg",
        )
    assert len(list(open_video(tmp_path / "trip"))) == 23


def test_missing_file_of_an_undated_pair(tmp_path: Path, trip: Trip) -> None:
    trip(tmp_path / "left", ["l1.mp4", "l3.mp4"])
    trip(tmp_path / "right", ["r1.mp4", "r2.mp4", "r3.mp4"])
    left = open_video(tmp_path / "left")
    with pytest.raises(VideoError, match=r"right: .*found 3"):
        open_video(tmp_path / "right", left=left)


def test_file_of_another_size_is_named(tmp_path: Path, trip: Trip, film: Film) -> None:
    trip(tmp_path / "trip", ["clip1.mp4", "clip3.mp4"])
    film(tmp_path / "trip" / "clip0.mp4", [0.0, 0.1], images=[np.zeros((32, 48, 3), np.uint8)] * 2)
    with pytest.raises(VideoError, match=r"clip0\.mp4: .*64x48"):
        open_video(tmp_path / "trip")
