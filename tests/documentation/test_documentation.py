"""The README and the pages of docs/ agree with the program: commands, options, columns, names and
links."""

import re
import tomllib

import pytest
import typer
import yaml

import track_range as tr
from tests.documentation.documented_commands import (
    OPTION,
    PAGES,
    PROJECT,
    README,
    blocks,
    command_of,
    commands,
    inline_code,
    is_command,
    options_of,
    python_blocks,
    subcommand,
    track_range_commands,
)
from track_range.cli.app import app
from track_range.foundation.schemas.schema_version import SCHEMA_VERSION
from track_range.results.events.event import EVENT_COLUMNS, EVENT_KINDS
from track_range.results.rows.columns import result_columns
from track_range.results.summary_shape import _SUMMARY
from track_range.results.writers import result_names

FOREIGN_OPTIONS = {"--strict", "--cov", "--numprocesses"}
"""Options of other programs that pages name."""

GLOSSARY = (
    *(
        "mono",
        "ground",
        "lane",
        "stereo",
        "sgbm",
        "fused",
        "`*_kf`",
        "sigma",
        "coverage",
        "common coverage",
        "rig",
    ),
    *("alignment", "track activation"),
)


def all_options(command):
    """Options of a command and of all below it."""
    below = (subcommand(command, name) for name in getattr(command, "commands", {}))
    return options_of(command).union(*(all_options(part) for part in below))


@pytest.fixture(scope="module")
def known_options():
    return all_options(typer.main.get_command(app)) | {"--help"} | FOREIGN_OPTIONS


@pytest.mark.parametrize(("page", "line"), track_range_commands())
def test_command_exists(page, line):
    _, command, rest = command_of(line)
    is_group = hasattr(command, "commands") and not command.invoke_without_command
    assert not is_group or rest == ["--version"], "no such command"
    assert {word for word in rest if OPTION.fullmatch(word)} <= options_of(command) | {"--help"}


def test_versions_agree():
    version = tomllib.loads((PROJECT / "pyproject.toml").read_text())["project"]["version"]
    assert yaml.safe_load((PROJECT / "CITATION.cff").read_text())["version"] == version
    assert f"version = {{{version}}}" in PAGES["docs/project/citing.md"]
    heading = re.search(r"^## (.*)$", (PROJECT / "CHANGELOG.md").read_text(), re.MULTILINE)[1]
    assert re.fullmatch(rf"{re.escape(version)} \((unreleased|\d{{4}}-\d\d-\d\d)\)", heading)
    current = re.findall(
        r"^\| (\d+) \| ([\d.]+) \|", PAGES["docs/reference/schema.md"], re.MULTILINE
    )[-1]
    assert current[0] == str(SCHEMA_VERSION)
    assert version.startswith(current[1])


def test_help_of_fleets_names_no_refused_option():
    _, command, _ = command_of("track-range fleet run recordings/")
    taken = {
        option for parameter in command.params if not parameter.hidden for option in parameter.opts
    }
    named = {
        option
        for parameter in command.params
        if not parameter.hidden
        for option in OPTION.findall(parameter.help or "")
    }
    assert named <= taken


@pytest.mark.parametrize("page", PAGES)
def test_options_in_text_exist(page, known_options):
    comments = [line.partition("#")[2] for block in blocks(PAGES[page]) for line in block]
    texts = [
        code
        for code in inline_code(PAGES[page])
        if not code.startswith(("python -m benchmarks", "pip ", "git "))
    ]
    assert {
        option for text in (*texts, *comments) for option in OPTION.findall(text)
    } <= known_options


def test_commands_are_found():
    assert len(track_range_commands()) > 60
    assert len(commands(README)) >= 6
    assert all(is_command(line) for line in commands(README))


@pytest.mark.parametrize("page", PAGES)
def test_python_blocks_compile(page):
    for code in python_blocks(PAGES[page]):
        compile(code, page, "exec")
        assert set(re.findall(r"\btr\.(\w+)", code)) <= set(tr.__all__)


def test_error_of_the_example(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (code,) = python_blocks(PAGES["docs/reference/api/errors.md"])
    exec(compile(code, "errors.md", "exec"), {})  # noqa: S102 - our own text
    assert f"# {capsys.readouterr().out.strip()}\n" in code


@pytest.mark.parametrize("page", PAGES)
def test_linked_files_exist(page):
    folder = (PROJECT / page).parent
    links = [
        link
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", PAGES[page])
        if not link.startswith("http")
    ]
    # pages of commands are made with the site, whose build checks links to them
    if page != "README.md":
        links = [link for link in links if "cli/" not in link]
    assert [
        link for link in links if not (folder / link).exists() or not (folder / link).stat().st_size
    ] == []


def test_figures_of_the_readme_are_those_of_their_protocol():
    section = README.partition("## Accuracy")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| \[([^]]+)\]\((\S+?)#(\S+)\) \|(.*)$", section, re.MULTILINE)
    assert len(rows) >= 7
    for name, page, anchor, figures in rows:
        headings = re.split(r"^(?=## )", PAGES[page], flags=re.MULTILINE)
        (protocol,) = (
            part
            for part in headings
            if re.sub(r"\W+", "-", part.split("\n")[0][3:].lower()) == anchor
        )
        missing = [
            figure
            for figure in re.findall(r"\d+(?:\.\d+)?", figures)
            if figure not in re.findall(r"\d+(?:\.\d+)?", protocol)
        ]
        assert missing == [], name


def test_make_targets_exist():
    makefile = (PROJECT / "Makefile").read_text()
    named = {
        line.split()[1]
        for text in PAGES.values()
        for line in commands(text)
        if line.startswith("make ")
    }
    assert {"demo", "test", "docs", "check"} <= named
    assert [
        target for target in named if not re.search(rf"^{target}:", makefile, re.MULTILINE)
    ] == []


def test_extras_exist():
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text())["project"]
    extras = {extra for text in PAGES.values() for extra in re.findall(r"\.\[(\w+)\]", text)}
    assert extras == set(project["optional-dependencies"])
    assert set(re.findall(r"\.\[(\w+)\]", README)) == extras - {"bench", "dev", "docs"}
    assert "Python 3.11 or newer" in README
    assert project["requires-python"] == ">=3.11"


