"""Whether a state of hybrid SLAM that was read from a file can be one."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from gridslam.errors import InputError
from gridslam.inference.messages.features.lessons import SETTLED, due
from gridslam.inference.state.features.features import ENTRIES, MOVING, FeatureBank
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief, ParticleBelief, Segment
from gridslam.inference.state.features.networks import FEATURES, HIDDEN, Network
from gridslam.world.signal_model import SignalModel

SLACK = 1e-6


def require_sound(state: HybridState, model: SignalModel, where: str, always_particles: bool) -> None:
    """Refuse a state whose numbers can't be.

    Parameters
    ----------
    always_particles : bool
        Of a method that has nothing else once it began.

    Raises
    ------
    InputError
        With the part, and what is allowed.
    """
    anchors = len(model.anchors)
    particles = state.step > 0 and (always_particles or state.step < SETTLED)
    claims = [
        ("step", state.step >= 0 and state.silent >= 0, "0 or more"),
        ("particles", (state.particles is not None) == particles, f"none from step {SETTLED} on"),
        ("lesson", due(state), "the state at the end of the latest segment"),
        ("early", 0 <= state.early <= 1, "a share"),
        ("time_s", (state.time_s is None) == (state.step == 0), "a time once a step was taken"),
        *((f"joint/{part}", *claim) for part, *claim in _joint(state.joint, anchors)),
        *((f"before/{part}", *claim) for part, *claim in _joint(state.before, anchors)),
        *_segment(state.segment, model),
    ]
    bank = state.joint.features
    claims.append(
        ("next_identity", state.next_identity > bank.identity.max(initial=-1), "above all identities")
    )
    if state.particles is not None:
        claims += _particles(state.particles, anchors)
    if state.networks is not None:
        claims += _network(state.networks.places, 3 * FEATURES, "networks/places")
        claims += _network(state.networks.powers, FEATURES, "networks/powers")
    if state.lesson is not None and due(state):
        require_sound(state.lesson, model, f"{where}/lesson", always_particles)
    for part, holds, allowed in claims:
        if not holds:
            raise InputError(f"{where}/{part}", "numbers that can't be", str(allowed))


def _joint(belief: JointBelief, anchors: int) -> list[tuple[str, bool, str]]:
    bank: FeatureBank = belief.features
    count = len(bank)
    size = MOVING + ENTRIES * count
    rows = all(len(getattr(bank, f.name)) == count for f in fields(bank)) and bank.origin_m.shape == (
        count,
        2,
    )
    fits = belief.mean.shape == (size,) and belief.covariance.shape == (size, size)
    levels, places = (belief.existence, belief.los_power, belief.noise), belief.sightings.agent_m
    return [
        ("features", rows, "a row for each feature"),
        ("mean", fits, f"{MOVING} entries, and {ENTRIES} for each feature"),
        ("features/anchor", bool(((bank.anchor >= 0) & (bank.anchor < anchors)).all()), "anchors' numbers"),
        ("features/power", bool((bank.power >= 0).all()), "0 or more"),
        ("levels", all(level.shape == (anchors,) for level in levels), "one for each anchor"),
        ("existence", bool(((belief.existence >= 0) & (belief.existence <= 1)).all()), "probabilities"),
        ("extent", bool(0 <= belief.extent < np.inf), "0 or more"),
        ("sightings", places.shape == (len(belief.sightings), 2), "a place for each"),
        ("sightings/agent_m", bool(np.isfinite(places).all()), "finite"),
        ("noise", bool((belief.noise > 0).all() and (belief.los_power > 0).all()), "positive numbers"),
    ]


def _segment(segment: Segment, model: SignalModel) -> list[tuple[str, bool, str]]:
    anchors, _, elements, frequencies = model.waveform.shape
    count = len(segment)
    shapes = {
        "heading_rad": (count,), "heard": (count, anchors), "agent": (count, MOVING), "evidence": (count,),
        "samples": (count, anchors, elements, frequencies),
    }  # fmt: skip
    fit = all(getattr(segment, name).shape == shape for name, shape in shapes.items())
    return [
        ("segment", fit, "a row for each of its steps, shaped like the waveform"),
        ("segment/time_s", bool((np.diff(segment.time_s) > 0).all()), "rising times"),
    ]


def _particles(cloud: ParticleBelief, anchors: int) -> list[tuple[str, bool, str]]:
    count = len(cloud.agent)
    shapes = cloud.agent.shape == (count, MOVING) and cloud.noise.shape == (anchors, count)
    fit = shapes and cloud.node.shape == cloud.weight.shape and len(cloud.node) == anchors
    weights = bool((cloud.weight >= 0).all() and (np.abs(cloud.weight.sum(-1) - 1) < SLACK).all())
    return [
        ("particles", bool(count) and fit and cloud.existence.shape == (anchors,), "one shape"),
        ("particles/weight", weights, "probabilities"),
        ("particles/noise", bool((cloud.noise > 0).all() and (cloud.node > 0).all()), "positive numbers"),
    ]


def _network(network: Network, outputs: int, name: str) -> list[tuple[str, bool, str]]:
    shapes = [(HIDDEN, 2), (HIDDEN,), (HIDDEN, HIDDEN), (HIDDEN,), (outputs, HIDDEN), (outputs,)]
    squares = all(bool((one >= 0).all()) for one in network.second)
    return [
        *((f"{name}/{part}", [one.shape for one in getattr(network, part)] == shapes, f"shapes {shapes}")
          for part in ("weights", "first", "second")),
        (f"{name}/second", squares, "0 or more"),
        (f"{name}/moves", network.moves >= 0, "0 or more"),
    ]  # fmt: skip
