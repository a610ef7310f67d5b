"""Docs and citations: links, keys, files and quotes lead to what is there."""

import inspect
import re
import subprocess
import xml.etree.ElementTree as ET
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest
from docs_scripts import script
from floors import FLOORS

from gridslam.systems import grid
from gridslam.systems.registry import METHODS

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(ROOT.glob("*.md")) + sorted(DOCS.rglob("*.md"))
OURS = Path(__file__).resolve()
KEY = r"\[([A-Z][A-Za-z]+\d{4}[a-z]\w*|LiangDirect|HybridSlam)\](?!\()"
"""A citation, as [Li2026grid]."""
HEADING = re.compile(r"^#+ +(.+?) *$", re.M)
FILE = re.compile(
    r"`((?:[\w-]+/)+[\w.-]*\.(?:py|md|toml|svg)|[\w-]+\.py|(?:[\w-]+/)+)`((?:: `[\w.]+`(?:, `[\w.]+`)*)?)"
)

GENERATED = ("scene-file", "file-formats", "methods", "model", "notebook")
MOST_WORDS, MOST_WORDS_OF_A_PARAGRAPH = 5000, 150
"""Of a page of model or notebook."""


@cache
def texts() -> dict[Path, str]:
    """All text that belongs to the project, but this file."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    names = listed.stdout.split("\0") if listed.returncode == 0 else []
    files = [ROOT / name for name in names if name]
    if not files:  # no checkout, as in a source archive
        folders = (ROOT / name for name in ("gridslam", "kernels", "scenes", "tests", "docs"))
        files = [*PAGES, *(file for folder in folders for file in folder.rglob("*"))]
    kinds = {".py", ".md", ".toml", ".svg", ".cff"}
    plain = (file for file in files if file.suffix in kinds and file.is_file() and file != OURS)
    return {file: file.read_text(encoding="utf-8") for file in plain}


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)


@cache
def anchors(page: Path) -> dict[str, str]:
    """What GitHub makes of a page's headings, with the text below each."""
    found: dict[str, str] = {}
    _, *parts = HEADING.split(prose(page))
    for heading, text in zip(parts[::2], parts[1::2], strict=True):
        plain = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading)
        name = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        number = sum(
            other == name or re.fullmatch(rf"{re.escape(name)}-\d+", other) is not None for other in found
        )
        found[f"{name}-{number}" if number else name] = text
    return found


def model() -> str:
    """The model, all of its pages."""
    pages = [DOCS / "model.md", *sorted((DOCS / "model").glob("*.md"))]
    assert len(pages) > 20
    return "\n".join(page.read_text(encoding="utf-8") for page in pages)


def given(text: str) -> list[str]:
    """Formulas that get their number in a text: beside them, or bold where a sentence is the formula."""
    found = re.findall(r"\\text\{(\(M\d+\)(?:, \(M\d+\))*)\}|\*\*(\(M\d+\))\*\*", text)
    return [number for place in found for number in re.findall(r"\((M\d+)\)", "".join(place))]


def found_at(name: str) -> Path | None:
    """The file or folder that docs call so: from the top of the repository, or from `gridslam/` on."""
    places = (ROOT / name, ROOT / "gridslam" / name)
    return next((place for place in places if place.exists()), None)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_link_is_dead(page):
    for link in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if link.startswith(("http:", "https:", "mailto:")):
            continue
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target.resolve()), link


def test_every_cited_key_is_in_the_bibliography():
    known = set(
        re.findall(r"^\*\*\[(\w+)\]\*\*", (DOCS / "bibliography.md").read_text(encoding="utf-8"), re.M)
    )
    assert known
    cited = {(key, file) for file, text in texts().items() for key in re.findall(KEY, text)}
    assert {key for key, _ in cited} > {"Li2026grid", "Li2025adaptive"}
    assert {(key, file.name) for key, file in cited if key not in known} == set()


def test_every_formula_that_is_cited_is_in_the_model():
    known = set(given(model()))
    cited = {(name, file.name) for file, text in texts().items() for name in re.findall(r"\((M\d+)\)", text)}
    assert {pair for pair in cited if pair[0] not in known} == set()


@pytest.mark.parametrize("room", ["gridslam/inference", "kernels"])
def test_files_that_cite_formulas_are_named_in_the_model(room):
    page = model()
    cites = [
        str(file.relative_to(ROOT)).removeprefix("gridslam/")
        for file, text in texts().items()
        if file.suffix == ".py" and file.is_relative_to(ROOT / room) and re.search(r"\(M\d+\)", text)
    ]
    assert len(cites) > 20
    assert [name for name in cites if f"`{name}`" not in page] == []


def test_numbers_in_the_model_are_given_once():
    numbers = given(model())
    assert len(numbers) == len(set(numbers)) > 240


