"""Whether what direct SLAM believes may be mirrored: docs/model.md, (M444).

Distances to anchors in one line with the agent don't depend on the side of that line, and where the way
across it isn't known yet, neither does motion: the world mirrored at the line, agent and images, receives the
same samples, and stays as likely as the true one for as long as no other anchor is in sight. One Gaussian
holds one of them, and can't tell that it might as well be the other.
"""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.inference.messages.samples.signal_likelihood import Band
from gridslam.inference.state.samples.images import DirectState
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import direction, unit

BENT = 0.5
"""How far a circle of equal distance may bend within the belief, in deviations of that distance: beyond, both
sides of the line fit."""
IN_SIGHT, SURE, LOUD = 0.5, 0.99, 10.0
"""Visibility from which on a line of sight counts; of one that bears a side out, and its least SNR."""


def watch_mirrors(state: DirectState, band: Band, model: FilterModel) -> DirectState:
    """Note which anchors can't decide, while both sides fit, until another one decides between them.

    Those in sight can't, as both sides have one distance from them. Neither can one whose distance is known
    worse than to c/B: whatever it receives then, a reflection too, passes for its line of sight.
    """
    links, sided, bent = state.links, state.one_sided, bends(state, band, model)
    if not len(sided):  # of an earlier version's checkpoint
        sided = np.zeros(len(bent), np.int64)
    if (bent > BENT).any():
        fits = (links.visible > IN_SIGHT) | (_spread_along(state, model) > band.resolution_m)
        return replace(state, one_sided=np.maximum(sided, fits.astype(np.int64)))
    snr = links.intensity / np.maximum(links.noise, 1e-300)
    others = (links.visible > SURE) & (snr > LOUD) & (sided == 0)
    return replace(state, one_sided=np.zeros_like(sided)) if sided.any() and others.any() else state


def bends(state: DirectState, band: Band, model: FilterModel) -> Array:
    """How far circles about the anchors (J,) bend within the belief, in deviations of their distances (M444).

    0 for an anchor that isn't in sight, and where the velocity tells on which side the agent will be.
    """
    links = state.links
    away = state.belief.mean[:2] - model.anchor_positions
    distance = np.maximum(np.sqrt((away * away).sum(-1)), 1e-3)
    across = np.stack([-away[:, 1], away[:, 0]], -1) / distance[:, None]
    variance, of_velocity = (
        np.einsum("ji,ik,jk->j", across, state.belief.covariance[own, own], across)
        for own in (slice(0, 2), slice(2, 4))
    )
    either = np.square(across @ state.belief.mean[2:4]) < of_velocity
    snr = links.intensity / np.maximum(links.noise, 1e-300)
    bend = 0.5 * variance / distance * np.sqrt(2 * snr) * band.rms_wavenumber
    return np.where((links.visible > IN_SIGHT) & (links.noise > 0) & either, bend, 0.0)


def _spread_along(state: DirectState, model: FilterModel) -> Array:
    """Deviations (J,) of the distances to all anchors, m."""
    along = unit(direction(model.anchor_positions, state.belief.mean[:2]))
    return np.sqrt(np.einsum("ji,ik,jk->j", along, state.belief.covariance[:2, :2], along))
