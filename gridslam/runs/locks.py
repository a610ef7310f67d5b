"""Locks of folders, which the system opens when the process ends in whatever way."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

SIGN = b"gridslam "
"""What a lock file begins with; the number of the process follows."""
LOCK = re.compile(r"\.(?P<name>.+)\.run-lock")


def lock_of(target: Path) -> Path:
    """The lock of a folder, beside it."""
    return target.with_name(f".{target.name}.run-lock")


@contextlib.contextmanager
def locked(path: Path) -> Iterator[str]:
    """Hold a lock; yields the number of the process that held it last and didn't give it back, or nothing.

    Raises
    ------
    BlockingIOError
        Another holds it; its text is the number of that process.
    """
    handle = _open_locked(path)
    try:
        before = _holder(handle)
        os.lseek(handle, 0, os.SEEK_SET)
        os.ftruncate(handle, 0)
        os.write(handle, SIGN + b"%d\n" % os.getpid())
        yield before
    finally:
        if fcntl is not None:  # the name first: whoever opens it afterwards makes a new one
            path.unlink(missing_ok=True)
        os.close(handle)
        if fcntl is None:
            with contextlib.suppress(OSError):
                path.unlink()


def _open_locked(path: Path) -> int:
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            _grab(handle)
            if os.path.samestat(os.fstat(handle), os.stat(path)):
                return handle
        except FileNotFoundError:
            pass  # given back between opening and locking: once more
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)


def _grab(handle: int) -> None:
    """Lock an open file without waiting; where a disk knows no locks, the last rename alone protects."""
    try:
        if fcntl is not None:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # type: ignore[attr-defined,unused-ignore]
        else:
            import msvcrt

            windows: Any = msvcrt
            os.lseek(handle, 1000, os.SEEK_SET)
            windows.locking(handle, windows.LK_NBLCK, 1)
            os.lseek(handle, 0, os.SEEK_SET)
    except (BlockingIOError, PermissionError) as error:
        raise BlockingIOError(error.errno, _holder(handle)) from error
    except OSError:
        pass


def _holder(handle: int) -> str:
    """Number of the process that a lock file tells."""
    os.lseek(handle, 0, os.SEEK_SET)
    content = os.read(handle, 30)
    number = content.removeprefix(SIGN).strip()
    return number.decode() if content.startswith(SIGN) and number.isdigit() else ""
