"""One file per published method: its time step as the list of the messages of its paper.

`gridslam.systems.grid` and the others are imported when they are first asked for.
"""

import importlib
from importlib.util import find_spec
from typing import Any


def __getattr__(name: str) -> Any:
    """A method's module."""
    if name.isidentifier() and not name.startswith("_") and find_spec(f"{__name__}.{name}"):
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
