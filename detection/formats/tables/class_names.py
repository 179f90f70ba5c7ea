"""Files with the names of the class numbers of labels, such as classes.txt and data.yaml."""

from pathlib import Path

from track_range.detection.classes import names_of
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.files.input_files import read_text
from track_range.foundation.files.structured_text import read_yaml

# in the order in which they are tried
_NAME_FILES = ("classes.txt", "data.yaml", "data.yml", "obj.names")


def names_for_folder(folder: Path) -> tuple[str, ...]:
    """Class names in classes.txt, data.yaml or obj.names of a folder of labels or its parent; () if
    there are none.
    """
    files = [parent / name for parent in (folder, folder.parent) for name in _NAME_FILES]
    for file in (*files, folder.parent.parent / "data.yaml"):  # the last as in exports of Roboflow
        if not file.is_file():
            continue
        if file.suffix in (".txt", ".names"):
            text = read_text(file, LabelFileError, "class names, one per line")
            return tuple(line.strip() for line in text.splitlines() if line.strip())
        return names_in(read_yaml(file, LabelFileError, "the class names of labels"), file)
    return ()


def names_in(document: object, file: Path) -> tuple[str, ...]:
    """Class names in the content of a data.yaml; LabelFileError unless they are a list, or numbered
    from 0.
    """
    if not isinstance(document, dict) or document.get("names") is None:
        raise LabelFileError(
            f"{file}: expected 'names', the class names in the order of their numbers, found none."
        )
    try:
        return names_of(document["names"])
    except ValueError as error:
        raise LabelFileError(f"{file}: 'names': {error}.") from error
