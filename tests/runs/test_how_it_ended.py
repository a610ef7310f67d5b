"""What `run --resume` says of folders of which nothing is left to do."""

import json

import pytest

from gridslam.runs.parts import how_it_ended


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"agents": {"a": {"interrupted": False}}}, "a finished run: nothing is left to do"),
        ({"agents": {"a": {"interrupted": True}}}, "a run that was cut short and kept no checkpoint"),
        ({"agents": 5}, "no unfinished run"),
        ([], "no unfinished run"),
        (None, "no unfinished run"),
    ],
)
def test_resume_says_why_nothing_is_left(say, tmp_path, content, says):
    folder = tmp_path / "out"
    folder.mkdir()
    if content is not None:
        (folder / "run.json").write_text(json.dumps(content))
    told = say("run", "--resume", folder)
    assert told.code == 2
    (line,) = told.complaints
    assert f"found {says}; allowed: the folder of a run with --checkpoint" in line
    assert bool(how_it_ended(folder)) == (says != "no unfinished run")
