"""Numbers in sentences."""

from __future__ import annotations


def counted(number: int, thing: str) -> str:
    """A number of things: "1 wall", "2 walls"."""
    return f"{number} {thing}{'' if number == 1 else 's'}"
