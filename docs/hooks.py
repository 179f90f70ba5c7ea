"""Hooks of the documentation's build.

- Equations in TeX become MathML, which needs neither a script nor a font.
- One page per command is made from the settings models of the commands (`reference/cli/`).
- The table of the columns of tracks.csv is made from their declarations.
- Notebooks (`*.ipynb`) become pages with their stored outputs.
- The first use of a term of the glossary in the text of a page is a link to its definition.
- Every page is written as Markdown too, and `llms.txt` lists these files by relative links.
- A page that would load anything from the network is an error.
"""

from __future__ import annotations

import html
import inspect
import json
import posixpath
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

from track_range.cli.app import PROGRAM, app
from track_range.cli.shared import lazy
from track_range.results.rows.columns import result_columns

_COLUMNS = "<!-- columns -->"
"""Place of the table of columns in a page."""

CLI = "reference/cli"
"""Folder of the pages of commands."""

_EQUATION = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\s*\\(?P<open>[(\[])(?P<tex>.*?)\\[)\]]\s*</(?P=tag)>',
    re.DOTALL,
)
"""An equation as the extension pymdownx.arithmatex leaves it: in a span in running text, in a div
on its own."""

_REMOTE = re.compile(
    r"<(?:script|link|img|iframe|source|video)\b[^>]*(?:src|href)=\"?(?:https?:)?//[^\"> ]+"
)
"""A tag that loads something from another address."""

GLOSSARY = "concepts/glossary.md"
"""Page of the terms."""

_TERM = re.compile(r"^(\S.*)\n:   (.+(?:\n    .*)*)", re.MULTILINE)
"""A term of the glossary and its definition."""

_ORDINARY = {"bias", "fused", "ground", "lane", "observed", "stereo", "truth"}
"""Terms that are ordinary words, too: only linked where they are written as code."""

_AMBIGUOUS = {"clip", "coverage"}
"""Terms with another meaning on some pages: never linked."""

_NO_TEXT = re.compile(r"(<(a|h\d|pre|code|figcaption|math)\b.*?</\2>|<[^>]*>)", re.DOTALL)
"""Tags, and elements in which no term is linked."""

_markdown: dict[str, tuple[str, str]] = {}
"""Title and text of each page by its path, for the copies in Markdown."""


# -- pages of commands
# ------------------------------------------------------------------------------------------------


def on_config(config: Any) -> None:
    """Add the pages of commands to the navigation."""
    listed = [{" ".join(words): _cli_path(words)} for words, _ in commands()]
    (reference,) = (
        entries for group in config["nav"] for name, entries in group.items() if name == "Reference"
    )
    reference.append({"Command line": [f"{CLI}/index.md", *listed]})


def on_files(files: Any, config: Any) -> None:
    """Add the pages of commands and of notebooks to the files."""
    pages = {_cli_path(words): command_page(words, command) for words, command in commands()}
    pages[f"{CLI}/index.md"] = _index_page()
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    for file in [file for file in files if file.src_uri.endswith(".ipynb")]:
        text = notebook_page(json.loads(Path(file.abs_src_path).read_text(encoding="utf-8")))
        files.remove(file)
        files.append(
            File.generated(config, file.src_uri.removesuffix(".ipynb") + ".md", content=text)
        )


def commands() -> Iterator[tuple[list[str], Any]]:
    """Words and command of everything that can be invoked, in the order of the help pages."""

    def below(group: Any, words: list[str]) -> Iterator[tuple[list[str], Any]]:
        for name in group.commands:
            command = group.load(name) if hasattr(group, "load") else group.commands[name]
            is_group = hasattr(command, "commands")
            if not command.hidden and (not is_group or command.invoke_without_command):
                yield [*words, name], command
            if is_group:
                yield from below(command, [*words, name])

    yield from below(typer.main.get_command(app), [])


