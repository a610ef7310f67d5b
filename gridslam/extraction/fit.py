"""All paths of a snapshot fitted at once, amplitudes in closed form; and what that says of their errors.

docs/model.md, (M52), (M295).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.extraction.responses import Band, Products
from gridslam.world.geometry import wrap

Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]
ROUNDS = 12
DAMPING, LEAST_GAIN = 1e-3, 1e-4
"""Of the first round; a round that gains less energy than this share of the noise's is the last."""
WIDEST_STEP = 0.5
"""Step of a parameter, in units of its resolution."""
RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class Fit:
    """Paths of S snapshots, up to L in each.

    Attributes
    ----------
    paths : (S, L, 3) float64
        Length (m), departure and arrival (rad).
    there : (S, L) bool
        Which of them there are.
    amplitude : (S, L) complex
    energy : (S,) float64
        What is left of the samples' energy, and `ridge` times the amplitudes' own power.
    ridge : (S,) float64
        The noise's power over that which amplitudes are believed to have, (M295). 0 believes all.
    """

    paths: Array
    there: Mask
    amplitude: Complex
    energy: Array
    ridge: Array

    @property
    def count(self) -> NDArray[np.intp]:
        """Paths in each snapshot, (S,)."""
        return self.there.sum(1)

    @classmethod
    def none(cls, samples: Complex) -> Fit:
        """No path at all."""
        count = len(samples)
        energy = (np.abs(samples) ** 2).reshape(count, -1).sum(1)
        nothing = np.zeros((count, 0))
        return cls(
            np.zeros((count, 0, 3)), nothing.astype(bool), nothing.astype(complex), energy, np.zeros(count)
        )

    def take(self, rows: Mask | NDArray[np.intp]) -> Fit:
        """Some of the snapshots."""
        paths, there = self.paths[rows], self.there[rows]
        return Fit(paths, there, self.amplitude[rows], self.energy[rows], self.ridge[rows])

    def put(self, rows: Mask | NDArray[np.intp], other: Fit) -> Fit:
        """The fit with some of its snapshots replaced; paths may be more or fewer."""
        most = max(self.paths.shape[1], other.paths.shape[1])
        whole, part = self.padded(most), other.padded(most)
        paths, there = whole.paths.copy(), whole.there.copy()
        amplitude, energy, ridge = whole.amplitude.copy(), whole.energy.copy(), whole.ridge.copy()
        paths[rows], there[rows] = part.paths, part.there
        amplitude[rows], energy[rows], ridge[rows] = part.amplitude, part.energy, part.ridge
        return Fit(paths, there, amplitude, energy, ridge)

    def padded(self, most: int) -> Fit:
        """With room for `most` paths."""
        more = ((0, 0), (0, most - self.paths.shape[1]))
        return Fit(
            np.pad(self.paths, (*more, (0, 0))), np.pad(self.there, more), np.pad(self.amplitude, more),
            self.energy, self.ridge,
        )  # fmt: skip

    def with_path(self, path: Array) -> Fit:
        """One more path (S, 3) in every snapshot; amplitudes are to be fitted."""
        wide = self.padded(self.paths.shape[1] + 1)
        wide.paths[:, -1], wide.there[:, -1] = path, True
        return wide


def amplitudes(products: Products, there: Mask, ridge: Array) -> tuple[Complex, Complex, Array]:
    """Ridge regression: amplitudes (S, L), inverse of (M295) (S, L, L), energy explained (S,)."""
    gram = _masked(products.gram[:, 0, :, 0], there, ridge)
    inverse: Complex = np.asarray(np.linalg.inv(gram), np.complex128)
    matched = np.where(there, products.matched[:, 0], 0)
    found = np.einsum("slm,sm->sl", inverse, matched)
    return found, inverse, np.einsum("sl,sl->s", matched.conj(), found).real


def refit(band: Band, samples: Complex, fit: Fit) -> Fit:
    """Amplitudes and energy anew, at the paths as they are."""
    if not fit.paths.shape[1]:
        return replace(Fit.none(samples), ridge=fit.ridge)
    products = Products.of(band, samples, fit.paths, derivatives=False)
    amplitude, _, explained = amplitudes(products, fit.there, fit.ridge)
    total = (np.abs(samples) ** 2).reshape(len(samples), -1).sum(1)
    return replace(fit, amplitude=amplitude, energy=total - explained)


def refine(band: Band, samples: Complex, fit: Fit, believed: Array) -> Fit:
    """Paths moved to where the least energy is left: Levenberg-Marquardt with amplitudes projected out.

    Amplitudes are believed to have a power of `believed` (S,); the noise's is estimated anew at each round.
    """
    now = refit(band, samples, fit)
    if not now.paths.shape[1]:
        return now
    damping = np.full(len(samples), DAMPING)
    widest = np.array([WIDEST_STEP / max(band.extent(factor), 1e-9) for factor in band.free])
    busy = np.arange(len(samples))
    for _ in range(ROUNDS):
        part, own = _weighed(band, now.take(busy), believed[busy]), samples[busy]
        products = Products.of(band, own, part.paths)
        gradient, hessian, _ = slopes(products, part.there, part.ridge)
        size = gradient.shape[1]
        diagonal = np.arange(size)
        hessian[:, diagonal, diagonal] *= 1 + damping[busy, None]
        step = np.linalg.solve(hessian, gradient[..., None])[..., 0]
        step = step.reshape(len(busy), len(band.free), -1)
        step = np.clip(step, -widest[:, None], widest[:, None])
        moved = part.paths.copy()
        for number, factor in enumerate(band.free):
            moved[..., factor] += np.where(part.there, step[:, number], 0)
        new = refit(band, own, replace(part, paths=moved))
        better = new.energy < part.energy
        noise = part.energy / band.samples
        gain = part.energy - new.energy
        now = now.put(busy[better], new.take(better))
        damping[busy] = np.clip(damping[busy] * np.where(better, 0.2, 10.0), 1e-9, 1e6)
        going = np.where(better, gain > LEAST_GAIN * noise, damping[busy] < 1e4)
        busy = busy[going]
        if not len(busy):
            break
    return _wrapped(band, now)


