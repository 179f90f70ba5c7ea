"""The catalogue of detectors that can be downloaded: names, addresses, licences and published
checksums.

The models are not part of track-range: `detection/catalogue/download.py` downloads a model from the
release of its project into the user's cache folder. A model is listed only if the checksums of all
its files are published elsewhere (OpenCV's opencv_extra and opencv_zoo, OpenVINO's Open Model Zoo,
Git LFS, or several independent projects).
"""

from dataclasses import dataclass

from track_range.detection.classes import COCO_CATEGORIES, COCO_CLASSES


@dataclass(frozen=True, slots=True)
class Licence:
    """A licence, and in one sentence what it requires from users of the model."""

    name: str
    meaning: str


@dataclass(frozen=True, slots=True)
class ModelFile:
    """One file of a release."""

    name: str  # file name in the cache folder
    url: str
    checksum: str  # published checksum, algorithm and hexadecimal digest, such as `sha256:...`
    size_bytes: int | None  # published size; None = not published


@dataclass(frozen=True, slots=True, kw_only=True)
class CatalogueEntry:
    """One model that can be downloaded, from a release of a project."""

    name: str  # the model's name; `NAME.onnx` in the cache folder is the model ready to run
    family: str  # family of the network, as shown by `track-range models info`
    input: str  # size and number type of the network's input, for display
    # an ONNX file, or Darknet's cfg and weights, which are imported after the download
    files: tuple[ModelFile, ...]
    licence: Licence
    project: str
    release: str
    classes: tuple[str, ...] = COCO_CLASSES  # class names in the network's order
    # side of an input of variable size, as in training; None = its own, or the default
    size_px: int | None = None

    @property
    def is_darknet(self) -> bool:
        """Whether the files are Darknet's, which are imported before use."""
        return any(file.name.endswith(".weights") for file in self.files)

    @property
    def size_bytes(self) -> int:
        """Total size of the download, without files of unpublished size (a few kB of text)."""
        return sum(file.size_bytes or 0 for file in self.files)

    @property
    def notice(self) -> str:
        """Notice for the user before the download: size, project, licence and what the licence
        requires.
        """
        return (
            f"{self.name}: {self.size_bytes / 1e6:.1f} MB from {self.project} ({self.release}), "
            f"licence {self.licence.name}: {self.licence.meaning}"
        )


APACHE = Licence(
    "Apache-2.0",
    "may be used, modified and redistributed, including commercially, if the licence notices are preserved.",
)
AGPL = Licence(
    "AGPL-3.0",
    "GNU Affero General Public License: software that contains this model and is distributed, or used by others over a "
    "network, must be offered with its source code under the same licence; the owner also sells commercial licences.",
)
PUBLIC_DOMAIN = Licence("public domain", "Darknet's licence permits any use.")

_YOLOX = "https://github.com/Megvii-BaseDetection/YOLOX/releases/download/0.1.1rc0"
_DARKNET = "https://github.com/AlexeyAB/darknet/releases/download"
_DARKNET_TEXT = "https://raw.githubusercontent.com/AlexeyAB/darknet"
_OPENCV_ZOO = "https://media.githubusercontent.com/media/opencv/opencv_zoo/47534e27c9851bb1128ccc0102f1145e27f23f98/models"
_ONNX_COMMUNITY = "https://huggingface.co/onnx-community"


def _onnx(name: str, url: str, checksum: str, size_bytes: int) -> tuple[ModelFile]:
    return (ModelFile(f"{name}.onnx", url, checksum, size_bytes),)


def _yolox(name: str, side_px: int, checksum: str, size_bytes: int) -> CatalogueEntry:
    return CatalogueEntry(
        name=name,
        family="yolox",
        input=f"{side_px}x{side_px}",
        files=_onnx(name, f"{_YOLOX}/{name}.onnx", checksum, size_bytes),
        licence=APACHE,
        project="Megvii-BaseDetection/YOLOX",
        release="0.1.1rc0",
    )