def command_page(words: list[str], command: Any) -> str:
    """Page of a command: what it does, its arguments and options by panel, and its examples."""
    visible = [
        parameter
        for parameter in command.params
        if not parameter.hidden and parameter.opts != ["--help"]
    ]
    arguments = [parameter for parameter in visible if parameter.param_type_name == "argument"]
    usage = " ".join([PROGRAM, *words, "[OPTIONS]", *map(lazy._argument_name, arguments)])
    parts = [
        f"# {' '.join(words)}",
        command.help or "",
        getattr(command, "description", ""),
        f"```text\n{usage}\n```",
    ]
    tables = {
        "Arguments": [(lazy._argument_name(parameter), parameter.help) for parameter in arguments]
    }
    for parameter in visible:
        if parameter not in arguments:
            panel = parameter.rich_help_panel or "Options"
            tables.setdefault(panel, []).append((lazy._option_name(parameter), parameter.help))
    for heading, rows in tables.items():
        if rows:
            lines = [f"| `{name}` | {_cell(text or '')} |" for name, text in rows]
            parts.append("\n".join([f"## {heading}\n", "| name | meaning |", "|---|---|", *lines]))
    if command.examples:
        parts.append("## Examples\n\n```sh\n" + "\n".join(command.examples) + "\n```")
    return "\n\n".join(part for part in parts if part) + "\n"


def _index_page() -> str:
    rows = [
        f"| [`{' '.join(words)}`]({'-'.join(words)}.md) | {_cell(command.help)} |"
        for words, command in commands()
    ]
    return (
        f"# Command line\n\nEach page is made from the options that the program has; `{PROGRAM} "
        "COMMAND --help` prints the same. The word `run` may be omitted. Exit status: 0 = success, "
        "1 = an unusable input or output, or a run that the user stopped, 2 = wrong usage, 3 = "
        "some clips of a fleet failed.\n\n| command | what it does "
        "|\n|---|---|\n" + "\n".join(rows) + "\n"
    )


def _cli_path(words: list[str]) -> str:
    return f"{CLI}/{'-'.join(words)}.md"


def _cell(text: str) -> str:
    """Text of a cell of a table; characters that Markdown would interpret are escaped."""
    return re.sub(r"([*_<>{}|])", r"\\\1", text)


# -- notebooks
# --------------------------------------------------------------------------------------------------------


def notebook_page(notebook: dict[str, Any]) -> str:
    """Page of a notebook: its text, its code, and the stored outputs, of which pictures are part of
    the page.
    """
    parts = []
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            data = output.get("data", {"text/plain": output.get("text", "")})
            if "image/png" in data:
                parts.append(
                    "![Output of the cell "
                    f"above](data:image/png;base64,{''.join(data['image/png']).strip()})"
                )
            elif text := "".join(data["text/plain"]).rstrip():
                parts.append(f"```text\n{text}\n```")
    return "\n\n".join(parts) + "\n"


# -- pages
# ------------------------------------------------------------------------------------------------------------


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """The text with the table of columns; it is kept for its copy in Markdown, too."""
    markdown = markdown.replace(_COLUMNS, columns_table())
    _markdown[page.file.src_uri] = (
        page.title,
        re.sub(r"^::: (\S+)\n?(?:    .*\n?)*", _api_text, markdown, flags=re.MULTILINE),
    )
    return markdown


def columns_table() -> str:
    """Name, unit and meaning of each column of tracks.csv."""
    lines = [f"| `{one.name}` | {one.unit} | {one.meaning} |" for one in result_columns()]
    return "\n".join(["| column | unit | meaning |", "|---|---|---|", *lines])


def _api_text(reference: re.Match[str]) -> str:
    """Signature and docstring of a public name, in the place of the directive that shows it."""
    module, _, name = reference[1].rpartition(".")
    value = getattr(import_module(module), name)
    try:
        signature = str(inspect.signature(value)) if callable(value) else f" = {value!r}"
        if "__signature__" in getattr(value, "__dict__", {}):
            signature = ""  # a class that is created by its class methods
    except ValueError:
        signature = ""
    return (
        "## "
        f"{name}\n\n```python\n{name}{signature}\n```\n\n{inspect.getdoc(value) if callable(value) else ''}\n\n"
    )


