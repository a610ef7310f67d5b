"""Standard deviations of an anchor's measurements: their own, or by amplitude and aperture; (M10)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.scans.anchor_measurements import AnchorScan, whole_of
from gridslam.kernels import FAINTEST
from gridslam.world.geometry import lean
from gridslam.world.radio import RadioModel


def deviations(
    scan: AnchorScan, measurement: NDArray[np.intp], amplitude: Array, angles: Array, radio: RadioModel,
    steep: Array | float | None = None,
) -> Array:  # fmt: skip
    """Standard deviations (n, 3) of (distance, AoD, AoA): the table's own, or from Fisher information.

    Infinite where nothing was measured.

    Parameters
    ----------
    measurement : (n,)
        Rows of `scan`.
    amplitude : (n,)
        Believed amplitude of the path behind each.
    angles : (n, 2) rad
        AoD and AoA, on which the arrays' aperture depends.
    steep : (n,), optional
        Cosine of the path's elevation; default: by the anchor's height and the measured distance.
    """
    value, own_std = scan.value[measurement], scan.own_std[measurement]
    aperture = radio.anchor_aperture.mean(0) if scan.anchor < 0 else radio.anchor_aperture[scan.anchor]
    height = scan.height if scan.anchor >= 0 else 0.0
    if steep is None:
        steep = _lean(value, height) if height else 1.0
    return _deviations(value, own_std, amplitude, angles, aperture, steep, radio)


def own_deviations(scans: Sequence[AnchorScan], radio: RadioModel) -> Array:
    """`deviations` (M, 3) of all measurements of known anchors, each by its own amplitude and angles.

    They depend on neither gain nor clutter, so that a step works them out once for all hypotheses.
    """
    whole, heights = whole_of(scans), [scan.height for scan in scans]
    aperture = radio.anchor_aperture[whole.label]
    own = np.repeat(heights, [len(scan) for scan in scans]) if any(heights) else None
    steep = 1.0 if own is None else _lean(whole.value, own)
    return _deviations(
        whole.value, whole.own_std, whole.amplitude, whole.value[:, 1:], aperture, steep, radio
    )


def _lean(value: Array, height: Array | float) -> Array:
    """Cosine of the elevation of paths with measured values (n, 3)."""
    return lean(np.where(np.isnan(value[:, 0]), np.inf, value[:, 0]), height)


def _deviations(
    value: Array, own_std: Array, amplitude: Array, angles: Array, aperture: Array, steep: Array | float,
    radio: RadioModel,
) -> Array:  # fmt: skip
    """`deviations` by apertures of the anchors, (2,) or (n, 2)."""
    amplitude = np.maximum(amplitude, FAINTEST)
    fisher = np.empty((len(value), 3))
    fisher[:, 0] = radio.distance_std(amplitude)
    apertures = np.empty((*aperture.shape[:-1], 2, 2))
    apertures[..., 0, :], apertures[..., 1, :] = aperture, radio.agent_aperture
    fisher[:, 1:] = radio.angle_std(amplitude[:, None], angles, apertures, np.asarray(steep)[..., None])
    std = np.where(np.isnan(own_std), fisher, own_std)
    return np.where(np.isnan(value), np.inf, std)
