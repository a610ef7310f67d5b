"""Faults of a receiver that show in the samples alone: dead antenna elements, snapshots that repeat."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

DEAD_DB = 20.0
"""How much weaker than its array's median an element is that hears nothing: no fading of a whole way is."""
MOST_REPEATS = 3
"""Snapshots that may repeat an earlier one of the same anchor before anything is said."""


def sample_faults(samples: NDArray, heard: NDArray[np.bool_], anchors: Sequence[str]) -> list[str]:
    """Say which elements hear nothing, and whose snapshots repeat.

    Parameters
    ----------
    samples : (K, J, A, B, M) complex
        By step, anchor, element of the anchor, element of the agent, frequency.
    heard : (K, J) bool
        Snapshots that are there, without NaN.
    anchors : sequence of J names

    Returns
    -------
    list of str
        A line for each fault; empty if there is none.
    """
    power = np.zeros(samples.shape[1:4])
    for anchor in range(len(anchors)):  # one at a time: a recording may be large
        own = samples[heard[:, anchor], anchor]
        with np.errstate(over="ignore"):
            parts = (np.square(part, dtype=np.float64).sum((0, 3)) for part in (own.real, own.imag))
            power[anchor] = sum(parts)
    lines = _dead("agent", power.sum((0, 1)), "samples[:, :, :, {}]", int(heard.sum()))
    for anchor, name in enumerate(anchors):
        count = int(heard[:, anchor].sum())
        lines += _dead(f"anchor {name}", power[anchor].sum(1), f"samples[:, {anchor}, {{}}]", count)
        repeats = _repeats(samples[heard[:, anchor], anchor])
        if repeats > MOST_REPEATS:
            lines.append(
                f"anchor {name}: snapshots repeat: {repeats} of {count} are an earlier one, every number "
                "alike, which noise never makes: a receiver or a file writer that was stuck?"
            )
    return lines


def _dead(device: str, power: Array, where: str, snapshots: int) -> list[str]:
    """Elements whose power (N,) is nothing beside that of the array's others."""
    lines = []
    for number, own in enumerate(power):
        typical = float(np.median(np.delete(power, number))) if len(power) > 1 else 0.0
        if not 0 < typical < np.inf or own > 10 ** (-0.1 * DEAD_DB) * typical:
            continue
        weak = f"{10 * np.log10(typical / own):.0f} dB weaker than the others" if own else "0"
        lines.append(
            f"{device}: element {number + 1} of {len(power)} hears nothing: {where.format(number)} is {weak} "
            f"in all {snapshots} snapshots: a cable, a channel? Leave it out of samples and element places"
        )
    return lines


def _repeats(snapshots: NDArray) -> int:
    """How many of the snapshots (N, ...) are an earlier one, to the last bit."""
    return len(snapshots) - len({one.tobytes() for one in snapshots})
