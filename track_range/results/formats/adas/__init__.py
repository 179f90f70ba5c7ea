"""Formats of ASAM for driver assistance, written with the packages of the extra [adas]."""
