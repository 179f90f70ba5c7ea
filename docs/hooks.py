"""Hooks of the documentation's build: equations in TeX become MathML, which needs neither a script nor a font."""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

_EQUATION = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\s*\\(?P<open>[(\[])(?P<tex>.*?)\\[)\]]\s*</(?P=tag)>', re.DOTALL
)
"""An equation as the extension pymdownx.arithmatex leaves it: in a span in running text, in a div on its own."""


def on_page_content(page_html: str, **_: Any) -> str:
    """The page with its equations in MathML."""
    return _EQUATION.sub(_mathml, page_html)


def _mathml(equation: re.Match[str]) -> str:
    tex = html.unescape(equation["tex"]).strip()
    if equation["open"] == "(":
        return convert(tex)
    return f'<div class="equation">{convert(tex, display="block")}</div>'