# fmt: off
CATALOGUE: tuple[CatalogueEntry, ...] = (
    _yolox("yolox_nano", 416, "sha256:c789161ed43c8269fcd4e67c67eeeb4e80c622da2eb296a20bc6007bd18a0b7d", 3_659_407),
    _yolox("yolox_tiny", 416, "sha256:427cc366d34e27ff7a03e2899b5e3671425c262ea2291f88bb942bc1cc70b0f7", 20_219_662),
    _yolox("yolox_s", 640, "sha1:0249e66522b38462e6962915a8850a5908023a1c", 35_858_002),
    CatalogueEntry(
        name="yolov4-tiny", family="yolov4-tiny", input="416x416", licence=PUBLIC_DOMAIN,
        project="AlexeyAB/darknet", release="yolov4 (weights of December 2020)",
        files=(
            ModelFile(
                "yolov4-tiny.cfg", f"{_DARKNET_TEXT}/0faed3e60e52f742bbef43b83f6be51dd30f373e/cfg/yolov4-tiny.cfg",
                "sha256:f858e3724962eedf3ac44e3b6cb3f0c3d9ed067c306bb831f539c578b924c90e", 3_231,
            ),
            ModelFile(
                "yolov4-tiny.weights", f"{_DARKNET}/yolov4/yolov4-tiny.weights",
                "sha1:451caaab22fb9831aa1a5ee9b5ba74a35ffa5dcb", 24_251_276,
            ),
        ),
    ),
    CatalogueEntry(
        name="yolov4", family="yolov4", input="608x608", licence=PUBLIC_DOMAIN,
        project="AlexeyAB/darknet", release="darknet_yolo_v3_optimal",
        files=(
            ModelFile(
                "yolov4.cfg", f"{_DARKNET_TEXT}/59596d7880f6504768df41d6daa586f5cb2b932f/cfg/yolov4.cfg",
                "sha256:a6d0f8e5c62cc8378384f75a8159b95fa2964d4162e33351b00ac82e0fc46a34", None,
            ),
            ModelFile(
                "yolov4.weights", f"{_DARKNET}/darknet_yolo_v3_optimal/yolov4.weights",
                "sha1:0143deb6c46fcc7f74dd35bf3c14edc3784e99ee", 257_717_640,
            ),
        ),
    ),
    CatalogueEntry(
        name="yolov5n", family="yolov5", input="640x640 FP16", licence=AGPL,
        project="ultralytics/yolov5", release="v7.0",
        files=_onnx(
            "yolov5n", "https://github.com/ultralytics/yolov5/releases/download/v7.0/yolov5n.onnx",
            "sha1:90aa4b5f8e1ba19166f214f3e4258e5d1d05070b", 3_981_910,
        ),
    ),
    CatalogueEntry(
        name="yolov10n", family="yolov10", input="640x640", licence=AGPL, project="THU-MIG/yolov10", release="v1.1",
        files=_onnx(
            "yolov10n", "https://github.com/THU-MIG/yolov10/releases/download/v1.1/yolov10n.onnx",
            "sha256:7025ea1913f9a259cf8a8465ed608e10610d1bb376db2e0348b13e3bd286e0d3", 9_386_466,
        ),
    ),
    CatalogueEntry(
        name="yolo26n", family="yolo26", input="640x640", licence=AGPL, project="ultralytics/assets", release="v8.4.0",
        files=_onnx(
            "yolo26n", "https://github.com/ultralytics/assets/releases/download/v8.4.0/yolo26n.onnx",
            "sha256:2e947b787d9e787b93a16772a5f55b1d4d8c4d86f53146149c5d6a642442d6f7", 9_941_957,
        ),
    ),
    CatalogueEntry(
        name="nanodet-m", family="nanodet", input="416x416", licence=APACHE,
        project="opencv/opencv_zoo", release="object_detection_nanodet_2022nov",
        files=_onnx(
            "nanodet-m", f"{_OPENCV_ZOO}/object_detection_nanodet/object_detection_nanodet_2022nov.onnx",
            "sha256:4b82da9944b88577175ee23a459dce2e26e6e4be573def65b1055dc2d9720186", 3_800_954,
        ),
    ),
    CatalogueEntry(
        name="dfine-s", family="d-fine", input="640x640", size_px=640, licence=APACHE,
        project="onnx-community/dfine_s_coco-ONNX", release="a3cf0314",
        files=_onnx(
            "dfine-s",
            f"{_ONNX_COMMUNITY}/dfine_s_coco-ONNX/resolve/a3cf03147a9b86c78475139115c8ac142577352d/onnx/model.onnx",
            "sha256:cd8a49a945feda6d28c6304ae8ae85c2759ba1d78a5a83a22c5ce8db82ef7238", 41_535_197,
        ),
    ),
    CatalogueEntry(
        name="rf-detr-nano", family="rf-detr", input="384x384", size_px=384, classes=COCO_CATEGORIES, licence=APACHE,
        project="onnx-community/rfdetr_nano-ONNX", release="eae21cee",
        files=_onnx(
            "rf-detr-nano",
            f"{_ONNX_COMMUNITY}/rfdetr_nano-ONNX/resolve/eae21cee0687a91bcf9fa071605c48d7705d2d91/onnx/model.onnx",
            "sha256:9cbac6b11ce34a03034e4d5a24cfac5f18632fd6761d1311dd640232088d7fee", 108_074_865,
        ),
    ),
)
# fmt: on


def entry_named(name: str) -> CatalogueEntry | None:
    """The catalogue entry with this name, or None; case is ignored, and - and _ are equivalent."""
    key = name.strip().lower().replace("_", "-")
    return next((entry for entry in CATALOGUE if entry.name.replace("_", "-") == key), None)
