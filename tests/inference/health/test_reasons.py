"""What health may say stands in one room, and the folder's docstring lists all of it."""

import inspect
import re
from pathlib import Path

import gridslam
from gridslam.inference import health
from gridslam.inference.health import reasons
from gridslam.inference.health.monitor import DISTRUSTED
from gridslam.inference.health.reasons import UNSIGHTED, leapt
from gridslam.inference.health.signal_watch import EARLY, FEW, assess_particles

PACKAGE = Path(gridslam.__file__).parent
SENTENCES = {name for name, value in vars(reasons).items() if inspect.isfunction(value)}


def test_the_docstring_of_the_folder_lists_every_reason_with_a_formula_or_a_section():
    listed = set(re.findall(r"`(\w+)`", health.__doc__))
    assert SENTENCES | {"NOT_FOUND", "OFF_GRID", "ASTRAY"} <= listed
    pages = (PACKAGE.parent / "docs/model").glob("*.md")
    page = "".join(page.read_text(encoding="utf-8") for page in pages)
    numbers = re.findall(r"\((M\d+)\)", health.__doc__)
    assert {"M46", "M206", "M253", "M262"} <= set(numbers)
    assert all(rf"\text{{({number})}}" in page or f"**({number})**" in page for number in numbers)


def test_no_other_room_says_a_reason_in_words_of_its_own():
    source = inspect.getsource(reasons)
    words = [re.sub(r"\{[^}]*\}", "{", text) for text in re.findall(r'return f"([^"]*)"', source)]
    assert len(words) == len(SENTENCES)
    pieces = {piece for text in words if len(piece := max(text.split("{"), key=len).strip()) > 12}
    for room in ("inference", "systems"):
        for file in (PACKAGE / room).rglob("*.py"):
            if file.name != "reasons.py":
                text = file.read_text(encoding="utf-8")
                assert not [piece for piece in pieces if piece in text], file


def test_reasons_read_as_sentences_with_their_numbers():
    assert reasons.offset("anchor A", -0.6) == "distances of anchor A seem 0.60 m (2.0 ns) too short"
    assert reasons.few_explained(0.254, 0.9) == "25% of the loud measurements explained, usually 90%"
    said = "clutter seems to be 6.8 measurements a step, where the scene expects 2"
    assert reasons.clutter(6.84, 2.0) == said
    assert reasons.height(2.04).startswith("anchors seem 2.0 m above or below")


def test_hybrid_slam_says_what_is_amiss_with_its_particles():
    well = assess_particles(0.1, FEW - 1, 0, EARLY, 2, by_particles=False)
    assert well.ok
    assert not well.why
    amiss = assess_particles(1.26, FEW - 1, 5, 0.62, 2, by_particles=True)
    reasons = ["nothing heard for 5 steps", "position known to 1.3 m alone", "29 particles carry the weight"]
    reasons.append("paths arrive before the line of sight at 62% of the latest steps")
    assert amiss.why.split("; ") == reasons
    assert not amiss.ok
    assert len(amiss.turned_rad) == 2
    moved = assess_particles(0.1, 100.0, 0, 0.0, 2, by_particles=False, unsighted=True, leap=(1.23, 7))
    assert moved.why == f"{UNSIGHTED}; {leapt(1.23, 7)}"
    assert assess_particles(0.1, 100.0, 0, 0.0, 2, by_particles=False, leap=(1.23, DISTRUSTED)).ok
