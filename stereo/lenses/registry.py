"""The lens models by name.

A model is a file with a `Lens`, and a row of `LENSES`, or an entry point of the group
`track_range.lenses` in another package. rig.yaml, Kalibr's files and messages follow.
"""

from collections.abc import Collection

from track_range.foundation.errors import UserError
from track_range.foundation.registry import PluginError, Registry
from track_range.stereo.lenses.lens import KANNALA_BRANDT, PINHOLE, Lens


def _check_kalibr(lens: Lens, known: Collection[Lens], _: Collection[str]) -> None:
    """Raise PluginError if Kalibr's name of a lens is that of a known one."""
    known_names = {model.names for other in known for model in other.kalibr}
    for model in lens.kalibr:
        if model.names in known_names:
            raise PluginError(f"Kalibr's {' with '.join(model.names)} is the name of another lens")


LENSES = Registry(
    "track_range.lenses",
    {
        PINHOLE: "track_range.stereo.lenses.pinhole:LENS",
        KANNALA_BRANDT: "track_range.stereo.lenses.kannala_brandt:LENS",
        "double-sphere": "track_range.stereo.lenses.double_sphere:LENS",
        "omni": "track_range.stereo.lenses.unified:LENS",
    },
    Lens,
    _check_kalibr,
    error=UserError,
)


def wide_lenses() -> tuple[str, ...]:
    """Names of the models of wide lenses."""
    return tuple(name for name, lens in LENSES.usable.items() if lens.is_wide)
