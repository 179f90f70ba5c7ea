"""Speed of the camera from the data of a recording: GPS records in the video file, or files beside
it.

tracks/                 TelemetryTrack
sidecars/, containers/  readers of the formats, each of which returns a TelemetryTrack
speed_files.py          speeds that are no telemetry: a number, a table, a folder of a data set
found.py                the telemetry of a recording, in a fixed order of preference
checks.py               reasons for which telemetry is not used
time_offset.py          time offset between telemetry and video, from image motion
"""
