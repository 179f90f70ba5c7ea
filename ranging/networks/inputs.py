"""NetworkInputs: the arrays that a network takes, from images and its format."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.detection.models.onnx_session import OnnxNetwork
from track_range.foundation.arrays import Image
from track_range.foundation.files.input_files import shortened
from track_range.ranging.networks.network_format import MAX_SIDE_PX, NetworkError, NetworkFormat
from track_range.ranging.networks.placement import InputPlacement

_TYPES: dict[str, Any] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(uint8)": np.uint8,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
}
_IMAGES = ("image", "left", "right", "pair", "left/2", "right/2")
_WHOLE = ("image", "left", "right", "pair")  # at the size of the input
_MAX_VALUES = 2**28  # of an input: 1 GB of float32


class NetworkInputs:
    """The contents of a network's inputs; NetworkError if the file's inputs have no such content.

    `contents` has what each input gets by name, `fixed_hw` the sides of the images' input, None
    where they vary.
    """

    def __init__(self, session: OnnxNetwork, network: NetworkFormat) -> None:
        self._path, self._format = session.path, network
        self._infos = {one.name: one for one in session.input_infos}
        self.contents = self._contents()
        for name, info in self._infos.items():
            if info.type not in _TYPES:
                raise NetworkError(
                    f"{self._path}: expected an input {name} of numbers, got {info.type}."
                )
        main = next(name for name, content in self.contents.items() if content in _WHOLE)
        shape = self._image_shape(main)
        self.has_channels_last = shape[1] not in (1, 2, 3, 6) and shape[3] in (1, 2, 3, 6)
        self.fixed_hw = (shape[1], shape[2]) if self.has_channels_last else (shape[2], shape[3])
        self._channels = {
            name: self._n_channels(name)
            for name, content in self.contents.items()
            if content in _IMAGES
        }

    def placement(self, image_hw: tuple[int, int]) -> InputPlacement:
        """Where an image of this size lies in the input."""
        placement = InputPlacement.within(self._format, image_hw, self.fixed_hw)
        if max(placement.input_hw) > MAX_SIDE_PX:
            raise NetworkError(
                f"{self._path}: expected images of at most {MAX_SIDE_PX} pixels a side, got "
                f"{placement.input_hw}; add `area` to its MODEL.yaml."
            )
        return placement

    def blobs(
        self, images: dict[str, Image], placement: InputPlacement, fx_px: float
    ) -> dict[str, npt.NDArray[Any]]:
        """All inputs by name, for images (H, W, 3), BGR, by content."""
        placed = {key: placement.placed(image) for key, image in images.items()}
        blobs = {}
        for name, content in self.contents.items():
            if content in _IMAGES:
                array = self._image_blob(name, str(content), placed)
            else:
                array = self._extra(name, content, placement, fx_px)
            blobs[name] = np.asarray(array, order="C")  # a scalar stays one
        return blobs

    def _contents(self) -> dict[str, Any]:
        """The content of each input by name."""
        names = list(self._infos)
        given = self._format.inputs or self._usual_contents(names)
        contents = {content for content in given if content in _WHOLE}
        wanted = [{"image"}] if self._format.task == "depth" else [{"left", "right"}, {"pair"}]
        if len(given) != len(names) or contents not in wanted:
            texts = ", ".join(f"{name} {info.shape}" for name, info in self._infos.items())
            raise NetworkError(
                f"{self._path}: expected the inputs {' or '.join(map(_listed, wanted))}, found "
                f"{len(names)}: {shortened(texts, 100)}; give the content of each as "
                "`inputs` in its "
                "MODEL.yaml, such as `inputs: [image, intrinsics, 1800]` or `inputs: "
                "[right, left]`."
            )
        return dict(zip(names, given, strict=True))

    def _usual_contents(self, names: list[str]) -> tuple[str, ...]:
        """The contents of inputs that are images alone; () = they are not."""
        if len(names) == 1:
            return ("image",) if self._format.task == "depth" else ("pair",)
        if self._format.task == "depth" or len(names) != 2:
            return ()
        first, second = (name.lower() for name in names)
        if "right" in first and "left" in second:
            return "right", "left"
        return "left", "right"

    def _image_shape(self, name: str) -> tuple[int | None, ...]:
        """The shape of an image input as four lengths, without the dimension of views."""
        shape = [d if isinstance(d, int) else None for d in self._infos[name].shape]
        if len(shape) == 5 and shape[1] in (None, 1):
            del shape[1]  # of several views, as Depth Anything 3 has it
        if len(shape) == 3:
            shape.insert(0, 1)
        lengths = [length for length in shape if length is not None]
        is_usable = (
            len(shape) == 4
            and shape[0] in (None, 1)
            and all(1 <= length <= MAX_SIDE_PX for length in lengths)
            and math.prod(lengths) <= _MAX_VALUES
        )
        if not is_usable:
            raise NetworkError(
                f"{self._path}: expected an input {name} [1, 3, height, width] of at most "
                f"{MAX_SIDE_PX} pixels a side, got "
                f"{shortened(str(self._infos[name].shape), 60)}."
            )
        return tuple(shape)

    def _n_channels(self, name: str) -> int:
        """Channels of one image in an input: 1 or 3."""
        shape = self._image_shape(name)
        n = shape[3 if self.has_channels_last else 1]
        n_images = 2 if self.contents[name] == "pair" else 1
        if n not in (None, n_images, 3 * n_images):
            raise NetworkError(
                f"{self._path}: expected {3 * n_images} channels of the input {name}, got {n}."
            )
        return 1 if n == n_images else 3

    def _image_blob(self, name: str, content: str, placed: dict[str, Image]) -> npt.NDArray[Any]:
        """One image input, with as many dimensions as the file has."""
        side, _, half = content.partition("/")
        keys = ("left", "right") if side == "pair" else (side,)
        planes = [self._normalised(placed[key], self._channels[name], bool(half)) for key in keys]
        info = self._infos[name]
        blob = np.concatenate(planes)  # (C, h, w)
        if _TYPES[info.type] is np.uint8:
            blob = np.clip(np.rint(blob), 0, 255)
        blob = blob.astype(_TYPES[info.type])
        if self.has_channels_last:
            blob = blob.transpose(1, 2, 0)
        return blob[(None,) * (len(info.shape) - 3)]

    def _normalised(self, image: Image, n_channels: int, is_half: bool) -> npt.NDArray[np.float32]:
        """(C, h, w) of one image."""
        import cv2

        if is_half:
            height, width = image.shape[:2]
            image = np.asarray(
                cv2.resize(image, (width // 2, height // 2), interpolation=cv2.INTER_AREA), np.uint8
            )
        if n_channels == 1:
            channels = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)[..., None]
        elif self._format.colours == "rgb":
            channels = image[..., ::-1]
        else:
            channels = image
        mean = np.array(self._format.mean[:n_channels], np.float32)
        std = np.array(self._format.std[:n_channels], np.float32)
        scaled = channels.astype(np.float32) * np.float32(1 / self._format.divisor)
        return ((scaled - mean) / std).transpose(2, 0, 1)

    def _extra(
        self, name: str, content: object, placement: InputPlacement, fx_px: float
    ) -> npt.NDArray[Any]:
        """An input that is no image."""
        info = self._infos[name]
        shape = [d if isinstance(d, int) else 1 for d in info.shape]
        if content in ("intrinsics", "rays"):
            values = placement.intrinsics(fx_px)
            if content == "rays":
                values = placement.rays(fx_px).transpose(2, 0, 1)
            values = values[(None,) * (len(shape) - values.ndim)]
        elif content == "zeros":
            values = np.zeros(shape)
        else:
            values = np.full(shape, float(str(content)))
        return values.astype(_TYPES[info.type])


def _listed(contents: set[str]) -> str:
    return " and ".join(sorted(contents))
