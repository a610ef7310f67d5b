"""What pages of the docs show is what happens: their commands and Python run from top to bottom."""

import ast
import importlib.util
import json
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from docs_pages import PAGES, ROOT, blocks, commands
from scene_samples import shortened

import gridslam as gs

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
QUOTING = {"architecture"}
"""Pages that quote code which another test compares."""
SHOWN = [page for page in PAGES if blocks(page) and page.stem not in QUOTING]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
MOST_NOTEBOOK_BYTES = 300_000
"""Pictures in it included."""
HEAVY = ("robustness", "bench")
"""Commands whose options alone are tried: they have no brief scene."""
MOST_RUNS = 2
"""Of a study, whatever its page says."""

STEPS, STEPS_OF = 4, {"hybrid": 12}
"""Of a bundled scene, and on pages that need more: elements of an array are told from ten steps on."""


@pytest.fixture
def brief(request, monkeypatch, runs_here):
    """Cut the bundled scenes short: the pages' words are tested here, not their patience."""
    whole, page = gs.Scene.load, request.node.callspec.params.get("page")
    steps = STEPS_OF.get(page.stem, STEPS) if page else STEPS

    def load(source):
        scene = whole(source)
        known = str(source) in gs.bundled_scenes()
        return (
            shortened(scene, steps, agents=len(scene.agents)).with_filter(particles=100) if known else scene
        )

    monkeypatch.setattr(gs.Scene, "load", staticmethod(load))


def sionna_traces():
    """Whether Sionna RT can run here, tried in another process: too old an LLVM ends it."""
    text = "import sionna.rt as rt; rt.load_scene(rt.scene.box)"
    return find_spec("sionna") and not subprocess.run([sys.executable, "-c", text], check=False).returncode


def test_pages_that_run_are_not_forgotten():
    tutorials = set((ROOT / "docs" / "tutorials").glob("*.md"))
    assert tutorials | {ROOT / "README.md", ROOT / "docs/start.md", ROOT / "docs/command-line.md"} <= set(
        SHOWN
    )


@pytest.mark.slow
@pytest.mark.parametrize("page", SHOWN, ids=lambda page: page.stem)
def test_page_runs_from_top_to_bottom(page, brief, say, no_figures, monkeypatch, tmp_path):
    if page.stem == "sionna" and not sionna_traces():
        pytest.skip("Sionna RT isn't installed, or has no LLVM that it likes")
    monkeypatch.syspath_prepend(str(tmp_path))
    before, names = set(sys.modules), {}
    for number, (language, text) in enumerate(blocks(page)):
        if language == "python":
            exec(compile(text, f"{page.name}, block {number + 1}", "exec"), names)
            continue
        for words in commands(text):
            if "--runs" in words:
                after = words.index("--runs") + 1
                words[after] = str(min(int(words[after]), MOST_RUNS))
            result = say(*words, *(["--help"] if words[0] in HEAVY else []))
            notice = re.compile(r"note: |\d+ of \d+ runs$")  # progress
            notes = [line for line in result.complaints if not notice.match(line)]
            assert (result.code, notes) == (0, []), words
    for name in set(sys.modules) - before:  # modules that a page wrote
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_python_that_is_for_reading_alone_speaks_of_what_there_is(page):
    for text in re.findall(r"^```py\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "gs":
                assert hasattr(gs, node.attr), node.attr
            if isinstance(node, ast.ImportFrom) and node.module.startswith("gridslam"):
                module = importlib.import_module(node.module)
                assert all(hasattr(module, alias.name) for alias in node.names)


def runner():
    spec = importlib.util.spec_from_file_location("notebooks", ROOT / "docs/notebooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run_and_show_something(notebook, brief, monkeypatch, tmp_path):
    """All cells in order; what is stored in the file is of the same kinds as what they show now."""
    monkeypatch.chdir(tmp_path)
    kept = [cell for cell in json.loads(notebook.read_text())["cells"] if cell["cell_type"] == "code"]
    run, names = runner(), {}
    assert any("image/png" in output.get("data", {}) for cell in kept for output in cell["outputs"])
    for cell, source in zip(kept, run.code_cells(notebook), strict=True):
        now = run.shown(source, notebook.name, names)
        assert [sorted(o.get("data", {})) for o in now] == [
            sorted(o.get("data", {})) for o in cell["outputs"]
        ]
    assert notebook.stat().st_size < MOST_NOTEBOOK_BYTES


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_links_of_notebooks_lead_somewhere(notebook):
    cells = json.loads(notebook.read_text())["cells"]
    words = "".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    links = re.findall(r"\]\(([^)#]+)", words)
    assert links
    assert all((notebook.parent / link).exists() for link in links)


@pytest.mark.parametrize("example", sorted((ROOT / "examples").glob("*.py")), ids=lambda path: path.stem)
def test_examples_run(example, say, brief, no_figures, monkeypatch):
    """Those that are a method of one's own run as such; the others by themselves."""
    text = example.read_text(encoding="utf-8")
    named = re.search(rf"--method {example.stem}:(\w+)", text)
    if named is None:
        spec = importlib.util.spec_from_file_location("__main__", example)
        spec.loader.exec_module(importlib.util.module_from_spec(spec))
        return
    monkeypatch.syspath_prepend(str(example.parent))
    assert say("run", "room", "--method", f"{example.stem}:{named[1]}", "-o", "out").code == 0
    assert Path("out/run.json").exists()
