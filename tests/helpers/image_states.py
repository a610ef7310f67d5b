"""States of direct SLAM with settled images at given places."""

from dataclasses import replace

import numpy as np

from gridslam.inference.beliefs.belief import append
from gridslam.inference.state.samples.images import DirectState, Images


def with_images(model, *images, spread=0.03):
    """A state with settled images: (anchor, place, bounces) each, independent of each other."""
    noise = np.ones(len(model.anchors))
    state = DirectState.start(model.start_mean[:4], model.start_variance[:4], len(model.anchors), noise)
    for number, (anchor, place, bounces) in enumerate(images):
        away = np.asarray(place) - state.belief.mean[:2]
        span, one = np.hypot(*away), np.ones(1)
        polar = np.array([np.arctan2(away[1], away[0]), span])
        belief = append(state.belief, polar, spread**2 * np.diag([1 / span**2, 1]))
        image = Images(
            np.array([number]), np.array([anchor]), belief.mean[None, :2], 0.99 * one, 0.9 * one, 50 * one,
            20 * one, np.array([20]), np.full((1, 2), np.nan), np.array([bounces]),
        )  # fmt: skip
        state = replace(state, belief=belief, images=state.images.joined(image), next_identity=number + 1)
    return state