def test_every_formula_is_listed_with_the_heading_below_which_it_is_given():
    """The index leads from a number alone to the formula: to its page, and to the heading above it."""
    index = (DOCS / "model.md").read_text(encoding="utf-8")
    listed = re.findall(r"\[(M\d+)\]\(model/([\w-]+)\.md#([\w-]+)\)", index)
    there = [
        (number, page.stem, place)
        for page in (DOCS / "model").glob("*.md")
        for place, text in anchors(page).items()
        for number in given(text)
    ]
    assert sorted(listed) == sorted(there)
    assert listed == sorted(listed, key=lambda one: int(one[0][1:]))


def test_every_page_of_the_model_is_listed_with_the_formulas_that_it_gives():
    index = (DOCS / "model.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| \[.*?\]\(model/([\w-]+)\.md\) \| .* \| (.*) \|$", index, re.M)
    assert [int(section) for section, *_ in rows] == sorted(int(section) for section, *_ in rows)
    assert {section for section, *_ in rows} == {str(section) for section in range(1, 17)}
    assert {name for _, name, _ in rows} == {page.stem for page in (DOCS / "model").glob("*.md")}
    for section, name, formulas in rows:
        text = (DOCS / "model" / f"{name}.md").read_text(encoding="utf-8")
        runs = [[int(n) for n in re.findall(r"\d+", run)] for run in formulas.split(", ")]
        numbers = {f"M{n}" for run in runs for n in range(run[0], run[-1] + 1)}
        assert numbers == set(given(text)), name
        assert text.startswith(f"# {section}. "), name


@pytest.mark.parametrize("folder", ["model", "notebook"])
def test_pages_of_model_and_notebook_can_be_read_at_a_sitting(folder):
    """They were one page of 39 000 words and one of 36 000."""
    index = (DOCS / f"{folder}.md").read_text(encoding="utf-8")
    pages = {page.stem: page for page in (DOCS / folder).glob("*.md")}
    assert set(re.findall(rf"\]\({folder}/([\w-]+)\.md\)", index)) == set(pages)
    for name, page in pages.items():
        text = page.read_text(encoding="utf-8")
        assert len(text.split()) < MOST_WORDS, name
        for paragraph in re.sub(r"^(\|.*|\$\$.*?^\$\$)$", "", text, flags=re.M | re.S).split("\n\n"):
            words = re.sub(r"\$[^$]+\$", "x", paragraph).split()
            assert len(words) < MOST_WORDS_OF_A_PARAGRAPH, (name, paragraph[:60])


@pytest.mark.parametrize("pattern", [r"papers? 00\d", r"(?<![\w/(`-])model\.md"], ids=["paper", "model"])
def test_nothing_is_cited_that_an_outsider_cannot_find(pattern):
    """Papers have keys, and the model stands at docs/model.md; links within docs name it alone."""
    for file, text in texts().items():
        assert re.search(pattern, text) is None, f"{file.name}: {re.search(pattern, text)}"


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda page: page.name)
def test_files_and_names_that_docs_give_are_there(page):
    for name, inside in FILE.findall(prose(page)):
        place = found_at(name)
        assert place is not None, name
        for word in re.findall(r"`(?:\w+\.)*(\w+)`", inside):
            assert re.search(rf"\b{word}\b", place.read_text(encoding="utf-8")), f"{name}: {word}"


def test_every_equation_of_grid_slams_paper_is_given_functions_that_are_there():
    page = (DOCS / "architecture.md").read_text(encoding="utf-8")
    section = page.split("### Where each equation of the papers is")[1].split("\n### ")[0]
    own = section.split("| [Li2025adaptive] |")[0]
    numbered = {int(n) for row in re.findall(r"^\| (\(.*?) \|", own, re.M) for n in re.findall(r"\d+", row)}
    assert numbered == {*range(1, 15), 17, 20, 23, 26, 27, 30, 33, 36, 39, *range(42, 47)}
    for name, inside in FILE.findall(section):
        place = found_at(name)
        if not inside:
            continue
        assert place is not None, name
        for word in re.findall(r"`(\w+)`", inside):
            found = re.search(rf"^ *(def|class) {word}\b", place.read_text(encoding="utf-8"), re.M)
            assert found, (name, word)


def test_quoted_step_is_that_of_grid_slam():
    blocks = re.findall(
        r"^```python\n(.*?)^```", (DOCS / "architecture.md").read_text(encoding="utf-8"), re.M | re.S
    )
    assert inspect.getsource(grid.step) in blocks


@pytest.mark.parametrize("picture", sorted(DOCS.rglob("*.svg")), ids=lambda picture: picture.name)
def test_pictures_are_well_formed(picture):
    root = ET.parse(picture).getroot()
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert root.find("{*}title") is not None


