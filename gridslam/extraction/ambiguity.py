"""Whether another direction explains a path as well: an array's opposites, and beams beside the strongest.

docs/model.md, (M482).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.extraction.fit import RIDGE, Fit
from gridslam.extraction.responses import Band
from gridslam.world.geometry import wrap

Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]
ODDS = 0.05
"""Of another direction over the one that was found, from which on neither is told."""
BEYOND = 5.0
"""Deviations from the direction found within which its own peak reaches."""
POINTS_PER_BEAM, LEAST_POINTS, MOST_POINTS = 8, 32, 1440
"""Directions tried over those that the array's size tells apart."""
ROUNDS = 24
"""Of golden sections, each 0.62 of the one before: 1e-5 of the first width."""
GOLDEN = 0.5 * (np.sqrt(5.0) - 1)
LEAST_OWN = 1e-3
"""Share of a response that other paths don't explain, at least."""
MOST_ENTRIES = 2**21
"""Inner products of paths over all directions that are held at once."""


def ambiguous(band: Band, samples: Complex, fit: Fit, spread: Array, noise: Array) -> Mask:
    """Which angles (S, L, 3) of paths have a rival far off that is nearly as likely; never the length, 0.

    Parameters
    ----------
    samples : (S, A, B, M)
    spread : (S, L, 3)
        Deviations of the paths' parameters, which are claimed of their own peaks.
    noise : (S,)
        Mean power of the noise in a sample.
    """
    found = np.zeros(fit.paths.shape, bool)
    paths = max(fit.paths.shape[1], 1)
    for factor in (1, 2):
        if not band.sees(factor):
            continue
        angles = _angles(band, factor)
        block = max(1, MOST_ENTRIES // (paths**2 * max(len(angles), paths)))
        for begin in range(0, len(samples), block):
            rows = np.arange(begin, min(begin + block, len(samples)))
            least = np.log(ODDS) * noise[rows, None]
            gain = _Gain(band, samples[rows], fit.take(rows), factor)
            found[rows, :, factor] = _rivalled(gain, angles, BEYOND * spread[rows, :, factor], least)
    return found & fit.there[..., None]


def _rivalled(gain: _Gain, angles: Array, reach: Array, least: Array) -> Mask:
    """Whether a path has a peak beyond `reach` (S, L) of its own, as high as that and `least` (S, 1)."""
    own = gain.angle
    level = gain(own[..., None])[..., 0] + least
    high = gain(np.broadcast_to(angles, (*own.shape, len(angles))))
    peak = (high >= np.roll(high, 1, -1)) & (high >= np.roll(high, -1, -1))
    top = np.where(peak, high, -np.inf)
    rivals = np.argsort(-top, axis=-1)[..., : peak.sum(-1).max(initial=1)]
    at, high = _climbed(gain, angles[rivals], 2 * np.pi / len(angles))
    apart = np.abs(wrap(at - own[..., None])) > reach[..., None]
    return np.asarray((apart & (high > level[..., None])).any(-1))


def _angles(band: Band, factor: int) -> Array:
    """Directions (T,) rad that are tried: of each beam several."""
    q = band.elements[factor - 1]
    reach = np.linalg.norm(q - q.mean(0), axis=1).max() / band.waveform.wavelength_m
    count = int(np.clip(np.ceil(POINTS_PER_BEAM * 4 * np.pi * reach), LEAST_POINTS, MOST_POINTS))
    return np.linspace(-np.pi, np.pi, count, endpoint=False)


def _climbed(gain: _Gain, middle: Array, width: float) -> tuple[Array, Array]:
    """Where the gain is greatest within `width` of (S, L, T) rad, and how great, by golden sections."""
    low, high = middle - width, middle + width
    for _ in range(ROUNDS):
        left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        up = gain(right) > gain(left)
        low, high = np.where(up, left, low), np.where(up, high, right)
    at = 0.5 * (low + high)
    return at, gain(at)


class _Gain:
    """Energy that each path takes beside all others, by its direction at one end; (M482).

    That of the part of its response that the others don't explain, so their amplitudes follow.
    """

    def __init__(self, band: Band, samples: Complex, fit: Fit, factor: int) -> None:
        self.band, self.factor, self.angle = band, factor, fit.paths[..., factor]
        responses = [band.factor(one, fit.paths[..., one])[0] for one in range(3)]
        spec = ("slm,slb,sabm->sla", "slm,sla,sabm->slb")[factor - 1]
        # what the path's own length and other end leave of the samples for this end's elements, (S, L, n)
        parts = responses[0].conj(), responses[3 - factor].conj(), samples
        self.matched: Complex = np.asarray(np.einsum(spec, *parts, optimize=True))
        self.own = responses[factor]
        products = [np.einsum("sln,smn->slm", r.conj(), r, optimize=True) for r in responses]
        self.rest: Complex = np.asarray(products[0] * products[3 - factor])  # all but this end's
        paths = fit.paths.shape[1]
        self.beside = fit.there[:, None, :] & ~np.eye(paths, dtype=bool)  # (S, L, L): others of each path
        both = self.beside[..., :, None] & self.beside[..., None, :]
        gram = np.where(both, (self.rest * products[factor])[:, None], 0)
        diagonal = np.arange(paths)
        gram[..., diagonal, diagonal] += np.where(self.beside, RIDGE + fit.ridge[:, None, None], 1.0)
        self.inverse: Complex = np.asarray(np.linalg.inv(gram), np.complex128)
        told = np.einsum("sln,sln->sl", self.own.conj(), self.matched, optimize=True)
        self.told = np.where(self.beside, told[:, None], 0)

    def __call__(self, angle: Array) -> Array:
        """Energy (S, L, T) at directions (S, L, T) rad."""
        response, _ = self.band.factor(self.factor, angle)
        cross = np.einsum("sltn,smn->sltm", response.conj(), self.own, optimize=True)
        cross = np.where(self.beside[:, :, None], cross * self.rest[:, :, None], 0)
        part = np.einsum("sltm,slmk->sltk", cross, self.inverse, optimize=True)
        left = np.einsum("sltn,sln->slt", response.conj(), self.matched, optimize=True)
        left = left - np.einsum("sltk,slk->slt", part, self.told, optimize=True)
        share = 1 - np.einsum("sltk,sltk->slt", part, cross.conj(), optimize=True).real
        return np.asarray(np.abs(left) ** 2 / np.maximum(share, LEAST_OWN))
