"""Pages of the docs as they are run: their commands and their Python, from the top to the bottom."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
RUN = re.compile(r"^```(sh|python)\n(.*?)^```", re.M | re.S)


def blocks(page):
    """What a page has to be run, in order: (language, text). `text` and `py` are for reading alone."""
    return RUN.findall(page.read_text(encoding="utf-8"))


def commands(text):
    """The words of the commands of gridslam in a block of a shell."""
    lines = (line for line in text.splitlines() if line.startswith("gridslam "))
    return [shlex.split(line, comments=True)[1:] for line in lines]