def _weighed(band: Band, fit: Fit, believed: Array) -> Fit:
    """The ridge by what noise there is now, and the energy with it, to first order."""
    ridge = np.maximum(noise_power(band, fit), 0) / believed
    own = (np.abs(fit.amplitude) ** 2).sum(1)
    return replace(fit, ridge=ridge, energy=fit.energy + (ridge - fit.ridge) * own)


def slopes(products: Products, there: Mask, ridge: Array) -> tuple[Array, Array, Complex]:
    """Of half the energy left: gradient (S, P L), Gauss-Newton matrix (S, P L, P L); amplitudes (S, L)."""
    count, kinds, paths = products.matched.shape
    amplitude, inverse, _ = amplitudes(products, there, ridge)
    own = np.where(there, amplitude, 0)
    cross = products.gram[:, 1:, :, 0] * there[:, None, None, :]  # derivatives with responses, (S, P, L, L)
    left = products.matched[:, 1:] - np.einsum("splm,sm->spl", cross, own)
    gradient = (own.conj()[:, None] * left).real.reshape(count, -1)
    size = (kinds - 1) * paths
    flat = cross.reshape(count, size, paths)
    whole = products.gram[:, 1:, :, 1:].reshape(count, size, size)
    free = whole - np.einsum("sil,slm,sjm->sij", flat, inverse, flat.conj(), optimize=True)
    scale = np.tile(own, (1, kinds - 1))
    hessian = (scale.conj()[:, :, None] * free * scale[:, None, :]).real
    live = np.tile(there, (1, kinds - 1))
    hessian = np.where(live[:, :, None] & live[:, None, :], hessian, 0.0)
    diagonal = np.arange(size)
    level = np.einsum("sii->s", hessian) / np.maximum(live.sum(1), 1)
    hessian[:, diagonal, diagonal] += np.where(live, np.maximum(RIDGE * level, 1e-300)[:, None], 1.0)
    return np.where(live, gradient, 0.0), hessian, own


def noise_power(band: Band, fit: Fit) -> Array:
    """Mean power of the noise in a sample, (S,): what is left over the degrees of freedom that are left."""
    taken = fit.count * (1 + 0.5 * len(band.free))
    left = fit.energy - fit.ridge * (np.abs(fit.amplitude) ** 2).sum(1)
    return left / np.maximum(band.samples - taken, 1)


def deviations(band: Band, samples: Complex, fit: Fit, noise: Array) -> Array:
    """Standard deviations of the paths' parameters (S, L, 3), by their joint Fisher information.

    Amplitudes count as unknown, as those of all other paths: what overlaps is known less well. NaN where a
    path or parameter isn't there.
    """
    found = np.full(fit.paths.shape, np.nan)
    if not fit.paths.shape[1]:
        return found
    products = Products.of(band, samples, fit.paths)
    found_there, inverse, _ = amplitudes(products, fit.there, fit.ridge)
    _, hessian, _ = slopes(products, fit.there, fit.ridge)
    covariance = 0.5 * noise[:, None] * np.einsum("sii->si", np.linalg.inv(hessian))
    # noise makes an amplitude look larger than it is, and its path sharper
    power = np.abs(found_there) ** 2
    excess = noise[:, None] * np.einsum("sll->sl", inverse).real
    swollen = power / np.maximum(power - excess, 0.25 * power + 1e-300)
    spread = np.sqrt(np.maximum(covariance, 0)).reshape(len(samples), len(band.free), -1)
    spread = spread * np.sqrt(swollen)[:, None]
    for number, factor in enumerate(band.free):
        found[..., factor] = np.where(fit.there, spread[:, number], np.nan)
    return found


def _masked(gram: Complex, there: Mask, ridge: Array) -> Complex:
    """A Gram with the ridge on its diagonal, and rows and columns of unit vectors where no path is."""
    both = there[:, :, None] & there[:, None, :]
    masked = np.where(both, gram, 0)
    diagonal = np.arange(gram.shape[1])
    level = masked[:, diagonal, diagonal].real + RIDGE + ridge[:, None]
    masked[:, diagonal, diagonal] = np.where(there, level, 1.0)
    return masked


def _wrapped(band: Band, fit: Fit) -> Fit:
    """Lengths within the folding range, angles within a turn."""
    paths = fit.paths.copy()
    paths[..., 0] %= band.waveform.folding_m
    paths[..., 1:] = wrap(paths[..., 1:])
    return replace(fit, paths=paths)
