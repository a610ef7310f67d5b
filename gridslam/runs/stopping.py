"""Ctrl-C and SIGTERM: asked to stop once, a run ends after the step in hand; asked twice, at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

Handler = Callable[[int, FrameType | None], Any]


class StoppedLate(KeyboardInterrupt):
    """Asked to stop when all steps were done, while the run was put together.

    Attributes
    ----------
    run : Run or NetworkRun
        It is whole all the same.
    """

    def __init__(self, run: Any) -> None:
        super().__init__()
        self.run = run


class Kept:
    """A run as far as it got before a step failed, kept with what the step raised; never sent elsewhere.

    Attributes
    ----------
    run : Run or None
    """

    def __init__(self, run: Any = None) -> None:
        self.run = run

    def __reduce__(self) -> tuple[type[Kept], tuple[()]]:
        """Travel without the run, which may be large."""
        return type(self), ()


def keep_with(error: Exception, run: Any) -> None:
    """Let `run_before` find a run by the error that ended it."""
    error.__dict__["run_before"] = Kept(run)  # whatever the error has to say of its attributes


def is_theirs(error: Exception) -> bool:
    """Whether a step of somebody's own method raised it, at the first step, too."""
    return "run_before" in vars(error)


def run_before(error: Exception) -> Any:
    """The run as far as it got before the step of somebody's method raised an error, or None."""
    return getattr(error, "run_before", Kept()).run


class Termination:
    """Handler of SIGTERM that interrupts like Ctrl-C, and keeps in mind that it was asked to."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Interrupt."""
        self.asked = True
        raise KeyboardInterrupt


def _handlers() -> dict[int, Handler]:
    """Those that would interrupt this thread; whoever set others decides what the signals mean."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    found = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    return {
        number: handler
        for number, handler in found.items()
        if callable(handler) and (handler is signal.default_int_handler or isinstance(handler, Termination))
    }


@contextmanager
def terminable() -> Iterator[Termination]:
    """Let SIGTERM interrupt like Ctrl-C within the block, unless somebody else has taken it over."""
    termination = Termination()
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield termination
        return
    signal.signal(signal.SIGTERM, termination)
    try:
        yield termination
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def asked_to_stop() -> Iterator[threading.Event]:
    """Set the event at the first signal, so that no step is cut in half; let the second one through."""
    stopped = threading.Event()
    before = _handlers()

    def ask(number: int, frame: FrameType | None) -> None:
        _restore(before)
        _note(before[number])
        stopped.set()

    for number in before:
        signal.signal(number, ask)
    try:
        yield stopped
    finally:
        _restore(before)


@contextmanager
def held_back() -> Iterator[threading.Event]:
    """Set the event at a signal and let the block end: for what takes seconds and mustn't be cut in half."""
    stopped = threading.Event()
    before = _handlers()

    def ask(number: int, frame: FrameType | None) -> None:
        _note(before[number])
        stopped.set()

    for number in before:
        signal.signal(number, ask)
    try:
        yield stopped
    finally:
        _restore(before)


def _note(handler: Handler) -> None:
    if isinstance(handler, Termination):
        handler.asked = True


def _restore(handlers: dict[int, Handler]) -> None:
    for number, handler in handlers.items():
        signal.signal(number, handler)
