"""Speed of the camera from the data of a recording: GPS records in the video file, or files beside
it.

sidecars/, containers/  readers of the formats, each of which returns a TelemetryTrack
found.py                the telemetry of a recording, in a fixed order of preference
checks.py               reasons for which telemetry is not used
time_offset.py          time offset between telemetry and video, from image motion
"""
