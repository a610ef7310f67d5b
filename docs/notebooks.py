"""Runs the notebooks of `examples/` and writes what their cells show into them: `python docs/notebooks.py`.

A notebook is JSON: cells of Markdown, and of Python that run one after the other in one namespace. That is
all it takes here; readers open them in Jupyter, or look at them as they are.
"""

from __future__ import annotations

import ast
import base64
import io
import json
import os
import sys
import tempfile
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PICTURE_DPI = 72
"""Small pictures: they lie in the repository."""


def code_cells(notebook: Path) -> list[str]:
    """The Python of a notebook's cells."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def shown(source: str, where: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    """Run a cell in a namespace; what it shows: what is printed, and the value of its last expression."""
    body = ast.parse(source, where).body
    last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
    printed = io.StringIO()
    with redirect_stdout(printed):
        exec(compile(ast.Module(body, []), where, "exec"), names)
        value = None
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), where, "eval"), names)
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        outputs.append({"name": "stdout", "output_type": "stream", "text": _lines(printed.getvalue())})
    if value is not None:
        outputs.append({"data": _data(value), "metadata": {}, "output_type": "display_data"})
    return outputs


def _data(value: Any) -> dict[str, Any]:
    """A value as notebooks show it: a figure as a picture, anything else as text."""
    if not hasattr(value, "savefig"):
        return {"text/plain": _lines(repr(value))}
    picture = io.BytesIO()
    style: dict[str, Any] = {"bbox_inches": "tight", "metadata": {"Software": None}}
    value.savefig(picture, format="png", dpi=PICTURE_DPI, **style)
    return {"image/png": base64.b64encode(picture.getvalue()).decode(), "text/plain": ["<Figure>"]}


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def run(notebook: Path) -> None:
    """Run all cells of a notebook, and write it with what they show."""
    content, names = json.loads(notebook.read_text(encoding="utf-8")), dict[str, Any]()
    for number, cell in enumerate(content["cells"]):
        cell["id"] = f"cell{number}"
        if cell["cell_type"] == "code":
            cell["outputs"] = shown("".join(cell["source"]), f"{notebook.name}, cell {number + 1}", names)
    notebook.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    import matplotlib

    matplotlib.use("Agg")
    chosen = [Path(name).resolve() for name in sys.argv[1:]] or sorted(EXAMPLES.glob("*.ipynb"))
    os.chdir(tempfile.mkdtemp())  # for the files that they write
    for path in chosen:
        run(path)
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")
