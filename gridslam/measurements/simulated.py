"""Which simulation a table of measurements is of."""

from __future__ import annotations

from typing import NamedTuple

import h5py
import numpy as np


class Simulated(NamedTuple):
    """What `simulate` was asked for.

    Attributes
    ----------
    scene : str
        Its name.
    agents : tuple of str
        Who heard it.
    seed : int
    """

    scene: str
    agents: tuple[str, ...]
    seed: int

    def __str__(self) -> str:
        """As people are told of it."""
        return f"{self.scene}, {', '.join(self.agents)}, seed {self.seed}"

    def unlike(self, scene: str, agents: tuple[str, ...]) -> str | None:
        """What is said where the table is taken for one of another scene, or of other agents; else None."""
        whose = [name for name in agents if name not in self.agents]
        if self.scene == scene and not whose:
            return None
        taken = f"{scene}, {', '.join(agents)}"
        return f"simulated in {self}, and taken for {taken}"

    @property
    def attributes(self) -> dict[str, object]:
        """What files hold of it, `gridslam.measurements.datasets.SIMULATED`."""
        return {f"@{name}": value for name, value in self._asdict().items()}


def simulated_of(group: h5py.Group) -> Simulated | None:
    """Read it from a group's attributes; None if they are none, or other programs'."""
    scene, agents, seed = (group.attrs.get(name) for name in ("scene", "agents", "seed"))
    whole = isinstance(scene, str) and isinstance(agents, np.ndarray) and isinstance(seed, int | np.integer)
    if not whole or not all(isinstance(name, str) for name in agents):
        return None
    return Simulated(str(scene), tuple(agents), int(seed))