def test_picture_of_the_architecture_shows_the_floors_that_are_tested():
    names = ET.parse(DOCS / "architecture.svg").getroot().findall("{*}g[@id='rooms']/{*}text")
    floors: dict[float, list[str]] = {}
    for name in names:
        floors.setdefault(float(name.attrib["y"]), []).append(str(name.text))
    assert [" ".join(floors[y]) for y in sorted(floors)] == list(FLOORS)


@pytest.mark.parametrize("page", [f"{name}.md" for name in GENERATED])
def test_generated_page_is_the_one_that_is_committed(page):
    """If it isn't: `python docs/generate.py` (and a line on what is new, where it says so)."""
    drawn = script("generate").PAGES
    assert page in drawn
    assert drawn[page]() == (DOCS / page).read_text(encoding="utf-8")


def test_every_page_is_listed_for_readers_here_and_in_the_built_pages():
    """Those of model and notebook by their indices, below which conf.py hangs them."""
    pages = {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}
    pages = {page for page in pages if not page.startswith(("model/", "notebook/"))}
    listed = set(re.findall(r"\]\(([\w/-]+\.md)", (DOCS / "README.md").read_text(encoding="utf-8")))
    assert listed == pages - {"README.md", "index.md", "api-reference.md"}
    tree = re.findall(r"^([a-z][\w/-]+)$", (DOCS / "index.md").read_text(encoding="utf-8"), re.M)
    assert {f"{name}.md" for name in tree} == pages - {"README.md", "index.md", "api.md"}


def test_names_of_the_api_are_there():
    import gridslam

    names = set(re.findall(r"`gs\.(\w+)`", (DOCS / "api.md").read_text(encoding="utf-8")))
    assert names <= set(gridslam.__all__)
    assert len(names) > 15


def test_words_of_health_that_are_explained_are_said():
    """The words of notes in docs/troubleshooting.md stand in the code, numbers and names apart."""
    source = next(text for file, text in texts().items() if file.parts[-2:] == ("health", "reasons.py"))
    page = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    notes = page[page.index("## The run") : page.index("| errors of centimetres")]
    phrases = re.findall(r"^\| `([^`]+)` \|", notes, re.M)
    assert len(phrases) > 5
    for phrase in phrases:
        for part in re.split(r" ?\b[NMX]\b(?: %)? ?", phrase):
            assert part.strip(" ,") in source, phrase


def test_ways_of_random_plans_cross_no_wall():
    plans = script("random_plans")
    for seed in (10, 12, 13):
        scene = plans.scene_of(seed, 30.0, "grid")
        assert scene == plans.scene_of(seed, 30.0, "grid")
        way = scene.track("agent1").position_m[::10].tolist()
        walls = [(a, b) for wall in scene.walls for a, b in pairwise(wall.points_m)]
        assert len(walls) > 2
        assert not any(plans.crosses(a, b, wall) for a, b in pairwise(way) for wall in walls)


def test_faults_of_built_pages_are_found(tmp_path):
    """The gate looks them over: dead links, places that aren't there, and what is loaded from elsewhere."""
    module = script("check_pages")
    first = '<h1 id="top"></h1><a href="b.html#here">b</a><a href="https://x.org">x</a>'
    good, bad = tmp_path / "good", tmp_path / "bad"
    for folder, second in (
        (good, '<p id="here"></p><a class="k" href="a.html#top">a</a>'),
        (bad, '<script src="https://x.org/m.js"></script><a href="c.html">c</a>'),
    ):
        folder.mkdir()
        (folder / "a.html").write_text(first)
        (folder / "b.html").write_text(second)
    assert list(module.faults(good)) == []
    assert list(module.faults(bad)) == [
        "a.html: dead link b.html#here",
        "b.html: dead link c.html",
        "b.html: loads https://x.org/m.js",
    ]
    assert "python docs/check_pages.py build/docs" in (ROOT / ".ci/run").read_text()


def test_defaults_of_filters_are_not_said_to_be_the_papers_where_they_differ():
    page = (DOCS / "scene-file.md").read_text(encoding="utf-8")
    assert "the defaults are the papers'" not in page
    (row,) = re.findall(r"^\| `particles` \|.*$", page, re.M)
    assert "`10000`" in row
    assert "60 000" in row


def test_every_method_says_whether_it_is_published_ours_or_a_variant():
    page = (DOCS / "methods.md").read_text(encoding="utf-8")
    whose = dict(re.findall(r"^\| `([\w-]+)` \| [^|]+ \| (published|ours|a variant)\b", page, re.M))
    assert list(whose) == list(METHODS)
    assert {name for name, kind in whose.items() if kind == "published"} == {
        name for name, entry in METHODS.items() if ".published.refa" in entry.path or name.endswith("-paper")
    }
