"""Version of the result files, and the check of files that another version wrote."""

from collections.abc import Mapping

# of result files; increased when a column, key or unit changes its meaning or is removed
SCHEMA_VERSION = 2
# of keys in the metadata of files, so that they differ from other programs'
METADATA_PREFIX = "track_range."
_MAX_DIGITS = 9  # number of digits to which a version is read; longer ones are newer in any case


def schema_version_of(metadata: Mapping[bytes, bytes] | None) -> int | None:
    """Schema version in the metadata of an Arrow schema; None if it is missing or invalid."""
    text = (metadata or {}).get(f"{METADATA_PREFIX}schema_version".encode(), b"")
    return int(text[:_MAX_DIGITS]) if text.isdigit() else None


def check_schema_version(
    path: object, metadata: Mapping[bytes, bytes] | None, error: type[Exception]
) -> None:
    """Raise `error` if the schema metadata of an Arrow file state a newer version; no version is
    accepted.
    """
    schema_version = schema_version_of(metadata)
    if schema_version is not None and schema_version > SCHEMA_VERSION:
        raise error(
            f"{path}: expected schema_version {SCHEMA_VERSION} or earlier, found {schema_version}, "
            "of a newer track-range; update with `pip install --upgrade track-range`."
        )
