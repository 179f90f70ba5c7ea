"""Options of a run for its ranging methods: which measure, networks that do, and which only
show.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, ClassVar, Self

from pydantic import model_validator

from track_range.foundation.errors import UserError
from track_range.foundation.schemas.options import Options, contradiction, option

_NETWORK_FILE = (
    "An ONNX file that is not understood on its own has a MODEL.yaml beside it, see "
    "docs/how-to/networks.md and `track-range doctor FILE`; repeat the option for "
    "further networks, "
    "whose methods have the names of their files: {}-NAME"
)


class RunMethodOptions(Options):
    """The ranging methods of a run."""

    panel: ClassVar = "Ranging"
    stage: ClassVar = "tracks"

    methods: Annotated[
        tuple[str, ...],
        option(
            "Ranging methods of the run: mono, ground, lane, stereo, sgbm, expansion, methods of "
            "installed packages, or MODULE:OBJECT, a RangingMethod of an installed "
            "package or (only "
            "on the command line) of a module in the current folder. Networks of --depth-model and "
            "--stereo-model are added (default: all that the recording allows).",
            metavar="A,B,...|MODULE:OBJECT",
            is_shared=True,
        ),
    ] = ()
    show_only: Annotated[
        tuple[str, ...],
        option(
            "Ranging method that is shown beside the others, in all tables and in the "
            "overlay, but is "
            "no part of the fused distance, nor of anything that follows from it; "
            "repeat the option "
            "for further methods.",
            metavar="NAME",
            is_repeated=True,
            is_shared=True,
        ),
    ] = ()
    depth_model: Annotated[
        tuple[Path, ...],
        option(
            "Network that gives the depth of each pixel of one image, metric or "
            "relative: the method "
            f"depth. {_NETWORK_FILE.format('depth')}.",
            metavar="FILE.onnx",
            is_repeated=True,
            is_shared=True,
        ),
    ] = ()
    stereo_model: Annotated[
        tuple[Path, ...],
        option(
            "Network that gives the disparity of each pixel of a rectified pair: the method "
            f"disparity. {_NETWORK_FILE.format('disparity')}.",
            metavar="FILE.onnx",
            is_repeated=True,
            is_shared=True,
        ),
    ] = ()

    @property
    def networks(self) -> dict[str, dict[str, Path]]:
        """Files of the networks by the names of their methods, of the kinds depth and disparity."""
        from track_range.ranging.registry import network_names  # imports NumPy

        return {
            "depth": network_names("depth", self.depth_model),
            "disparity": network_names("disparity", self.stereo_model),
        }

    @property
    def asked_for(self) -> frozenset[str]:
        """Names of the methods that this run is to have in any case; MethodError: one is unknown."""
        from track_range.ranging.registry import method_of  # imports NumPy

        names = (method_of(text).name for text in (*self.methods, *self.show_only))
        return frozenset((*names, *(name for kind in self.networks.values() for name in kind)))

    @model_validator(mode="after")
    def _known_methods(self) -> Self:
        if self.depth_model or self.stereo_model:
            from track_range.ranging.registry import register_networks  # imports NumPy

            with _named("depth_model", "stereo_model"):
                register_networks(name for kind in self.networks.values() for name in kind)
        for field in ("methods", "show_only"):
            for text in getattr(self, field):
                from track_range.ranging.registry import method_of  # imports NumPy

                with _named(field):
                    method_of(text)
        return self


@contextmanager
def _named(*fields: str) -> Iterator[None]:
    """The sentence of an error with the option that caused it."""
    try:
        yield
    except UserError as error:
        flag = RunMethodOptions.flag(fields[0])
        raise contradiction(f"{flag}: {error}", fields) from error
