from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from track_range.video.decode_log import DecodeLog


@given(stamps=st.lists(st.integers(-1000, 1000), min_size=1, unique=True), first=st.integers(0, 30))
@settings(deadline=None, max_examples=60)
def test_a_frames_index_is_the_number_of_earlier_packets(stamps: list[int], first: int) -> None:
    log = DecodeLog()
    for stamp in stamps:
        log.packet(stamp, is_corrupt=False)
    decoded = sorted(stamps)[first::2]  # some skipped at the start, and every other one did not decode
    assert [log.frame_index(stamp) for stamp in decoded] == [sum(s < stamp for s in stamps) for stamp in decoded]


def test_without_stamps_frames_are_counted() -> None:
    log = DecodeLog()
    assert [log.frame_index(None) for _ in range(4)] == [0, 1, 2, 3]


def test_frames_of_corrupt_packets_are_known() -> None:
    log = DecodeLog()
    log.packet(100, is_corrupt=True)
    log.packet(200, is_corrupt=False)
    assert (log.is_corrupt(100), log.is_corrupt(200), log.is_corrupt(None)) == (True, False, False)


def test_nothing_met_nothing_noted() -> None:
    log = DecodeLog()
    for number in range(10):
        log.decoded(number / 10, duration_s=0.1, interval_s=0.1)
    log.note_shortfall(1.2, tolerance_s=0.25)
    assert log.notes == []


def test_every_kind_of_note() -> None:
    log = DecodeLog()
    for time_s in (0.0, 0.1, 0.4, 0.5, 1.0):
        log.decoded(time_s, duration_s=0.1, interval_s=0.1)
    log.n_used, log.n_damaged, log.n_backward = 3, 1, 2
    log.note_shortfall(5.0, tolerance_s=0.25)
    assert log.notes == [
        "reading ended after 3 frames, at 1.10 s: the file is damaged or cut short there (3.9 s less than its header "
        "promises).",
        "2 gaps in its times, the longest of 0.50 s after 0.50 s: frames are missing there.",
        "1 damaged frame left out.",
        "2 frames with a repeated or backward timestamp left out.",
    ]


def test_what_stopped_the_reading_is_not_overwritten() -> None:
    log = DecodeLog()
    log.stopped_by = "Input/output error"
    log.note_shortfall(5.0, tolerance_s=0.1)
    assert log.stopped_by == "Input/output error"
