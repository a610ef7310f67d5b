"""`scene draw`: a picture of a scene before a run."""

from pathlib import Path

import pytest


@pytest.mark.slow
@pytest.mark.parametrize(("name", "begins"), [("a.png", b"\x89PNG"), ("a.pdf", b"%PDF"), ("a.SVG", b"<?xml")])
def test_a_picture_by_its_ending_replaces_nothing_unasked(say, tmp_path, monkeypatch, name, begins):
    monkeypatch.chdir(tmp_path)
    drawn = say("scene", "draw", "room", "-o", name, "--width", "8.8")
    assert (drawn.code, drawn.out) == (0, f"wrote {name}\n")
    assert Path(name).read_bytes().startswith(begins)
    before = Path(name).read_bytes()
    again = say("scene", "draw", "hall", "-o", name)
    assert again.code == 2
    assert f"{name}: found something of this name; allowed: a new name (or --overwrite)" in again.err
    assert Path(name).read_bytes() == before
    assert say("scene", "draw", "hall", "-o", name, "--overwrite").code == 0
    assert Path(name).read_bytes() != before


def test_without_a_name_it_is_called_as_the_scene(say, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert say("scene", "draw", "room").code == 0
    assert Path("room.png").is_file()


@pytest.mark.parametrize(
    ("told", "says"),
    [
        (("room", "-o", "a.jpg"), "-o: found 'a.jpg'; allowed: a name that ends in .png, .pdf or .svg"),
        (("rom",), "allowed: room (nearest known scene)"),
        (("room", "--width", "900"), "--width"),
        (("room", "-o", "nowhere/a.png"), "nowhere/a.png: found"),
    ],
)
def test_what_cannot_be_drawn_is_one_line(say, tmp_path, monkeypatch, told, says):
    monkeypatch.chdir(tmp_path)
    result = say("scene", "draw", *told)
    assert result.code == 2
    assert len(result.err.strip().splitlines()) == 1
    assert says in result.err
    assert list(tmp_path.iterdir()) == []
