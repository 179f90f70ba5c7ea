"""Whether the times of a stream are its own, or counted by FFmpeg at a rate that FFmpeg assumes."""

from fractions import Fraction

from av.container import InputContainer
from av.video.stream import VideoStream

# FFmpeg's AVFMT_NOTIMESTAMPS and AVFMT_TS_DISCONT; PyAV's enumeration refuses unknown flags
_NO_TIMESTAMPS, _TIMES_BEGIN_ANYWHERE = 0x80, 0x200
_ASSUMED = Fraction(1009, 97)
ASSUMED_RATE = {"framerate": f"{_ASSUMED.numerator}/{_ASSUMED.denominator}"}
"""FFmpeg's option for the rate of formats that state none, with a value that no file has.

A demuxer that reports this rate does not know another one. Cameras take it for a request.
"""


def has_clock(container: InputContainer, stream: VideoStream) -> bool:
    """Whether the times of a stream, opened with `ASSUMED_RATE`, are times of its images."""
    if int(container.format.flags) & _NO_TIMESTAMPS:
        return False
    return _ASSUMED not in (stream.average_rate, stream.guessed_rate)


def has_origin(container: InputContainer) -> bool:
    """Whether the times of a file count from its start: those of streams begin anywhere."""
    return not int(container.format.flags) & _TIMES_BEGIN_ANYWHERE


def assumed_rate_note(source: object, rate_hz: float) -> str:
    """Message for the user on a source without times for which no frame rate is given."""
    return (
        f"{source}: the images have no times; {rate_hz:g} frames/s are assumed, and all speeds "
        "depend on this rate: give it with --fps."
    )
