"""Runs the notebooks of the documentation and stores their outputs: `python docs/notebooks.py
FOLDER`.

FOLDER has the files that the notebooks name. Cells are plain Python, which Jupyter runs as it is;
this program needs no kernel (nbclient with ipykernel would be 25 packages).
"""

import ast
import base64
import contextlib
import io
import json
import os
import sys
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure


def executed(notebook: dict[str, Any]) -> dict[str, Any]:
    """The notebook with the outputs of its cells: what they print, and the value of their last
    expression.

    A `Figure` is shown as PNG, other values as text, None not at all. The cells share their
    variables, and run in the current folder.
    """
    names: dict[str, Any] = {}
    cells = []
    for number, cell in enumerate(notebook["cells"]):
        if cell["cell_type"] == "code":
            cell = {
                **cell,
                "execution_count": number,
                "outputs": _outputs("".join(cell["source"]), names),
            }
        cells.append(cell)
    return {**notebook, "cells": cells}


def _outputs(source: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    steps = ast.parse(source).body
    last = ast.Expression(steps.pop().value) if isinstance(steps[-1], ast.Expr) else None  # type: ignore[attr-defined]
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(ast.Module(steps, []), "notebook", "exec"), names)  # noqa: S102 - our own text
        value = None if last is None else eval(compile(last, "notebook", "eval"), names)  # noqa: S307
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        outputs.append(
            {
                "output_type": "stream",
                "name": "stdout",
                "text": printed.getvalue().splitlines(keepends=True),
            }
        )
    if value is not None:
        data = {"text/plain": repr(value)}
        if isinstance(value, Figure):
            value.savefig(png := io.BytesIO(), dpi=90, format="png", metadata={"Software": None})
            data = {
                "text/plain": "<Figure>",
                "image/png": base64.b64encode(png.getvalue()).decode(),
            }
        outputs.append(
            {"output_type": "execute_result", "execution_count": None, "metadata": {}, "data": data}
        )
    return outputs


if __name__ == "__main__":
    paths = [path.resolve() for path in Path(__file__).parent.rglob("*.ipynb")]
    os.chdir(sys.argv[1])
    for path in paths:
        shown = executed(json.loads(path.read_text(encoding="utf-8")))
        path.write_text(json.dumps(shown, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
