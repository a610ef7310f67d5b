"""Whether particles of virtual anchors that a file holds can be what they say."""

from __future__ import annotations

import numpy as np

from gridslam.errors import InputError
from gridslam.inference.state.published.feature_particles import Features, ImageState
from gridslam.inference.state.published.network_particles import CLOCK, NetworkParticleState
from gridslam.world.filter_model import FilterModel
from gridslam.world.network_model import NetworkModel


def require_sound_particles(believed: ImageState, model: FilterModel, where: str) -> None:
    """Refuse a state whose arrays don't fit each other or the scene, or hold what can't be.

    Raises
    ------
    InputError
        With the part, and what is allowed.
    """
    count = len(believed.agent)
    if believed.agent.shape != (count, 5) or count != model.settings.particles:
        allowed = f"({model.settings.particles}, 5), as the scene's filter.particles says"
        raise InputError(f"{where}/agent", f"shape {believed.agent.shape}", allowed)
    require_sound_features(believed.features, count, len(model.anchors), f"{where}/features")
    sights = np.sort(believed.features.anchor[believed.features.fixed])
    if not np.array_equal(sights, np.arange(len(model.anchors))):
        raise InputError(f"{where}/features/fixed", f"anchors {sights.tolist()}", "every anchor once")
    _require_new(believed, where)


def require_sound_network(believed: NetworkParticleState, model: NetworkModel, where: str) -> None:
    """The same of several agents and clocks.

    Raises
    ------
    InputError
        With the part, and what is allowed.
    """
    count, several, anchors = model.settings.particles, len(model.agents), len(model.anchors)
    shapes = {"agents": (several, count, CLOCK + 1), "clocks": (anchors, count), "here": (several,)}
    for name, shape in shapes.items():
        found = getattr(believed, name).shape
        if found != shape:
            raise InputError(f"{where}/{name}", f"shape {found}", str(shape))
    require_sound_features(believed.features, count, anchors, f"{where}/features")
    if believed.features.fixed.any():
        raise InputError(f"{where}/features/fixed", "lines of sight", "virtual anchors alone")
    _require_new(believed, where)


def _require_new(believed: ImageState | NetworkParticleState, where: str) -> None:
    newest = int(believed.features.identity.max(initial=-1))
    if believed.next_identity <= newest:
        raise InputError(f"{where}/next_identity", str(believed.next_identity), f"more than {newest}")


def require_sound_features(features: Features, count: int, anchors: int, where: str) -> None:
    """The same of features of so many particles and anchors."""
    size = len(features)
    shapes = {
        "identity": (size,), "anchor": (size,), "fixed": (size,), "existence": (size,),
        "position": (size, count, 2), "intensity": (size, count),
    }  # fmt: skip
    for name, shape in shapes.items():
        found = getattr(features, name).shape
        if found != shape:
            raise InputError(f"{where}/{name}", f"shape {found}", str(shape))
    if size and not ((features.anchor >= 0) & (features.anchor < anchors)).all():
        raise InputError(f"{where}/anchor", str(features.anchor.tolist()), f"0 to {anchors - 1}")
    if not ((features.existence >= 0) & (features.existence <= 1)).all():
        raise InputError(f"{where}/existence", str(features.existence.tolist()), "0 to 1")
