"""Who watches launches: the bench, to time them or to keep what they were given. Mostly nobody."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

Launch = Callable[..., Any]
Watcher = Callable[[str, Launch, tuple[Any, ...]], Any]
"""Gets a kernel's name, its launch and the arguments; launches it, and returns what that returns."""
WATCHERS: list[Watcher] = []
"""The latest one is asked at every launch."""


@contextmanager
def watched(by: Watcher) -> Iterator[None]:
    """Hand all launches of this process, of any thread, to a watcher meanwhile."""
    WATCHERS.append(by)
    try:
        yield
    finally:
        WATCHERS.remove(by)
