"""Files that survive a power loss: whole before they have their name."""

import errno
import os
import stat
from pathlib import Path

import pytest

from gridslam.errors import InputError
from gridslam.io.files import write_bytes, write_files


@pytest.fixture
def log(monkeypatch):
    """What is made durable and renamed, in order: ("sync", inode) and ("name", inode, name)."""
    calls = []
    sync, replace = os.fsync, os.replace

    def fsync(handle):
        calls.append(("sync", os.fstat(handle).st_ino))
        sync(handle)

    def rename(part, path):
        calls.append(("name", os.stat(part).st_ino, os.fspath(path)))
        replace(part, path)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", rename)
    return calls


def test_file_is_durable_before_it_has_its_name_and_the_name_afterwards(tmp_path, log):
    write_bytes(tmp_path / "a", b"x")
    inode = (tmp_path / "a").stat().st_ino
    assert log[:2] == [("sync", inode), ("name", inode, str(tmp_path / "a"))]
    if os.name == "posix":
        assert log[2:] == [("sync", tmp_path.stat().st_ino)]


def test_disk_that_fails_to_sync_leaves_the_old_file(tmp_path, monkeypatch):
    write_bytes(tmp_path / "a", b"old")

    def fail(handle):
        if stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(InputError, match="Input/output error"):
        write_bytes(tmp_path / "a", b"new")
    assert (tmp_path / "a").read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a"]


def test_a_full_disk_leaves_all_files_of_a_folder_as_they_were(tmp_path, monkeypatch):
    folder, write = tmp_path / "all", Path.write_bytes
    assert write_files(folder, {"a": b"1", "b": b"1"}) == [folder / "a", folder / "b"]
    (folder / "mine").write_bytes(b"1")

    def full(path, content):
        if path.name == "b":
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    for other in (folder, tmp_path / "new"):
        with pytest.raises(InputError, match=f"{other.name}: found No space left on device"):
            write_files(other, {"a": b"2", "b": b"2"})
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == dict.fromkeys(
        ("a", "b", "mine"), b"1"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["all"]
