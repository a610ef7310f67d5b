"""Numbers in sentences."""

from __future__ import annotations


def counted(number: int, thing: str) -> str:
    """A number of things: "1 wall", "2 walls"."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def time_span(first_s: float, last_s: float) -> str:
    """From when to when, to the millisecond also of times that count from 1970: "0 to 12.5 s"."""
    return f"{_decimal(first_s)} to {_decimal(last_s)} s"


def _decimal(value: float) -> str:
    return f"{value:.3f}".rstrip("0").rstrip(".") if 1e-3 <= abs(value) < 1e15 else f"{value:g}"
