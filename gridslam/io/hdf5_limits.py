"""What an HDF5 file may ask for: only what lies in it, and no more memory than there should be."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager

import h5py

from gridslam.errors import InputError

LARGEST_BYTES = 2**31
"""A dataset that claims to be larger is refused before memory is asked for."""
LARGEST_SUM_BYTES = 2**32
"""All that is read from one file, each dataset as often as it is read."""
MOST_PACKED = 1100
"""Deflate packs at most 1032 bytes into one."""
_read: dict[int, int] = {}  # bytes read so far from the files that are open, by HDF5's number of the file


@contextmanager
def counted(file: h5py.File) -> Iterator[None]:
    """Add up what is read from a file within the block; see `claims_too_much`."""
    number = h5py.h5o.get_info(file.id).fileno
    before = _read.get(number)
    _read[number] = before or 0
    try:
        yield
    finally:
        if before is None:
            del _read[number]


def claims_too_much(data: h5py.Dataset) -> bool:
    """Whether a dataset claims more than `LARGEST_BYTES`, or than its file can hold even packed.

    Within a `counted` block also whether it and those asked about before claim more than `LARGEST_SUM_BYTES`.
    """
    if data.external or data.is_virtual:  # held by another file
        return True
    claimed = max(data.size, math.prod(data.chunks or (0,))) * data.dtype.itemsize
    held = min(data.id.get_storage_size(), h5py.h5i.get_file_id(data.id).get_filesize())
    number = h5py.h5o.get_info(data.id).fileno
    if number in _read:
        _read[number] += claimed
    return (
        claimed > LARGEST_BYTES
        or claimed > 2**20 + MOST_PACKED * held
        or _read.get(number, 0) > LARGEST_SUM_BYTES
    )


def most_claimed(path: str | os.PathLike[str]) -> int:
    """Bytes of the largest dataset that `claims_too_much` could let pass."""
    return min(LARGEST_BYTES, 2**20 + MOST_PACKED * os.path.getsize(path))


def refuse_links(file: h5py.File) -> None:
    """Refuse a file that has links in it: they could lead to other files, which opening them would read.

    Raises
    ------
    InputError
        It has one, to another file or to another place in this one.
    """
    found = file.id.links.visit(
        lambda name, info: None if info.type == h5py.h5l.TYPE_HARD else name, info=True
    )
    if found is not None:
        name = found.decode("utf-8", "replace")
        raise InputError(f"{file.filename}: /{name}", "a link to elsewhere", "data in the file itself")


def own(group: h5py.Group, name: str) -> h5py.Group | h5py.Dataset | None:
    """What a group holds under a name, which is no path; None if nothing.

    Raises
    ------
    InputError
        It is a link, to another file or to another place in this one.
    """
    link = group.get(name, getlink=True)
    if link is None:
        return None
    if not isinstance(link, h5py.HardLink):
        raise InputError(place_of(group, name), "a link to elsewhere", "data in the file itself")
    return group.get(name)


def place_of(group: h5py.Group, name: str) -> str:
    """What errors call what a group holds under a name. `group.file` would open the file once more."""
    return f"{os.fsdecode(h5py.h5f.get_name(group.id))}: {group.name.rstrip('/')}/{name}"
