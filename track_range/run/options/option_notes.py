"""Notes on options that a run needs, or does not use."""

from track_range.recording.recording import Recording
from track_range.recording.video.address import LiveAddress
from track_range.run.options.detection import DetectionOptions
from track_range.run.options.settings import RunSettings

_OF_NETWORK = [  # options of a detector network, which recorded detections do not need
    name
    for name, field in DetectionOptions.model_fields.items()
    if field.default is None and name not in ("detector", "detections", "ignore")
]


def assumed_rate(settings: RunSettings, recording: Recording) -> tuple[str, ...]:
    """A note on images without times for which the user gave no frame rate."""
    has_times = all(getattr(video, "has_times", True) for video in recording.videos)
    if has_times or settings.folder_fps != RunSettings.model_fields["folder_fps"].default:
        return ()
    rate = f"their times follow from {settings.folder_fps:g} frames per second"
    return (
        f"The images have no times: {rate}, on which all speeds depend. Give the rate with "
        "--folder-fps.",
    )


def unused_options(settings: RunSettings) -> tuple[str, ...]:
    """Notes on options that were given but have no effect on the run."""
    notes = []
    if settings.mono is not None and settings.align not in ("auto", "off"):
        notes.append("--align is not used with one camera.")
    if settings.realtime and any(isinstance(video, LiveAddress) for video in settings.videos):
        notes.append(
            "--realtime has no effect on cameras and streams, which are read in real time already."
        )
    given = [RunSettings.flag(name) for name in _OF_NETWORK if getattr(settings, name) is not None]
    if settings.detections is not None and given:
        verb = "is" if len(given) == 1 else "are"
        notes.append(f"{', '.join(given)} {verb} not used with --detections.")
    return tuple(notes)
