"""The exception about label and detection files."""

from track_range.foundation.errors import UserError


class LabelFileError(UserError):
    """An invalid label or detection file; the message names the file, the line and the expected
    content.
    """
