"""Looks over the built pages: `python docs/check_pages.py build/docs` fails where they aren't whole offline.

Every local link leads to a page or file that is there, and to a place in it; no page loads anything from
elsewhere.
"""

from __future__ import annotations

import html
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ELSEWHERE = re.compile(r'<(?:script|img|link)\b[^>]*(?:src|href)="(https?:[^"]+\.(?:js|css|woff2?|png|svg))')


@cache
def places(page: Path) -> set[str]:
    """Names that a link to a page may have after its #."""
    return set(re.findall(r'\bid="([^"]+)"', page.read_text(encoding="utf-8")))


def faults(root: Path) -> Iterator[str]:
    """What is wrong with the pages in a folder, in a line each."""
    for page in sorted(root.rglob("*.html")):
        text, name = page.read_text(encoding="utf-8"), page.relative_to(root)
        for link in map(html.unescape, re.findall(r'<a\b[^>]*\bhref="([^"]+)"', text)):
            if link.startswith(("http:", "https:", "mailto:")):
                continue
            file, _, place = link.partition("#")
            target = (page.parent / file).resolve() if file else page
            if not target.exists() or (place and target.suffix == ".html" and place not in places(target)):
                yield f"{name}: dead link {link}"
        for address in ELSEWHERE.findall(text):
            yield f"{name}: loads {address}"


if __name__ == "__main__":
    found = sorted(set(faults(Path(sys.argv[1]))))
    print("\n".join(found) or "pages: every local link leads somewhere, nothing is loaded from elsewhere")
    sys.exit(1 if found else 0)
