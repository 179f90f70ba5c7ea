"""Formats of ASAM for driver assistance; MDF4 and OSI need the extra [adas]."""
