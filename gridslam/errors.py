"""The one exception for input that a person can mend."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input, told in one line: which file, which field, what was found, what is allowed.

    Parameters
    ----------
    where : str
        File (and field) that holds the fault, e.g. ``"canyon.toml: anchors[0].position_m"``.
    found : str
        What stands there.
    allowed : str
        What could stand there instead.
    """

    def __init__(self, where: str, found: str, allowed: str) -> None:
        self.where, self.found, self.allowed = _line(where), _line(found), _line(allowed)
        super().__init__(f"{self.where}: found {self.found}; allowed: {self.allowed}")

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        """Travel whole from a worker process: the parts, where ValueError would pass on the sentence."""
        return type(self), (self.where, self.found, self.allowed)


def _line(text: str, longest: int = 500) -> str:
    """The text on one line, whatever a hostile file put into it."""
    plain = "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in text[: 2 * longest])
    return plain if len(plain) <= longest else f"{plain[: longest - 3]}..."
