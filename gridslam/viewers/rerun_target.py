"""Where a run is shown: a Rerun viewer on this machine or elsewhere, or a file that it opens."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from gridslam.errors import InputError
from gridslam.io.files import beside, cannot_write, put_in_place

HERE, PORT = "127.0.0.1", 9876
"""Where a viewer listens unless told otherwise."""
SCHEMES = "rerun", "rerun+http", "rerun+https"
REACH_S, START_S, SETTLE_S = 3.0, 30.0, 1.0
"""How long an address may take to answer, a viewer to come up, and to fall over after that."""
LAST_WORDS_S = 10.0
"""How long the end of a run waits for what is still on its way to a viewer."""
INSTEAD = "--rerun-to FILE.rrd, or --rerun-to HOST:PORT of a viewer that runs"


def package() -> Any:
    """The package.

    Raises
    ------
    InputError
        It isn't installed, or too old.
    """
    os.environ.setdefault("RUST_LOG", "off")  # read once, at import: else it writes into the progress bar
    try:
        import rerun
    except ImportError as error:
        raise InputError("--rerun", "no rerun-sdk here", "pip install 'gridslam[rerun]'") from error
    if not hasattr(rerun, "GridMap"):  # also whatever else calls itself rerun
        version = getattr(rerun, "__version__", "?")
        raise InputError("--rerun", f"rerun-sdk {version}", "pip install -U 'gridslam[rerun]'")
    return rerun


@contextmanager
def open_stream(where: str | None = None, overwrite: bool = False) -> Iterator[Any]:
    """Open a recording, to which all may be logged that belongs to a run.

    Parameters
    ----------
    where : str, optional
        ``FILE.rrd``, ``HOST:PORT`` or the URL of a viewer. Default: the viewer on this machine, which is
        started if none runs.
    overwrite : bool
        Whether an existing file may be replaced.

    Yields
    ------
    rerun.RecordingStream
        A file gets its name when the block ends well. A viewer that goes away doesn't disturb the block.

    Raises
    ------
    InputError
        No package, no viewer that answers or could be started, or a file that can't be written.
    """
    rerun = package()
    path = Path(where) if where is not None and where.lower().endswith(".rrd") else None
    if path is not None and path.exists() and not overwrite:
        raise InputError(str(path), "something of this name", "a new name")
    url = _reached(where) if path is None else ""
    stream = rerun.RecordingStream("gridslam")
    if path is None:
        stream.connect_grpc(url)
        yield stream
        try:
            stream.flush(timeout_sec=LAST_WORDS_S)
        except Exception:  # the viewer was closed, or is slow: no reason to lose a run
            return
        stream.disconnect()
        return
    part = beside(path)
    try:
        try:
            part.touch()
            stream.save(part)
        except (OSError, RuntimeError) as error:
            reason = error if isinstance(error, OSError) else OSError(str(error))
            raise cannot_write(path, reason) from error
        yield stream
        stream.disconnect()  # writes what is left
        try:
            put_in_place(part, path)
        except OSError as error:
            raise cannot_write(path, error) from error
    finally:
        stream.disconnect()
        part.unlink(missing_ok=True)


def _reached(where: str | None) -> str:
    """URL of a viewer that answers."""
    if where is None:
        if not _answers(HERE, PORT):
            _start_viewer()
        return f"rerun+http://{HERE}:{PORT}/proxy"
    allowed = "HOST:PORT of a viewer, or FILE.rrd"
    try:
        parts = urlsplit(where if "://" in where else f"rerun+http://{where}")
        host, port = parts.hostname, parts.port or PORT
    except ValueError:
        host, port = None, 0
    if not host or parts.scheme not in SCHEMES or parts.path.strip("/") not in ("", "proxy"):
        raise InputError("--rerun-to", repr(where), allowed)
    if not _answers(host, port):
        raise InputError("--rerun-to", f"no viewer that answers at {host}:{port}", allowed)
    shown = f"[{host}]" if ":" in host else host
    return f"{parts.scheme}://{shown}:{port}/proxy"


def _answers(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), REACH_S).close()
    except OSError:
        return False
    return True


def _start_viewer() -> None:
    """Start a viewer that outlives the run; wait until it listens, and give up when it falls over."""
    command = [sys.executable, "-m", "rerun_cli", "--port", str(PORT), "--bind", HERE, "--expect-data-soon"]
    # with CI set, it keeps and sends no statistics of use
    quiet = {**os.environ, "CI": "1", "RUST_LOG": "off"}
    none: Any = subprocess.DEVNULL
    viewer = subprocess.Popen(
        command, env=quiet, stdin=none, stdout=none, stderr=none, start_new_session=True
    )
    end = time.monotonic() + START_S
    while time.monotonic() < end and viewer.poll() is None:
        if _answers(HERE, PORT):
            end = min(end, time.monotonic() + SETTLE_S)  # it listens before it has found a display
        time.sleep(0.1)
    if viewer.poll() is not None or not _answers(HERE, PORT):
        raise InputError("--rerun", "no viewer, and none could be started (no display?)", INSTEAD)
