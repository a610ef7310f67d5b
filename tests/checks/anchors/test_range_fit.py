"""The fit of errors in distances to lines of sight, against the normal equations as they stand."""

import numpy as np

from gridslam.checks.anchors.range_fit import DAMPING, OUTLIER, _change


def test_poses_change_as_the_normal_equations_say():
    """Also where an anchor is next to the agent, and where nothing but arrivals was measured."""
    draw, shape = np.random.default_rng(1), (3, 4, 5)
    gap, precision = draw.normal(size=(3, *shape)) * 3, draw.uniform(10, 40, (3, 3, 5))
    precision[:, 1, 1] = precision[:2, :, 2] = 0.0
    toward, across = draw.normal(size=(2, *shape)), draw.normal(size=(2, *shape))
    across[:, 0, 0, 0] *= 1e3
    gap *= precision[:, :, None] > 0
    jacobian = np.zeros((3, *shape, 3))
    jacobian[0, ..., :2] = np.moveaxis(toward, 0, -1)
    jacobian[1, ..., :2] = jacobian[2, ..., :2] = np.moveaxis(across, 0, -1)
    jacobian[2, ..., 2] = -1
    jacobian *= precision[:, :, None, :, None]
    weighted = jacobian / (1 + (gap / OUTLIER) ** 2)[..., None]
    normal = np.einsum("cjsni,cjsnk->snik", weighted, jacobian) + DAMPING * np.eye(3)
    expected = np.linalg.solve(normal, np.einsum("cjsni,cjsn->sni", weighted, gap)[..., None])[..., 0]
    found = _change(gap, precision, tuple(toward), tuple(across))
    np.testing.assert_allclose(found, np.moveaxis(expected, -1, 0), rtol=1e-6)
