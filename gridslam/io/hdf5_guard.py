"""HDF5 files that aren't known to be whole, tried in a process of their own before this one opens them.

A single wrong bit in an HDF5 file can keep the HDF5 library in an endless loop, make it take all memory or
crash it, which no exception handler survives. Files that this package writes end with a checksum over the
rest (HDF5 ignores what follows its own end); files of other programs are read by another process first. This
guards against damage; whoever forges a checksum can still do harm.
"""

from __future__ import annotations

import os
import subprocess
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path

from gridslam.errors import InputError

MARK = b"gridslam crc32 "
SIGNATURE, NEWER = b"\x89HDF\r\n\x1a\n", (b"\2\x08", b"\3\x08")
"""Start of the file; versions of its superblock (with 8-byte addresses) that say at byte 28 where it ends."""
FIRST_BLOCK = 512
"""Bytes that may stand before the start of the file: none, so many, twice as many, four times, and so on."""
START_S, BYTES_PER_S = 20.0, 5e6
"""Time that a file may take to be read: at the start and by its size."""
SPARE_BYTES = 2**28


def is_hdf5(path: str | os.PathLike[str]) -> bool:
    """Whether a file begins as HDF5 does, whole or not.

    Raises
    ------
    OSError
        It can't be read.
    """
    size, start = os.path.getsize(path), 0
    with open(path, "rb") as raw:
        while start < size:
            raw.seek(start)
            if raw.read(len(SIGNATURE)) == SIGNATURE:
                return True
            start = 2 * start or FIRST_BLOCK
    return False


def seal(content: bytes, checksum: int | None = None) -> bytes:
    """Bytes to write after those of an HDF5 file, which tell that it is whole."""
    return MARK + b"%08x\n" % (zlib.crc32(content) if checksum is None else checksum)


def prove(path: str | os.PathLike[str], most_bytes: int, names: Sequence[str] = ()) -> None:
    """Read a file in another process, with limits of time and memory, unless its checksum stands for it.

    Parameters
    ----------
    path : path
    most_bytes : int
        Datasets that claim more aren't tried: they are refused anyway.
    names : sequence of str
        Paths of what will be read; none stands for all that is in the file.

    Raises
    ------
    InputError
        The file was damaged after it was written, or it stopped or crashed the HDF5 library.
    OSError
        Not a whole HDF5 file.
    """
    if _sealed(path):
        return
    reader = str(Path(__file__).with_name("hdf5_guard_reader.py"))
    limits = [str(most_bytes), str(2 * most_bytes + SPARE_BYTES)]
    longest = START_S + os.path.getsize(path) / BYTES_PER_S
    try:
        done = subprocess.run(
            # -P: nothing of ours in the folder of the script may stand in for the standard library
            [sys.executable, "-P", reader, os.path.abspath(path), *limits, *names],
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=longest,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        found = f"HDF5 that can't be read within {longest:.0f} s"
        raise InputError(str(path), found, "a whole HDF5 file") from error
    if done.returncode == 1:
        raise OSError(done.stdout.decode("utf-8", "replace") or "no reader")
    if done.returncode:
        raise InputError(str(path), "HDF5 that crashes the HDF5 library", "a whole HDF5 file")


def _sealed(path: str | os.PathLike[str]) -> bool:
    """Whether a file has its checksum; one that was cut short or changed is refused."""
    size, length = os.path.getsize(path), len(seal(b""))
    with open(path, "rb") as raw:
        start = raw.read(36)
        newer = start.startswith(tuple(SIGNATURE + version for version in NEWER))
        if newer and size < int.from_bytes(start[28:], "little"):
            raise OSError("cut short")
        raw.seek(max(size - length, 0))
        end = raw.read()
        if MARK not in end:
            return False
        raw.seek(0)
        checksum, left = 0, size - length
        while piece := raw.read(min(left, 2**20)):
            checksum, left = zlib.crc32(piece, checksum), left - len(piece)
    if end != seal(b"", checksum):
        raise InputError(str(path), "another checksum than the file's own", "a file as it was written")
    return True
