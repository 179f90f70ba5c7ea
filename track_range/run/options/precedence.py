"""Settings of a run from the command line or keywords, `--settings FILE` and the defaults, in this
order of precedence.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from track_range.foundation.errors import ConfigError, UsageError
from track_range.foundation.schemas.validation import first_problem
from track_range.run.options.anonymity import check_named_files
from track_range.run.options.settings import RunSettings
from track_range.run.options.settings_file import read_settings

_ALTERNATIVES = (("mono", "stereo"), ("detections", "detector"), ("rig", "focal_px"))


def settings_from(options: Mapping[str, Any], file: Path | None = None) -> RunSettings:
    """Settings from options (None = not given), which override a settings.yaml.

    Invalid or contradicting options raise UsageError, an unreadable file, an unknown key or an
    invalid value in it ConfigError.
    """
    base = read_settings(file) if file else {}
    given = RunSettings.with_current_names(
        {key: value for key, value in options.items() if value is not None}
    )
    for one, other in _ALTERNATIVES:
        for key, alternative in ((one, other), (other, one)):
            if key in given and alternative not in given:
                base.pop(alternative, None)
    try:
        settings = RunSettings(**{**base, **given})
    except ValidationError as error:
        raise _error_of(error, given, file) from error
    if base.get("anonymize"):
        check_named_files(settings, [key for key in base if key not in given], file)
    return settings


def _error_of(error: ValidationError, given: Collection[str], file: Path | None) -> ConfigError:
    """The error for invalid settings; it names the file if all its causes are in the file."""
    sentence, causes = RunSettings.problem(error), RunSettings.causes(error)
    if file is None:
        return UsageError(sentence)
    is_given = not set(causes).isdisjoint(given)
    if len(causes) > 1 and is_given:
        return UsageError(f"{sentence.removesuffix('.')} (with the settings of {file}).")
    if is_given:
        return UsageError(sentence)
    is_value = len(causes) == 1 and causes[0] in RunSettings.model_fields
    if not is_value:
        return ConfigError(f"{file}: {sentence}")
    key, problem = first_problem(error)
    return ConfigError(f"{file}: 'run.{key}': {problem}.")
