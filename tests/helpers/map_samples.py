"""Small maps made by hand or by chance, for the tests of maps, their files and their fusion."""

from dataclasses import fields, replace

import numpy as np

from gridslam.estimate_tables import SurfaceEstimate
from gridslam.maps.map import Map
from gridslam.world.radio import REFLECTION_BINS

BINS = len(REFLECTION_BINS)


def surfaces(lines, std=(0.01, 0.02), existence=0.9, extent=(-1.0, 2.0), reflection=0.5):
    count = len(lines)
    return SurfaceEstimate.from_lines(
        np.array(lines, float),
        np.tile(np.diag(np.square(std)), (count, 1, 1)),
        np.full(count, reflection),
        np.full(count, 0.01),
        np.full(count, existence),
        np.tile(extent, (count, 1)),
    )


def random_map(seed, shape=(4, 5), cell=0.1, origin=(-0.3, 1.7), prior=0.01, lines=((0.3, 2.0),)):
    draw = np.random.default_rng(seed)
    observed = draw.random(shape) < 0.7
    hit = observed & (draw.random(shape) < 0.5)
    posterior = draw.random((len(lines), BINS)) + 0.1
    return Map(
        np.array(origin),
        cell,
        np.where(observed, draw.normal(0, 6, shape), 0),
        draw.normal(0, 3, (*shape, BINS)) * hit[..., None],
        observed,
        prior,
        surfaces(lines),
        posterior / posterior.sum(-1, keepdims=True),
        {"agents": ["a"], "seeds": [seed], "steps": [7], "scene": "room", "rate": 0.5, "count": 3},
    )


def of_another_run(sheet):
    """The map as if it were made of other measurements than those that are heard next."""
    return replace(sheet, provenance={**sheet.provenance, "runs": [""]})


def assert_same(a, b):
    for name in ("origin_m", "cell_m", "evidence", "coefficient", "observed", "prior", "surface_reflection"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert (a.surfaces is None) == (b.surfaces is None)
    for field in fields(SurfaceEstimate) if a.surfaces is not None else ():
        np.testing.assert_array_equal(getattr(a.surfaces, field.name), getattr(b.surfaces, field.name))
