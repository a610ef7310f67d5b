"""Factors of antenna elements beside their places: what cables, amplifiers and couplings make of them.

docs/model.md, (M565). Nothing here needs the truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, squared
from gridslam.world.waveform import Waveform, plane_of

Complex = NDArray[np.complex128]
KEEP = 0.99
"""Factor by which sums are multiplied per step: forgetting."""
KNOWN = 0.2**-2
"""Inverse variance of an element's factor about 1, before any sample."""
ROUNDS = 2
"""In which factors of agent and anchors are found in turn: of sums over many steps one would nearly do."""
SURPRISE, LEAST = 6.0, 0.03
"""Deviations beyond which factors of 1 are ruled out, and root mean square error that matters."""
FAINTEST = 0.5
"""Amplitude below which no element is made louder: there is more noise in it than signal."""
PHASE_STD, GUESSED = 0.15, 2.0
"""Of the phases of elements that are off (rad), as a guess; how many elements' phases it is worth."""
MOST_MATCHED = 1e6
"""Ratio to which sums can't come: samples of a signal that is so much louder than believed."""


@dataclass(frozen=True, eq=False)
class ElementGains:
    """What samples have said of the elements' factors.

    Attributes
    ----------
    matched : (J, A, B) complex128
        Sums of the samples times the conjugate of what paths are believed to make of them, over the noise.
    power : (J, A, B)
        Sums of the squares of the latter, over the noise.
    anchor, agent : (J, A), (B,) complex128
        The factors that fit these sums best.
    """

    matched: Complex
    power: Array
    anchor: Complex
    agent: Complex

    @classmethod
    def none(cls, waveform: Waveform) -> Self:
        """Before the first snapshot."""
        anchors, elements, carried = waveform.shape[:3]
        shape = (anchors, elements, carried)
        ones = np.ones((anchors, elements), np.complex128), np.ones(carried, np.complex128)
        return cls(np.zeros(shape, np.complex128), np.zeros(shape), *ones)

    def taken_in(self, matched: Complex, power: Array, waveform: Waveform) -> Self:
        """With the sums (J, A, B) of a step; zeros of anchors whose samples said nothing."""
        keep = np.where(power.any((1, 2)), KEEP, 1.0)[:, None, None]
        matched, power = keep * self.matched + matched, keep * self.power + power
        return type(self)(matched, power, *_fitted(matched, power, waveform))

    @property
    def variances(self) -> tuple[Array, Array]:
        """Of the factors of anchors (J, A) and agent (B,)."""
        anchor, agent = _weights(self.power, self.anchor, self.agent)
        return 1 / anchor, 1 / agent

    @cached_property
    def size(self) -> float:
        """Root mean square of the elements' errors, in ratio to 1; 0 unless beyond doubt, and of matter."""
        arrays = zip((self.anchor, self.agent), self.variances, strict=True)
        parts = [part for part in arrays if part[0].shape[-1] > 1]
        if not parts:
            return 0.0
        error = np.concatenate([squared(factor - 1).ravel() for factor, _ in parts])
        variance = np.concatenate([variance.ravel() for _, variance in parts])
        count, ratio = len(error), float((error / variance).sum())
        excess = float((error - variance).mean())
        beyond = ratio > count + SURPRISE * np.sqrt(count) and excess > LEAST**2
        return float(np.sqrt(excess)) if beyond else 0.0

    def phase_variance(self, waveform: Waveform) -> float:
        """Of the phases of elements, rad^2, over all arrays: each one's plane doesn't show.

        Of few elements hardly anything is left: then it is what cables mostly do.
        """
        squares = sum(float(np.square(np.angle(factor)).sum()) for factor in (self.anchor, self.agent))
        return (squares + GUESSED * PHASE_STD**2) / (waveform.phases_beyond_planes + GUESSED)

    def of(self, anchor: int) -> Complex:
        """By what the samples of an anchor's pairs of elements (A, B) are to be divided."""
        own, carried = _audible(self.anchor[anchor]), _audible(self.agent)
        return np.asarray(own[:, None] * carried)

    def is_sound(self, waveform: Waveform) -> bool:
        """Whether the sums can be those of samples, and the factors theirs."""
        if (self.power < 0).any() or (abs(self.matched) > MOST_MATCHED * (self.power + 1)).any():
            return False
        fitted = _fitted(self.matched, self.power, waveform)
        return np.allclose(self.anchor, fitted.anchor) and np.allclose(self.agent, fitted.agent)


class _Factors(NamedTuple):
    """Of anchors (J, A) and agent (B,)."""

    anchor: Complex
    agent: Complex


def _fitted(matched: Complex, power: Array, waveform: Waveform) -> _Factors:
    """The factors that fit sums (J, A, B) best, (M565).

    Less what all of an array have in common, the path's own amplitude, and slopes of their phases over the
    array, which are directions: a wrong place, turn or spacing would pass for factors.
    """
    anchor, agent = np.ones(power.shape[:2], np.complex128), np.ones(power.shape[2], np.complex128)
    for _ in range(ROUNDS):
        told = np.einsum("jab,ja->b", matched, anchor.conj())
        agent = (KNOWN + told) / _weights(power, anchor, agent)[1]
        agent /= agent.mean()
        told = np.einsum("jab,b->ja", matched, agent.conj())
        anchor = (KNOWN + told) / _weights(power, anchor, agent)[0]
        anchor /= anchor.mean(1, keepdims=True)
    own = zip(anchor, waveform.anchor_element_m, strict=True)
    return _Factors(np.stack([level(*pair) for pair in own]), level(agent, waveform.agent_element_m))


def _weights(power: Array, anchor: Complex, agent: Complex) -> tuple[Array, Array]:
    """Inverse variances of factors (J, A) and (B,), each as if the other's were known."""
    return (
        KNOWN + np.einsum("jab,b->ja", power, squared(agent)),
        KNOWN + np.einsum("jab,ja->b", power, squared(anchor)),
    )


def _audible(factor: Complex) -> Complex:
    """Factors that are no smaller than `FAINTEST`, of the same phases."""
    size = np.abs(factor)
    return np.asarray(factor * np.maximum(size, FAINTEST) / np.maximum(size, 1e-12))


def level(factor: Complex, element: Array) -> Complex:
    """Factors (n,) without the plane that fits their phases best over the elements' places (n, 2)."""
    if len(factor) == 1:
        return np.ones(1, np.complex128)
    plane, phase = plane_of(element), np.angle(factor)
    left = phase - plane @ np.linalg.lstsq(plane, phase, rcond=None)[0]
    return np.asarray(np.abs(factor) * np.exp(1j * left))
