"""A number that files hold, described once: for those who write it, those who check it, and the reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

REQUIRED = "required"
TURNS = {0.5 * np.pi: "pi/2", np.pi: "pi", 2 * np.pi: "2 pi", 8 * np.pi: "8 pi"}


@dataclass(frozen=True)
class Quantity:
    """What a file holds under a name.

    Attributes
    ----------
    name, unit : str
        "1" stands for a number without unit.
    meaning : str
    default : str
        What a file without it means.
    least, most : float
        Between which its numbers are.
    open : bool
        Whether the ends themselves aren't allowed.
    """

    name: str
    unit: str
    meaning: str
    default: str = REQUIRED
    least: float = -np.inf
    most: float = np.inf
    open: bool = False

    @property
    def allowed(self) -> str:
        """Which numbers, in words."""
        least, most = _in_words(self.least), _in_words(self.most)
        if not np.isfinite(self.most):
            if not np.isfinite(self.least):
                return "finite"
            return f"above {least}" if self.open else f"{least} or more"
        return f"above {least}, below {most}" if self.open else f"{least} to {most}"

    @property
    def shown_unit(self) -> str:
        """The unit as the reference has it: nothing where there is none."""
        return {"1": "", "text": ""}.get(self.unit, self.unit)

    def refuses(self, values: NDArray[Any]) -> NDArray[np.bool_]:
        """Which values (K,) it can't hold, of those that aren't NaN."""
        if self.open:
            return np.asarray((values <= self.least) | (values >= self.most))
        return np.asarray((values < self.least) | (values > self.most))


def _in_words(number: float) -> str:
    """A limit."""
    word = TURNS.get(abs(number))
    return f"{number:.10g}" if word is None else f"{'-' if number < 0 else ''}{word}"
