"""Input: files, folders, bags, streams, telemetry and calibration files, read as frames.

Each layer imports only those above it in this list:

video/       frames, names and dates, which all recordings share
sources/     the recordings of one camera
telemetry/   the speed and positions that were recorded with them
cameras/     their calibration
pairs/       two cameras: pairing by time, alignment and checks
recording.py, speed_source.py    one video or a pair as rectified frames; its ego speed
"""
