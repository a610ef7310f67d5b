"""Association by summing over everything that could be."""

import itertools

import numpy as np


def random_association(draw, paths, measured, density):
    """Likelihood ratios (L, K), some of them 0, weights of misses (L,) and of new causes (K,)."""
    beta = draw.exponential(2.0, (paths, measured)) * (draw.random((paths, measured)) < density)
    return beta, draw.uniform(0.1, 1, paths), draw.uniform(1, 3, measured)


def every_matching(paths, measured):
    """All ways to give every path a measurement of its own, or None."""
    for choice in itertools.product([None, *range(measured)], repeat=paths):
        taken = [m for m in choice if m is not None]
        if len(set(taken)) == len(taken):
            yield choice


def enumerate_marginals(beta, missed, new):
    """Exact P(path l caused m), by summing over all valid assignments."""
    paths, measured = beta.shape
    marginal, total = np.zeros((paths, measured)), 0.0
    for choice in every_matching(paths, measured):
        weight = np.prod([missed[p] if c is None else beta[p, c] for p, c in enumerate(choice)])
        weight *= np.prod([new[m] for m in range(measured) if m not in choice])
        total += weight
        for path, cause in enumerate(choice):
            if cause is not None:
                marginal[path, cause] += weight
    return marginal / total
