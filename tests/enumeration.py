"""Association by summing over everything that could be."""

import itertools

import numpy as np


def enumerate_marginals(beta, missed, new):
    """Exact P(path l caused m), by summing over all valid assignments."""
    paths, heard = beta.shape
    marginal, total = np.zeros((paths, heard)), 0.0
    for choice in itertools.product(range(-1, heard), repeat=paths):
        taken = [c for c in choice if c >= 0]
        if len(set(taken)) < len(taken):
            continue
        weight = np.prod([missed[p] if c < 0 else beta[p, c] for p, c in enumerate(choice)])
        weight *= np.prod([new[m] for m in range(heard) if m not in taken])
        total += weight
        for path, cause in enumerate(choice):
            if cause >= 0:
                marginal[path, cause] += weight
    return marginal / total
