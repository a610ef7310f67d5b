"""How wide figures are on paper, and what letters suit a width."""

from __future__ import annotations

from contextlib import AbstractContextManager
from numbers import Real

from matplotlib import rc_context

from gridslam.errors import InputError

PAGE_IN = 7.2
"""Width of a journal's page, inches."""
WIDE_IN = 5.0
"""From which width on there is room for large letters."""
CM_IN = 2.54
NARROWEST_CM, WIDEST_CM = 5, 50
"""Between what widths a user may choose."""


def inches(width_cm: float) -> float:
    """A figure's width, inches, by what a user asked for, cm.

    Raises
    ------
    InputError
        No number, or none from 5 to 50.
    """
    if not isinstance(width_cm, Real) or not NARROWEST_CM <= width_cm <= WIDEST_CM:
        allowed = f"{NARROWEST_CM} to {WIDEST_CM} cm: 8.8 suits a column of a paper"
        raise InputError("width_cm", repr(width_cm), allowed)
    return float(width_cm) / CM_IN


def fonts(width: float) -> AbstractContextManager[None]:
    """While it lasts, figures get letters that suit a width in inches."""
    return rc_context({"font.size": 10 if width > WIDE_IN else 7})
