"""A page that opens anywhere, offline: what reports of runs and of studies are made of."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from html import escape
from pathlib import Path

from gridslam.io.files import refuse_taken, write_bytes

NAME, TITLE = "report.html", "gridslam: "
HEAD = 1000
"""Characters in which the title stands."""
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem;
       color: #1b1b1b; background: #fff; text-size-adjust: 100%; -webkit-text-size-adjust: 100% }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2.2rem; border-bottom: 1px solid #ccc }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .6rem 0 }
th, td { padding: .2rem .8rem .2rem 0; text-align: right; border-bottom: 1px solid #eee }
th:first-child, td:first-child { text-align: left } th:last-child, td:last-child { padding-right: 0 }
figure { margin: 1rem 0 } figcaption { color: #555; font-size: .9rem }
img, video { max-width: 100%; height: auto }
details { margin: .6rem 0 } .wide { overflow-x: auto } details td { white-space: nowrap }
@media (max-width: 40rem) { body { margin: 1rem auto } table { font-size: .8rem } }
"""
MIME = {".png": "image/png", ".gif": "image/gif", ".mp4": "video/mp4", ".svg": "image/svg+xml"}


def write_page(folder: Path, title: str, parts: Iterable[str]) -> Path:
    """Write the page of a folder and return its path.

    Raises
    ------
    InputError
        It can't be written to.
    """
    target = folder / NAME
    write_bytes(target, _page(f"{TITLE}{title}", "\n".join(parts)).encode("utf-8"))
    return target


def refuse_other(folder: Path, overwrite: bool) -> None:
    """Refuse to replace what has the page's name and isn't such a page.

    Raises
    ------
    InputError
        There is one, and it isn't to be overwritten.
    """
    if not _is_report(folder / NAME):
        refuse_taken([folder / NAME], overwrite)


def _is_report(page: Path) -> bool:
    """Whether a file is one that `write_report` wrote."""
    try:
        with page.open(encoding="utf-8") as text:
            return f"<title>{TITLE}" in text.read(HEAD)
    except (OSError, UnicodeDecodeError):
        return False


def _page(title: str, body: str) -> str:
    # nothing outside the page is loaded, and nothing in it can run, whatever a name in a file says
    rule = "default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'"
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{rule}">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def picture(path: Path, text: str) -> str:
    """A picture of a file with words below it, as HTML."""
    text = escape(text, quote=True)
    return f'<figure><img alt="{text}" src="{data_of(path)}"><figcaption>{text}</figcaption></figure>'


def data_of(path: Path) -> str:
    """A picture's or film's content as an address that needs no file."""
    code = base64.b64encode(path.read_bytes()).decode("ascii")
    return f"data:{MIME[path.suffix]};base64,{code}"


def table(titles: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Rows of text as HTML."""
    head = "".join(f"<th>{escape(title)}</th>" for title in titles)
    body = "\n".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table><tr>{head}</tr>\n{body}</table></div>'
