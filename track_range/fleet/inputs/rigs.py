"""RigOption: the calibration files of `--rig`, one for all clips or one for each vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

from track_range.fleet.inputs.clip import Clip, FleetInputError
from track_range.fleet.inputs.pattern import CLIP, Template
from track_range.fleet.storage.location import Location
from track_range.foundation.files.input_files import quoted, shortened

_N_CONNECTIONS = 16
"""Files that are looked up at a time."""


@dataclass(frozen=True, slots=True)
class RigOption:
    """Value of `--rig`, with placeholders.

    Attributes:
        template: path or address of the calibration file.
    """

    template: Template

    @classmethod
    def of(cls, text: str) -> RigOption:
        """The value of the option; relative paths start in the current folder.

        Raises:
            FleetInputError: the placeholders are wrong.
        """
        return cls(Template.of(text, "--rig"))

    def added(self, clips: Sequence[Clip]) -> list[Clip]:
        """The clips with their calibration file, unless they have one or a focal length already.

        A clip without the file of its placeholders has a problem.

        Raises:
            FleetInputError: a placeholder is unknown, or no file exists.
            StorageError: the storage cannot be reached.
        """
        rigs = {clip.name: self._rig(clip) for clip in clips if not clip.settings.keys() & {"rig", "focal_px"}}
        addresses = {text: Location.of(text) for text in set(rigs.values())}
        with ThreadPoolExecutor(_N_CONNECTIONS) as threads:
            exists = dict(zip(addresses, threads.map(Location.exists, addresses.values()), strict=True))
        if addresses and not any(exists.values()):
            missing = addresses[min(addresses)]
            raise FleetInputError(f"{missing}: no such file; expected the calibration of --rig.")
        return [
            clip if (text := rigs.get(clip.name)) is None else _with_rig(clip, addresses[text], exists[text])
            for clip in clips
        ]

    def _rig(self, clip: Clip) -> str:
        values = _values(clip)
        try:
            return self.template.filled(values)
        except KeyError as error:
            raise FleetInputError(
                f"--rig {quoted(self.template.text)}: {{{error.args[0]}}} is unknown; expected one of "
                f"{shortened(', '.join(values), 100)}."
            ) from error


def _with_rig(clip: Clip, rig: Location, exists: bool) -> Clip:
    problem = f"{shortened(str(rig), 200)}: no such file; expected the calibration of the clip."
    return replace(
        clip, settings={**clip.settings, "rig": rig.address}, problem=clip.problem or ("" if exists else problem)
    )


def _values(clip: Clip) -> Mapping[str, str]:
    return {CLIP: clip.name, **clip.labels}
