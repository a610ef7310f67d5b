"""gridslam: radio multipath in, a map out.

Public names are those of the stub beside this file. Each is imported when it is first asked for, so that a
program loads what it uses: grid SLAM needs neither the other methods nor the importers.
"""

import ast
import importlib
from importlib.util import find_spec
from pathlib import Path
from typing import Any

__version__ = "0.2.0"
_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
_HOMES = {
    name.asname or name.name: (str(line.module), name.name)
    for line in _STUB.body
    if isinstance(line, ast.ImportFrom)
    for name in line.names
}
__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    """A public name, or one of the package's rooms."""
    if name in _HOMES:
        home, known_as = _HOMES[name]
        value = globals()[name] = getattr(importlib.import_module(home), known_as)
        return value
    if name.isidentifier() and not name.startswith("_") and find_spec(f"gridslam.{name}"):
        return importlib.import_module(f"gridslam.{name}")
    raise AttributeError(f"module 'gridslam' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
