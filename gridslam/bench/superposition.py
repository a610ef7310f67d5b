"""The kernels that take a snapshot for a sum of paths, for direct SLAM, against their twins."""

from __future__ import annotations

import numpy as np

from gridslam import reference
from gridslam.bench.kernels import KernelSpeed, race
from gridslam.inference.messages.samples.array_likelihood import ArrayBand, climbed, superpose_arrays
from gridslam.inference.messages.samples.distance_mode import PathPrior, joint_mode, limits_of
from gridslam.inference.messages.samples.image_rings import NODES, nodes
from gridslam.inference.messages.samples.open_distances import POINTS
from gridslam.inference.messages.samples.response_series import ResponseSeries
from gridslam.inference.messages.samples.signal_likelihood import Band, Inverse, pairs
from gridslam.inference.state.rings import BEARINGS

NAMES = (
    "respond", "superpose", "climb", "climb_distances", "weigh_particles", "follow_rings", "weigh_rings",
)  # fmt: skip
SIDE, FREQUENCIES = 3, 21
RINGS, ANTENNA = 8, 41
PARTICLES, TWINS = 2000, 50
TURN = 2 * np.pi


def superposition_speeds(paths: int, seconds: float) -> list[KernelSpeed]:
    """Times of the kernels for so many paths of one anchor, each with the NumPy around it.

    Parameters
    ----------
    paths : int
    seconds : float
        At least so long each; a kernel runs three times or more, its twin once.
    """
    draw, element = np.random.default_rng(1), np.pi * np.mgrid[:SIDE, :SIDE].reshape(2, -1).T
    band = ArrayBand(
        np.linspace(-5.0, 5.0, FREQUENCIES),
        np.full(FREQUENCIES, FREQUENCIES**-0.5, complex),
        element,
        element,
    )
    path = np.column_stack([draw.uniform(2, 12, paths), draw.uniform(-3, 3, (paths, 2))])
    size = (SIDE**2, SIDE**2, FREQUENCIES)
    samples, weight = draw.normal(size=size) + 1j * draw.normal(size=size), np.full(paths, 10.0)
    of_band = (band.wavenumber, band.pulse, band.anchor, band.agent)
    where, none = f"{paths} paths", path[:0]
    return [
        race(
            "respond", where, "path", paths, seconds, 1.0,
            lambda: band.factors(path), lambda: band.factors(none), lambda: reference.respond(*of_band, path),
        ),
        race(
            "superpose", where, "path", paths, seconds, 1.0,
            lambda: superpose_arrays(band, samples, path, weight, 1.0),
            lambda: superpose_arrays(band, samples, none, weight[:0], 1.0),
            lambda: reference.superpose(reference.respond(*of_band, path), samples, weight, 1.0),
        ),
        race(
            "climb", "one peak", "step", 3, seconds, 1.0,
            lambda: climbed(band, samples, path[0], 3), lambda: climbed(band, samples, path[0], 0),
            lambda: reference.climb(*of_band, band.steepness, samples, 3, path[0]),
        ),
        _distances(draw, seconds),
        _particles(draw, seconds),
        *_rings(draw, seconds),
    ]  # fmt: skip


def _distances(draw: np.random.Generator, seconds: float) -> KernelSpeed:
    """Time of the search for the joint mode of all distances of one antenna."""
    band = Band.of(1e7 * (np.arange(ANTENNA) - 0.5 * (ANTENNA - 1)))
    length, weight = np.linspace(3.0, 20.0, RINGS), np.full(RINGS, 100.0)
    samples = 10 * band.response(length + 0.05).sum(0) + draw.normal(size=ANTENNA)
    prior, alone = (PathPrior(length[:n], 100.0 * np.eye(n), weight[:n]) for n in (RINGS, 1))
    limits = limits_of(band, 1.0)
    return race(
        "climb_distances", f"{RINGS} paths", "path", RINGS, seconds, 1.0,
        lambda: joint_mode(band, samples, prior, 1.0), lambda: joint_mode(band, samples, alone, 1.0),
        lambda: reference.climb_distances(
            band.wavenumber, band.pulse, samples, prior.mean, prior.precision, weight, prior.chances,
            limits, length,
        ),
    )  # fmt: skip


