"""Factors of antenna elements beside their places: what cables, amplifiers and couplings make of them.

docs/model.md, (M565). Nothing here needs the truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace, squared
from gridslam.world.waveform import Waveform

Complex = NDArray[np.complex128]
KEEP = 0.99
"""Factor by which sums are multiplied per step: forgetting."""
PRIOR_STD = 0.2
"""Of an element's factor about 1, before any sample."""
ROUNDS = 6
"""In which factors of anchors and agent are found in turn."""
SURPRISE, LEAST = 6.0, 0.03
"""Deviations beyond which factors of 1 are ruled out, and root mean square error that matters."""
FAINTEST = 0.5
"""Amplitude below which no element is made louder: there is more noise in it than signal."""
MOST_MATCHED = 1e6
"""Ratio to which sums can't come: samples of a signal that is so much louder than believed."""


class Factors(NamedTuple):
    """Factors of all elements, and the variances of what the sums say of them.

    Attributes
    ----------
    anchor, anchor_variance : (J, A)
    agent, agent_variance : (B,)
    """

    anchor: Complex
    anchor_variance: Array
    agent: Complex
    agent_variance: Array


@dataclass(frozen=True, eq=False)
class ElementGains:
    """What samples have said of the elements' factors.

    Attributes
    ----------
    anchor : (J, A, 2)
        Where elements are, rad: 2 pi over the wavelength times m.
    agent : (B, 2)
    matched : (J, A, B) complex128
        Sums of the samples times the conjugate of what paths are believed to make of them, over the noise.
    power : (J, A, B)
        Sums of the squares of the latter, over the noise.
    """

    anchor: Array
    agent: Array
    matched: Complex
    power: Array

    @classmethod
    def none(cls, waveform: Waveform) -> Self:
        """Before the first snapshot."""
        scale = 2 * np.pi / waveform.wavelength_m
        anchor, agent = scale * waveform.anchor_element_m, scale * waveform.agent_element_m
        shape = (*anchor.shape[:2], len(agent))
        return cls(anchor, agent, np.zeros(shape, np.complex128), np.zeros(shape))

    def taken_in(self, anchor: int, matched: Complex, power: Array) -> Self:
        """With the sums (A, B) of one anchor's snapshot."""
        matched_before, power_before = self.matched.copy(), self.power.copy()
        matched_before[anchor] = KEEP * matched_before[anchor] + matched
        power_before[anchor] = KEEP * power_before[anchor] + power
        return replace(self, matched=matched_before, power=power_before)

    @cached_property
    def factors(self) -> Factors:
        """The factors that fit the sums best, (M565).

        Less what all of an array have in common, the path's own amplitude, and slopes of their phases over
        the array, which are directions: a wrong place, turn or spacing would pass for factors.
        """
        anchors, elements, carried = self.power.shape
        anchor, agent = np.ones((anchors, elements), np.complex128), np.ones(carried, np.complex128)
        known = PRIOR_STD**-2
        for _ in range(ROUNDS):
            weight = known + np.einsum("jab,ja->b", self.power, squared(anchor))
            agent = (known + np.einsum("jab,ja->b", self.matched, anchor.conj())) / weight
            agent /= agent.mean()
            weights = known + np.einsum("jab,b->ja", self.power, squared(agent))
            anchor = (known + np.einsum("jab,b->ja", self.matched, agent.conj())) / weights
            anchor /= anchor.mean(1, keepdims=True)
        anchor = np.stack([level(*pair) for pair in zip(anchor, self.anchor, strict=True)])
        return Factors(anchor, 1 / weights, level(agent, self.agent), 1 / weight)

    @cached_property
    def size(self) -> float:
        """Root mean square of the elements' errors, in ratio to 1; 0 unless beyond doubt, and of matter."""
        factors, arrays = self.factors, self.power.shape[1:]
        parts = [(factors.anchor, factors.anchor_variance)] if arrays[0] > 1 else []
        parts += [(factors.agent, factors.agent_variance)] if arrays[1] > 1 else []
        if not parts:
            return 0.0
        error = np.concatenate([squared(factor - 1).ravel() for factor, _ in parts])
        variance = np.concatenate([variance.ravel() for _, variance in parts])
        count, ratio = len(error), float((error / variance).sum())
        excess = float((error - variance).mean())
        beyond = ratio > count + SURPRISE * np.sqrt(count) and excess > LEAST**2
        return float(np.sqrt(excess)) if beyond else 0.0

    @cached_property
    def phase_variance(self) -> float:
        """Of the phases of elements, rad^2, over all arrays: each one's plane doesn't show."""
        arrays = [*zip(self.factors.anchor, self.anchor, strict=True), (self.factors.agent, self.agent)]
        squares = sum(float(np.square(np.angle(factor)).sum()) for factor, _ in arrays)
        left = sum(len(element) - np.linalg.matrix_rank(plane_of(element)) for _, element in arrays)
        return squares / max(int(left), 1)

    def of(self, anchor: int) -> Complex | None:
        """By what the samples of an anchor's pairs of elements (A, B) are to be divided; None: by nothing."""
        if not self.size:
            return None
        own, carried = (_audible(factor) for factor in (self.factors.anchor[anchor], self.factors.agent))
        return np.asarray(own[:, None] * carried)

    def is_sound(self, waveform: Waveform) -> bool:
        """Whether the sums can be those of a waveform's elements."""
        none = self.none(waveform)
        alike = np.array_equal(self.anchor, none.anchor) and np.array_equal(self.agent, none.agent)
        return bool(
            alike and (self.power >= 0).all() and (abs(self.matched) <= MOST_MATCHED * (self.power + 1)).all()
        )


def _audible(factor: Complex) -> Complex:
    """Factors that are no smaller than `FAINTEST`, of the same phases."""
    size = np.abs(factor)
    return np.asarray(factor * np.maximum(size, FAINTEST) / np.maximum(size, 1e-12))


def plane_of(element: Array) -> Array:
    """Columns (n, 3) of which planes over an array's places (n, 2) are made."""
    return np.column_stack([np.ones(len(element)), element])


def level(factor: Complex, element: Array) -> Complex:
    """Factors (n,) without the plane that fits their phases best over the elements' places (n, 2)."""
    if len(factor) == 1:
        return np.ones(1, np.complex128)
    plane, phase = plane_of(element), np.angle(factor)
    left = phase - plane @ np.linalg.lstsq(plane, phase, rcond=None)[0]
    return np.asarray(np.abs(factor) * np.exp(1j * left))
