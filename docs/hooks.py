"""Hooks of the documentation's build.

Equations in TeX become MathML, which needs neither a script nor a font. A page that would load anything from the
network is an error.
"""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError

_EQUATION = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\s*\\(?P<open>[(\[])(?P<tex>.*?)\\[)\]]\s*</(?P=tag)>', re.DOTALL
)
"""An equation as the extension pymdownx.arithmatex leaves it: in a span in running text, in a div on its own."""

_REMOTE = re.compile(r"<(?:script|link|img|iframe|source|video)\b[^>]*(?:src|href)=\"?(?:https?:)?//[^\"> ]+")
"""A tag that loads something from another address."""


def on_page_content(page_html: str, **_: Any) -> str:
    """The page with its equations in MathML."""
    return _EQUATION.sub(_mathml, page_html)


def _mathml(equation: re.Match[str]) -> str:
    tex = html.unescape(equation["tex"]).strip()
    if equation["open"] == "(":
        return convert(tex)
    return f'<div class="equation">{convert(tex, display="block")}</div>'


def on_post_build(*, config: Any, **_: Any) -> None:
    """Check that no page loads anything from the network.

    Raises:
        PluginError: a page does.
    """
    for page in sorted(Path(config["site_dir"]).rglob("*.html")):
        if (remote := _REMOTE.search(page.read_text(encoding="utf-8"))) is not None:
            raise PluginError(f"{page}: expected no address on the network, found {remote.group()}")
