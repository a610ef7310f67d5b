"""A folder whose overwriting run was killed: what is there is told, and that an unfinished run waits."""

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
