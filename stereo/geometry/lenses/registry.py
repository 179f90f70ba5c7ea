"""Registry of the lens models: a new one is a module with a Lens, and a row here."""

from __future__ import annotations

from track_range.stereo.geometry.lenses.double_sphere import DOUBLE_SPHERE
from track_range.stereo.geometry.lenses.kannala_brandt import KANNALA_BRANDT
from track_range.stereo.geometry.lenses.lens import Lens
from track_range.stereo.geometry.lenses.radial_tangential import RADIAL_TANGENTIAL
from track_range.stereo.geometry.lenses.unified import UNIFIED

PINHOLE = RADIAL_TANGENTIAL.name  # name of the pinhole with OpenCV's distortion, the default
LENSES: dict[str, Lens] = {lens.name: lens for lens in (RADIAL_TANGENTIAL, KANNALA_BRANDT, DOUBLE_SPHERE, UNIFIED)}
