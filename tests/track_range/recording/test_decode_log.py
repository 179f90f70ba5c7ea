from __future__ import annotations

from hypothesis import given, settings, strategies as st

from track_range.recording.sources.files.decode_log import DecodeLog


@given(stamps=st.lists(st.integers(-1000, 1000), min_size=1, unique=True), first=st.integers(0, 30))
@settings(deadline=None, max_examples=60)
def test_frame_index_counts_earlier_packets(stamps: list[int], first: int) -> None:
    log = DecodeLog()
    for stamp in stamps:
        log.packet(stamp, is_corrupt=False)
    # some are skipped at the start, and every other one cannot be decoded
    decoded = sorted(stamps)[first::2]
    assert [log.frame_index(stamp) for stamp in decoded] == [
        sum(s < stamp for s in stamps) for stamp in decoded
    ]


def test_frames_without_timestamps_are_counted() -> None:
    log = DecodeLog()
    assert [log.frame_index(None) for _ in range(4)] == [0, 1, 2, 3]


def test_frames_of_corrupt_packets() -> None:
    log = DecodeLog()
    log.packet(100, is_corrupt=True)
    log.packet(200, is_corrupt=False)
    assert (log.is_corrupt(100), log.is_corrupt(200), log.is_corrupt(None)) == (True, False, False)


def test_no_notes_without_problems() -> None:
    log = DecodeLog()
    for number in range(10):
        log.decoded(number / 10, duration_s=0.1, interval_s=0.1)
    log.note_shortfall(1.2, tolerance_s=0.25)
    assert log.notes == []


def test_notes() -> None:
    log = DecodeLog()
    for time_s in (0.0, 0.1, 0.4, 0.5, 1.0):
        log.decoded(time_s, duration_s=0.1, interval_s=0.1)
    log.n_used, log.n_damaged, log.n_backward = 3, 1, 2
    log.note_shortfall(5.0, tolerance_s=0.25)
    stop, gaps, damaged, backward = log.notes
    assert "3 frames" in stop
    assert "3.9 s" in stop
    assert "2 gaps" in gaps
    assert "0.50 s" in gaps
    assert "1 damaged frame." in damaged
    assert "2 frames" in backward


def test_first_reason_of_a_stop_is_kept() -> None:
    log = DecodeLog()
    log.stopped_by = "Input/output error"
    log.note_shortfall(5.0, tolerance_s=0.1)
    assert log.stopped_by == "Input/output error"
