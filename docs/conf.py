"""How Sphinx builds these pages: `sphinx-build -W docs build/docs`."""

import re
from importlib.metadata import version as version_of

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


def hang(_: Sphinx, name: str, source: list[str]) -> None:
    """Hangs the pages that the indices of model and notebook list below them, in their order."""
    if name in ("model", "notebook"):
        pages = re.findall(rf"\]\(({name}/[\w-]+)\.md\)", source[0])
        source[0] += "\n".join(("", "```{toctree}", ":hidden:", "", *pages, "```", ""))


def setup(app: Sphinx) -> None:
    """What Sphinx calls."""
    app.connect("source-read", hang)
