"""Imports within `gridslam/checks` go one way, in the order that the package's docstring tells."""

import ast
import re
from pathlib import Path

from gridslam import checks

PACKAGE = Path(checks.__file__).parent
ORDER = re.findall(r"^`(\w+)` ", checks.__doc__, re.M)


def imported(file):
    """Folders of `gridslam.checks` that a file imports from."""
    nodes = [
        node for node in ast.walk(ast.parse(file.read_text("utf-8"))) if isinstance(node, ast.ImportFrom)
    ]
    parts = [node.module.split(".") for node in nodes if node.module.startswith("gridslam.checks")]
    assert all(len(one) > 2 for one in parts), file
    return {one[2] for one in parts}


def test_every_folder_is_told_and_holds_all_files():
    assert sorted(ORDER) == sorted(path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists())
    assert [file.name for file in PACKAGE.glob("*.py")] == ["__init__.py"]


def test_imports_go_one_way():
    for place, folder in enumerate(ORDER):
        for file in (PACKAGE / folder).glob("*.py"):
            assert imported(file) <= set(ORDER[: place + 1]), file


def test_the_page_tells_the_same_order():
    page = (PACKAGE.parents[1] / "docs" / "architecture.md").read_text(encoding="utf-8")
    (row,) = [line for line in page.splitlines() if line.startswith("| `checks/` |")]
    assert [name for name in re.findall(r"`(\w+)`", row) if name in ORDER] == ORDER
