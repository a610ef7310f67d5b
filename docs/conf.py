"""How Sphinx builds these pages: `sphinx-build -W docs build/docs`."""

import re
from importlib.metadata import version as version_of
from pathlib import Path

from sphinx.application import Sphinx

project, author = "gridslam", "The gridslam authors"
release = version_of("gridslam")
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
]
exclude_patterns = ["README.md", "api.md", "*.toml"]
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
html_theme = "furo"
html_title = f"gridslam {release}"
autodoc_typehints = "none"  # docstrings have shapes and units, which types haven't
napoleon_google_docstring, napoleon_numpy_docstring = False, True
napoleon_use_rtype, napoleon_use_ivar = False, True
# links to files of the repository (tests/test_docs.py follows them), and names that several classes have
suppress_warnings = ["myst.xref_missing", "ref.python"]


ALONE = r"^```.*?^```|\$\$.*?\$\$|\$[^$]*\$|`[^`]*`|\[[^\[\]]*\]\([^)\s]*\)"
FORMULA = re.compile(rf"({ALONE})|\((M\d+)\)", re.M | re.S)
"""A formula that is cited, as (M1), or, first, what is left alone."""


def finish(app: Sphinx, name: str, source: list[str]) -> None:
    """What pages have here beyond what GitHub shows: pages below their index, and formulas that are links."""
    if name in ("model", "notebook"):  # the side bar has what they list, in their order
        pages = re.findall(rf"\]\(({name}/[\w-]+)\.md\)", source[0])
        source[0] += "\n".join(("", "```{toctree}", ":hidden:", "", *pages, "```", ""))
    index = Path(app.env.doc2path("model")).read_text(encoding="utf-8")
    where = dict(re.findall(r"\[(M\d+)\]\((model/[^)]+)\)", index))
    source[0] = FORMULA.sub(
        lambda found: f"([{found[2]}](/{where[found[2]]}))" if found[2] in where else found[0], source[0]
    )


def setup(app: Sphinx) -> None:
    """What Sphinx calls."""
    app.connect("source-read", finish)