def _particles(draw: np.random.Generator, seconds: float) -> KernelSpeed:
    """Time of the densities at many particles; the twin's is that of so few of them."""
    band = Band.of(1e7 * (np.arange(ANTENNA) - 0.5 * (ANTENNA - 1)))
    distance = np.linspace(3.0, 20.0, RINGS)[:, None] + draw.normal(0, 0.1, (RINGS, PARTICLES))
    samples, power = draw.normal(size=ANTENNA).astype(np.complex128), np.full((RINGS, PARTICLES), 100.0)
    base = np.eye(ANTENNA, dtype=np.complex128)
    series = ResponseSeries.of(band, samples, 0 * base, 1.0)
    return race(
        "weigh_particles", f"{RINGS} paths", "path-particle", RINGS * PARTICLES, seconds, PARTICLES / TWINS,
        lambda: series.log_densities(distance, power),
        lambda: series.log_densities(distance[:, :1], power[:, :1]),
        lambda: reference.weigh_particles(
            band.wavenumber, band.pulse, samples, base, distance[:, :TWINS], power[:, :TWINS]
        ),
    )  # fmt: skip


def _rings(draw: np.random.Generator, seconds: float) -> list[KernelSpeed]:
    """Times of the messages to rings: what an agent learned, and a snapshot."""
    from gridslam.kernels.messages.rings import follow_rings, weigh_rings

    band = Band.of(1e7 * (np.arange(ANTENNA) - 0.5 * (ANTENNA - 1)))
    samples, weight = (
        draw.normal(size=ANTENNA).astype(np.complex128),
        np.full((RINGS, BEARINGS), 1 / BEARINGS),
    )
    mean = np.zeros((RINGS, BEARINGS, 6))
    mean[..., 4] = np.linspace(3.0, 20.0, RINGS)[:, None]
    covariance = np.broadcast_to(1e-3 * np.eye(6), (*mean.shape, 6)).copy()
    log, there = np.zeros((2, RINGS, BEARINGS))
    still = np.column_stack([np.zeros((4, 2)), 1e-3 * np.eye(4), np.zeros((4, 4))])
    rows, power = np.arange(RINGS), np.full(RINGS, 100.0)
    inverse = Inverse.of(band, samples, power, mean[:, 0, 4], np.full(RINGS, 1e-4), 1.0)
    table = inverse.sweep(POINTS)
    taken, limits = (
        pairs(inverse.taken_by(rows)),
        np.array([table.spacing_m, 2, 0.1, 0.97, 0.4, TURN / POINTS]),
    )
    logs = inverse.sweeps_without(table, rows).log_ratio(power[:, None])

    def weigh(rings: int) -> None:
        weigh_rings(
            weight[:rings], power[:rings], pairs(table.matched), table.self_power, taken[:rings], limits,
            np.empty(POINTS), nodes(), mean[:rings].copy(), covariance[:rings].copy(), log[:rings],
            there[:rings],
        )  # fmt: skip

    def follow(rings: int) -> None:
        follow_rings(weight[:rings], still, mean[:rings].copy(), covariance[:rings].copy(), log[:rings])

    where, every = f"{RINGS} rings", RINGS * BEARINGS
    return [
        race(
            "follow_rings", where, "hypothesis", every, seconds, 1.0,
            lambda: follow(RINGS), lambda: follow(1),
            lambda: reference.follow_rings(
                weight, still[:, 0], still[:, 1], 1e-6 * np.eye(4), still[:, 6:], mean, covariance
            ),
        ),
        race(
            "weigh_rings", where, "hypothesis", every, seconds, 1.0, lambda: weigh(RINGS), lambda: weigh(1),
            lambda: reference.weigh_rings(weight, logs, limits, NODES, mean, covariance),
        ),
    ]  # fmt: skip
