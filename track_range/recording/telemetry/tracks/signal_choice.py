"""SignalChoice: the signal of the speed in a log of many, as an option names it."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalChoice:
    """The speed among the signals of a log, as the user names it."""

    name: str = ""  # of a signal, perhaps after that of its group or message; "" = the only speed
    database: Path | None = None  # DBC of the messages of a bus


ANY_SIGNAL = SignalChoice()
