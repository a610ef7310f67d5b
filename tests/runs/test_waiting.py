"""A folder whose overwriting run was killed: what is there is told, and that an unfinished run waits."""

import pytest

from gridslam.runs.parts import INDEX, UNFINISHED, waiting_note


def test_an_unfinished_run_that_was_to_replace_a_folder_is_told(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    assert waiting_note(folder) is None
    kept = tmp_path / ".out.123.part" / UNFINISHED
    kept.mkdir(parents=True)
    (kept / INDEX).write_text("{}")
    assert f"gridslam run --resume {folder}" in waiting_note(folder)
    assert waiting_note(tmp_path / "none") is None


@pytest.mark.parametrize("words", [["export", "-o", "robot"], ["fuse", "b.h5", "-o", "both.h5"]])
def test_the_map_of_an_unfinished_run_is_asked_for_and_what_to_do_is_said(say, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    kept = tmp_path / ".out.123.part" / UNFINISHED
    kept.mkdir(parents=True)
    (kept / INDEX).write_text("{}")
    result = say(words[0], "out", *words[1:])
    assert result.code == 2
    assert "out: found an unfinished run; allowed: to go on with it (gridslam run --resume out)" in result.err
    assert [path.name for path in tmp_path.iterdir()] == [".out.123.part"]
