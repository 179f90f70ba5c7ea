"""The messages that docs/start/troubleshooting.md quotes are messages of the program."""

import re

from tests.documentation.documented_commands import PAGES, PROJECT

ROOMS = ("detection", "tracking", "stereo", "ranging", "track_range")


def plain(text):
    return " ".join(text.replace("`", "").casefold().split())


def program_texts():
    """The code of the program with adjacent texts joined, and a zero byte in the place of each
    value in them."""
    code = "\n".join(
        path.read_text(encoding="utf-8")
        for room in ROOMS
        for path in (PROJECT / room).rglob("*.py")
    )
    return plain(re.sub(r"\{[^{}\n]*\}", "\0", re.sub(r'"\s+f?"', "", code)))


def test_quoted_messages_exist():
    page = PAGES["docs/start/troubleshooting.md"]
    tables = re.findall(
        r"^\| the message has the words .*\n\|[-| ]+\n((?:\|.*\n)+)", page, re.MULTILINE
    )
    quoted = [row.split("|")[1] for table in tables for row in table.splitlines()]
    assert len(quoted) > 80
    texts = program_texts()
    examples = re.findall(r"^track-range: \S+: ([^\d;]+)", page, re.MULTILINE)
    assert len(examples) == 3
    assert [example for example in examples if plain(example) not in texts] == []
    parts = [part.strip(" .") for quote in quoted for part in map(plain, quote.split("..."))]
    assert [part for part in parts if part not in texts] == []
    assert "words that no message has" not in texts
