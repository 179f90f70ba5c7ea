"""Small files of telemetry with known speeds, and video parts that they belong to."""

from datetime import UTC, datetime
from pathlib import Path

from track_range.recording.video.utc import UtcStart
from track_range.recording.video.video import VideoPart

START_S = datetime(2026, 5, 3, 10, 0, 0, tzinfo=UTC).timestamp()
LATITUDE, LONGITUDE = 48.123456, 9.654321
DEG_PER_M = 1 / 111_195.08


def gpx_text(speeds_mps, *, start_s=START_S, field=None, factor=1.0):
    """A GPX track with a point per second that drives north; `field` = heading of its speed."""
    latitude, points = LATITUDE, []
    for i, speed in enumerate(speeds_mps):
        time = datetime.fromtimestamp(start_s + i, UTC).isoformat().replace("+00:00", "Z")
        extension = f"<extensions><{field}>{speed * factor}</{field}></extensions>" if field else ""
        points.append(
            f'<trkpt lat="{latitude:.8f}" lon="{LONGITUDE}"><time>{time}</time>{extension}</trkpt>'
        )
        latitude += speed * DEG_PER_M
    return (
        '<?xml version="1.0"?><gpx version="1.1" '
        'xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>'
        + "".join(points)
        + "</trkseg></trk></gpx>"
    )


def rmc(second, speed_kn, *, status="A", day="030526", course="90.0", hour=10):
    """An RMC sentence at 10:00 and some seconds, with its checksum."""
    clock = f"{hour}{second // 60:02d}{second % 60:02d}.00"
    content = f"GPRMC,{clock},{status},4807.4074,N,00939.2593,E,{speed_kn},{course},{day},,,A"
    total = 0
    for character in content:
        total ^= ord(character)
    return f"${content}*{total:02X}"


def part(
    path="drive.mp4",
    *,
    duration_s=20.0,
    start_s=START_S,
    uncertainty_s=1.0,
    is_local=False,
    source="test",
):
    """A video file that starts at `start_s`, None = unknown."""
    utc = None if start_s is None else UtcStart(start_s, source, uncertainty_s, is_local)
    return VideoPart(Path(path), 0.0, duration_s, utc)