def test_links_of_columns_are_defined():
    """The page of the columns has their table, and defines the links in their meanings."""
    section = PAGES["docs/reference/results.md"].partition("## tracks.csv")[2].partition("\n## ")[0]
    assert "<!-- columns -->" in section
    defined = set(re.findall(r"^\[(.+)\]: ", section, re.MULTILINE))
    used = {
        link for column in result_columns() for link in re.findall(r"\[(.+?)\]", column.meaning)
    }
    assert used == defined
    assert [column.name for column in result_columns() if not column.meaning] == []


def test_event_columns_are_documented():
    table = PAGES["docs/reference/results.md"].partition("## events.csv")[2].partition("\n## ")[0]
    assert tuple(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) == EVENT_COLUMNS
    assert [kind for kind in EVENT_KINDS if f"`{kind}`" not in table] == []


def test_result_files_are_documented():
    assert [
        name for name in result_names() if f"`{name}`" not in PAGES["docs/reference/results.md"]
    ] == []


def test_summary_keys_are_documented():
    section = (
        PAGES["docs/reference/results.md"].partition("## summary.json")[2].partition("\n## ")[0]
    )
    missing = [
        key for key in _SUMMARY.model_fields if key != "settings" and f"`{key}`" not in section
    ]
    assert missing == []


def test_public_names_are_documented():
    pages = {name: text for name, text in PAGES.items() if name.startswith("docs/reference/api/")}
    shown = [
        name
        for text in pages.values()
        for name in re.findall(r"^::: track_range\.(\S+)$", text, re.MULTILINE)
    ]
    public = [name for name in shown if "." not in name]
    modules = {"errors": tr.errors, "evaluate": tr.evaluate}
    assert sorted(public) == sorted(set(tr.__all__) - {"__version__", *modules})
    for module, names in modules.items():
        of_module = [name.rpartition(".")[2] for name in shown if name.startswith(f"{module}.")]
        assert sorted(of_module) == sorted(names.__all__)
    listed = re.findall(
        r"`(\w+)`",
        pages["docs/reference/api/index.md"].partition("|---|---|---|")[2].partition("\n\n")[0],
    )
    assert sorted(listed) == sorted(name.rpartition(".")[2] for name in shown)
    assert [name for name, text in pages.items() if not python_blocks(text)] == [
        "docs/reference/api/index.md"
    ]


def test_methods_are_documented():
    headings = re.findall(r"^## (\w+)", PAGES["docs/concepts/methods.md"], re.MULTILINE)
    assert [method.name for method in tr.ranging_methods() if method.name not in headings] == []


def test_glossary_has_the_terms():
    terms = re.findall(r"^(\S.*)\n: ", PAGES["docs/concepts/glossary.md"], re.MULTILINE)
    assert [term for term in GLOSSARY if term not in terms] == []
    assert terms == sorted(terms, key=lambda term: term.strip("`*_").casefold())


def paths(entries):
    """Paths of the pages of an entry of the navigation, which is a path, or a list of entries."""
    if isinstance(entries, str):
        return [entries]
    below = [
        part
        for entry in entries
        for part in (entry.values() if isinstance(entry, dict) else [entry])
    ]
    return [path for part in below for path in paths(part)]


def test_navigation_has_every_page():
    # Tags of Python objects are not needed here.
    text = re.sub(r"!!python/\S+", "", (PROJECT / "mkdocs.yml").read_text())
    pages = [
        page
        for group in yaml.safe_load(text)["nav"]
        for entries in group.values()
        for page in paths(entries)
    ]
    notebooks = [
        path.relative_to(PROJECT).as_posix() for path in (PROJECT / "docs").rglob("*.ipynb")
    ]
    written = [page for page in PAGES if page.startswith("docs/")] + [
        f"{name.removesuffix('.ipynb')}.md" for name in notebooks
    ]
    assert sorted(f"docs/{page}" for page in pages) == sorted(written)


def test_pages_load_nothing_from_the_network():
    text = (PROJECT / "mkdocs.yml").read_text()
    assert "font: false" in text
    assert "http" not in text
    assert not any("http" in path.read_text() for path in (PROJECT / "docs/assets").iterdir())


def test_rig_file_of_the_page_loads(tmp_path):
    (code,) = re.findall(
        r"```yaml\n(track_range_rig.*?)```", PAGES["docs/start/camera.md"], re.DOTALL
    )
    (tmp_path / "rig.yaml").write_text(code)
    assert tr.load_rig(tmp_path / "rig.yaml").baseline_m == pytest.approx(0.54)
