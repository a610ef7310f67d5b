"""Files of commands: whole or not there, and never in the place of another's."""

import pytest

from gridslam.errors import InputError
from gridslam.io.files import new_file


def write(path, text, meanwhile=None, overwrite=False, fault=None):
    with new_file(path, overwrite) as part:
        part.write_text(text)
        if meanwhile is not None:
            path.write_text(meanwhile)
        if fault is not None:
            raise fault(part)


def held(folder):
    return {file.name: file.read_text() for file in folder.iterdir()}


def test_a_file_that_came_meanwhile_stays_and_the_later_one_is_refused(tmp_path):
    path = tmp_path / "heard.csv"
    with pytest.raises(InputError, match=r"heard.csv: found something of this name"):
        write(path, "mine", meanwhile="another's")
    assert held(tmp_path) == {"heard.csv": "another's"}
    write(path, "mine", overwrite=True)
    assert held(tmp_path) == {"heard.csv": "mine"}


def test_what_fails_leaves_nothing_and_names_the_file_that_was_asked_for(tmp_path):
    path = tmp_path / "heard.csv"
    with pytest.raises(InputError, match=r"^another: found x"):
        write(path, "half", fault=lambda part: InputError("another", "x", "y"))
    with pytest.raises(InputError, match=r"/heard.csv: found no room"):
        write(path, "half", fault=lambda part: InputError(str(part), "no room", "more"))
    with pytest.raises(InputError, match=r"/none/heard.csv: found"):
        write(tmp_path / "none" / "heard.csv", "all of it")
    assert held(tmp_path) == {}
