"""What docs/hooks.py makes: pages of commands, notebooks as pages, and texts of the API."""

import importlib.util
import sys
from types import ModuleType

import pytest

from tests.documentation.documented_commands import PROJECT
from track_range.results.rows.columns import column_names, result_columns


@pytest.fixture(scope="module")
def hooks():
    """docs/hooks.py; the packages of the documentation's build, which `[dev]` lacks, have
    stand-ins."""
    names = (
        "latex2mathml",
        "latex2mathml.converter",
        "mkdocs",
        "mkdocs.exceptions",
        "mkdocs.structure",
        "mkdocs.structure.files",
    )
    known = {name: sys.modules.get(name) for name in names}
    for name in names:
        sys.modules[name] = ModuleType(name)
    sys.modules["latex2mathml.converter"].convert = str
    sys.modules["mkdocs.exceptions"].PluginError = ValueError
    sys.modules["mkdocs.structure.files"].File = object
    spec = importlib.util.spec_from_file_location("hooks", PROJECT / "docs/hooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    for name, value in known.items():
        if value is None:
            del sys.modules[name]
        else:
            sys.modules[name] = value


def test_every_command_has_a_page(hooks):
    pages = {
        " ".join(words): hooks.command_page(words, command) for words, command in hooks.commands()
    }
    assert {"run", "fleet run", "rig check", "evaluate tracks", "models list", "train"} <= set(
        pages
    )
    assert all(
        text.startswith(f"# {name}\n\n") and f"track-range {name} [OPTIONS]" in text
        for name, text in pages.items()
    )
    assert "## Ranging\n" in pages["run"]
    assert "| `--focal-px PX` | Focal length in pixels" in pages["run"]
    assert "--stereo LEFT" not in pages["fleet run"]  # refused there, so hidden
    assert "## Arguments\n\n| name | meaning |\n|---|---|\n| `RECORDINGS` |" in pages["fleet run"]


def test_columns_have_a_table(hooks):
    lines = hooks.columns_table().splitlines()
    assert len(lines) == 2 + len(result_columns())
    assert lines[2] == "| `frame` |  | number of the frame, from 0 |"
    assert "| `gap_m` | m | distance from the front" in lines[2 + column_names().index("gap_m")]


def test_notebooks_are_pages(hooks):
    cells = [
        {"cell_type": "markdown", "source": ["# A title"]},
        {
            "cell_type": "code",
            "source": ["1 + 1"],
            "outputs": [
                {"data": {"text/plain": ["2"]}},
                {"data": {"image/png": "AAAA\n", "text/plain": "<Figure>"}},
            ],
        },
        {"cell_type": "code", "source": ["print(3)"], "outputs": [{"text": ["3\n"]}]},
    ]
    page = hooks.notebook_page({"cells": cells})
    assert page.startswith("# A title\n\n```python\n1 + 1\n```\n\n```text\n2\n```\n\n![Output")
    assert "data:image/png;base64,AAAA)" in page
    assert page.endswith("```python\nprint(3)\n```\n\n```text\n3\n```\n")


@pytest.mark.parametrize("page", sorted((PROJECT / "docs/reference/api").glob("*.md")))
def test_every_public_name_of_a_page_has_a_text(hooks, page):
    directives = hooks.re.findall(r"^::: \S+", page.read_text(encoding="utf-8"), hooks.re.MULTILINE)
    for directive in directives:
        assert hooks.re.sub(r"::: (\S+)", hooks._api_text, directive).startswith("## ")


def test_text_of_a_public_name(hooks):
    text = hooks.re.sub(r"::: (\S+)", hooks._api_text, "::: track_range.class_id")
    assert text.startswith("## class_id\n\n```python\nclass_id(")
    assert "ROAD_CLASSES" in text


def test_first_uses_of_terms_are_links(hooks):
    glossary = (
        "sigma\n:   Standard deviation. [Methods](methods.md#sigma)\n\nlane\n:   Width of "
        "`x`,\n    the lane.\n"
    )
    page = (
        '<h1>sigma</h1><p><a href="x"><code>lane</code> sigma</a> lane, sigmas and sigma, '
        "<code>lane</code></p>"
    )
    assert hooks.link_terms(page, glossary, "../g.html") == (
        '<h1>sigma</h1><p><a href="x"><code>lane</code> sigma</a> lane, <a class="term" '
        'href="../g.html#sigma" title="Standard deviation. Methods">sigmas</a> and sigma, <a '
        'class="term" href="../g.html#lane" title="Width of x, the lane."><code>lane</code></a></p>'
    )
    assert (
        hooks.link_terms("<p>sigma.txt, sigma-x, lane</p>", glossary, "")
        == "<p>sigma.txt, sigma-x, lane</p>"
    )
    assert hooks._anchor("`*_kf`") == hooks._anchor("<code>*_kf</code>") == "_kf"
    assert hooks._anchor("time to collision (TTC)") == "time-to-collision"
