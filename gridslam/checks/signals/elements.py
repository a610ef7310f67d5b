"""Faults of a receiver that show in the samples alone: dead elements, snapshots that repeat, or glitch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

DEAD_DB = 20.0
"""How much weaker than its array's median an element is that hears nothing: no fading of a whole way is."""
MOST_REPEATS = 3
"""Snapshots that may repeat an earlier one of the same anchor before anything is said."""
LOUD_DB, STEEP_DB, MOST_LOUD = 30.0, 20.0, 3
"""How much louder a snapshot is than most of its anchor's, and than those before and after, that no fading
and no way past an anchor explains; how many such ones in a row may be a glitch."""
LEAST_SNAPSHOTS, NAMED = 8, 3
"""Of an anchor, for its loudness to be judged; loud ones that are told by their numbers."""


def sample_faults(samples: NDArray, heard: NDArray[np.bool_], anchors: Sequence[str]) -> list[str]:
    """Say which elements hear nothing, whose snapshots repeat, and which are far too loud.

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
        power[anchor] = _powers(samples[heard[:, anchor], anchor], (0, 3))
    lines = _dead("agent", power.sum((0, 1)), "samples[:, :, :, {}]", int(heard.sum()))
    for anchor, name in enumerate(anchors):
        count = int(heard[:, anchor].sum())
        lines += _dead(f"anchor {name}", power[anchor].sum(1), f"samples[:, {anchor}, {{}}]", count)
        there = np.flatnonzero(heard[:, anchor])
        lines += _too_loud(name, anchor, there, _powers(samples[there, anchor]))
        repeats = _repeats(samples[there, anchor])
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


def _powers(snapshots: NDArray, axes: tuple[int, ...] = (1, 2, 3)) -> Array:
    """Power of snapshots (N, A, B, M), summed over axes; by default of each, (N,)."""
    with np.errstate(over="ignore"):
        return np.asarray(
            sum(np.square(part, dtype=np.float64).sum(axes) for part in (snapshots.real, snapshots.imag))
        )


def _too_loud(name: str, anchor: int, step: NDArray[np.intp], power: Array) -> list[str]:
    """Snapshots of an anchor, at steps (N,), whose power (N,) is far beyond all about them."""
    if len(power) < LEAST_SNAPSHOTS:
        return []
    loud = power > 10 ** (0.1 * LOUD_DB) * np.median(power)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], loud, [False]]).astype(int)))
    found, by = list[int](), list[float]()
    for first, last in edges.reshape(-1, 2).tolist():
        beside = power[[k for k in (first - 1, last) if 0 <= k < len(power)]].max()
        steep = power[first:last].min() > 10 ** (0.1 * STEEP_DB) * beside
        if last - first <= MOST_LOUD and steep:
            found += step[first:last].tolist()
            by.append(10 * float(np.log10(power[first:last].max() / np.median(power))))
    if not found:
        return []
    which = ", ".join(map(str, found[:NAMED])) + f" and {len(found) - NAMED} more" * (len(found) > NAMED)
    end, verb = ("s", "are up to") if len(found) > 1 else ("", "is")
    return [
        f"anchor {name}: snapshot{end} {which} (samples[{found[0]}, {anchor}]) {verb} {max(by):.0f} dB "
        "louder than most others, and those before and after aren't: a glitch? Set heard to false there"
    ]