def on_page_content(page_html: str, *, page: Any, config: Any, **_: Any) -> str:
    """The page with its equations in MathML and links to the glossary; terms of the glossary get
    anchors.
    """
    page_html = _EQUATION.sub(_mathml, page_html)
    if page.file.src_uri == GLOSSARY:
        return re.sub(
            r"<dt>(.*?)</dt>", lambda term: f'<dt id="{_anchor(term[1])}">{term[1]}</dt>', page_html
        )
    if page.file.src_uri == "project/architecture.md":  # its rooms have the names of methods
        return page_html
    text = (Path(config["docs_dir"]) / GLOSSARY).read_text(encoding="utf-8")
    folder = posixpath.dirname(page.file.dest_uri)
    return link_terms(
        page_html, text, posixpath.relpath(GLOSSARY.replace(".md", ".html"), folder or ".")
    )


def link_terms(page_html: str, glossary: str, address: str) -> str:
    """The page with a link to the definition at the first use of each term: as code, or as a word
    of the text.
    """
    words, codes = {}, {}
    for term, definition in _TERM.findall(glossary):
        plain = term.strip("`").removesuffix(" (TTC)")
        if plain in _AMBIGUOUS:
            continue
        tip = html.escape(
            re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", " ".join(definition.split())).replace("`", "")
        )
        link = f'<a class="term" href="{address}#{_anchor(term)}" title="{tip}">', plain
        codes[plain] = link
        if plain not in _ORDINARY and re.fullmatch(r"[\w -]{3,}", plain):
            words[plain] = link
    pattern = re.compile(
        rf"(?<![\w-])({'|'.join(sorted(map(re.escape, words), key=len, reverse=True))})s?(?![\w-]|\.\w)"
    )
    used: set[str] = set()

    def linked(use: re.Match[str]) -> str:
        start, term = words[use[1]]
        if term in used:
            return use[0]
        used.add(term)
        return f"{start}{use[0]}</a>"

    parts = _NO_TEXT.split(page_html)
    for i in range(0, len(parts), 3):  # text, element, name of the element
        parts[i] = pattern.sub(linked, parts[i])
        element = parts[i + 1] if i + 1 < len(parts) else ""
        if (
            (code := re.fullmatch(r"<code>([^<]+)</code>", element))
            and code[1] in codes
            and code[1] not in used
        ):
            used.add(code[1])
            parts[i + 1] = f"{codes[code[1]][0]}{element}</a>"
    return "".join(part for i, part in enumerate(parts) if i % 3 < 2)


def _anchor(term: str) -> str:
    """Anchor of a term of the glossary, from its Markdown or HTML."""
    return re.sub(r"\W+", "-", re.sub(r"<[^>]*>|\(.*\)", "", term)).strip("-").lower()


def _mathml(equation: re.Match[str]) -> str:
    tex = html.unescape(equation["tex"]).strip()
    if equation["open"] == "(":
        return convert(tex)
    return f'<div class="equation">{convert(tex, display="block")}</div>'


def on_post_build(*, config: Any, **_: Any) -> None:
    """Write the copies in Markdown and llms.txt, and check that no page loads anything from the
    network.

    Raises:
        PluginError: a page does.
    """
    site = Path(config["site_dir"])
    for path, (_, text) in _markdown.items():
        (site / path).write_text(text, encoding="utf-8")
    (site / "llms.txt").write_text(_llms_text(config), encoding="utf-8")
    for page in sorted(site.rglob("*.html")):
        if (remote := _REMOTE.search(page.read_text(encoding="utf-8"))) is not None:
            raise PluginError(f"{page}: expected no address on the network, found {remote.group()}")


def _llms_text(config: Any) -> str:
    """Contents of the documentation for language models (llmstxt.org): each page as a relative link
    to its Markdown.
    """
    lines = [f"# {config['site_name']}", "", f"> {config['site_description']}"]

    def add(entries: list[Any]) -> None:
        for entry in entries:
            for below in entry.values() if isinstance(entry, dict) else [entry]:
                if isinstance(below, list):
                    add(below)
                else:
                    lines.append(f"- [{_markdown[below][0]}]({posixpath.normpath(below)})")

    for group in config["nav"]:
        for name, entries in group.items():
            lines.extend(("", f"## {name}", ""))
            add(entries)
    return "\n".join(lines) + "\n"
