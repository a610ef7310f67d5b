"""What names may be, since they end up as folders, in tables, in HDF5 and on the screen."""

from __future__ import annotations

import re
import unicodedata
from typing import Annotated

from pydantic import AfterValidator, Field

from gridslam.world.validation import fault

RUN_FILES = frozenset(
    (
        "figures",
        "run.json",
        "scene.toml",
        "report.html",
        "map.h5",
        "clocks.csv",
        "clocks.h5",
        "map.yaml",
        "map.pgm",
        "reflection.yaml",
        "reflection.pgm",
    )
)
"""What a run's folder holds beside the agents' folders."""
DEVICES = frozenset(("con", "prn", "aux", "nul", "conin$", "conout$")) | {
    f"{port}{number}" for port in ("com", "lpt") for number in "0123456789¹²³"
}
"""Names that are no files on Windows, whatever follows after a dot."""
FORMULA = tuple("=+-@")
"""How a cell of a table begins that a spreadsheet would compute."""
LONGEST, LONGEST_BYTES = 100, 200
"""Characters of a name; bytes of a folder's, which leave room for the endings of its figures."""
PRINTED = f"1 to {LONGEST} printed characters, no blank at the ends, not {' '.join(FORMULA)} first"
FOLDER = "letters, digits, space, _ . + -, not . or space last (it names a folder)"


def label_fault(name: str) -> str | None:
    """Say what is allowed instead of a name that goes into tables and HDF5 files; None if it may."""
    bare = 0 < len(name) <= LONGEST and name.isprintable() and name == name.strip()
    return PRINTED if not bare or name.startswith(FORMULA) else None


def folder_fault(name: str) -> str | None:
    """Say what is allowed instead of a name that a folder within a run's gets; None if it may."""
    if not re.fullmatch(r"\w[\w .+-]*", name) or name[-1] in " .":
        return FOLDER
    if label_fault(name) is not None:
        return PRINTED
    if len(name.encode("utf-8")) > LONGEST_BYTES:
        return f"at most {LONGEST_BYTES} bytes in UTF-8 (it names a folder)"
    if name.casefold() in RUN_FILES:
        return "a name that no file of a run's folder has"
    if name.partition(".")[0].rstrip().casefold() in DEVICES:
        return "a name that is no device of Windows"
    return None


def same_folder(name: str) -> str:
    """What two names have in common if some file system takes them for one: case and composed letters."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def _label(name: str) -> str:
    allowed = label_fault(name)
    if allowed is not None:
        raise fault("", repr(name), allowed)
    return name


def _folder(name: str) -> str:
    allowed = folder_fault(name)
    if allowed is not None:
        raise fault("", repr(name), allowed)
    return name


Sized = Annotated[str, Field(min_length=1, max_length=LONGEST)]
Label = Annotated[Sized, AfterValidator(_label)]
FolderName = Annotated[Sized, AfterValidator(_folder)]
