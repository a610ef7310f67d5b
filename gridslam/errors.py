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
        self.where, self.found, self.allowed = where, found, allowed
        super().__init__(f"{where}: found {found}; allowed: {allowed}")

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        """Travel whole from a worker process: the parts, where ValueError would pass on the sentence."""
        return type(self), (self.where, self.found, self.allowed)
