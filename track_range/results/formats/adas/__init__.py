"""Formats of ASAM for driver assistance; those but OpenLABEL need the extra [adas]."""
