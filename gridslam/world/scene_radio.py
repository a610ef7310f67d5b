"""The radio of a scene: numbers of the link between anchors and an agent, and signals that it samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.errors import InputError
from gridslam.world.radio import SPEED_OF_LIGHT, RadioModel
from gridslam.world.scene_parts import Agent, Anchor, ArraySpec, Radio
from gridslam.world.validation import fault
from gridslam.world.waveform import Waveform

SAMPLED = "chamber", "overlap", "scatter", "screen"
"""Bundled scenes whose radios sample signals."""
PATH_SAMPLES = 2500
"""Samples over all antenna pairs, where a scene gives neither them nor frequencies."""


def link_of(radio: Radio, anchors: Sequence[Anchor], carried: ArraySpec) -> RadioModel:
    """Numbers of the link that likelihoods need.

    Parameters
    ----------
    carried : ArraySpec
        The agent's array.
    """
    arrays = [*(anchor.array or radio.array for anchor in anchors), carried]
    tall = len(anchors[0].position_m) > 2
    return RadioModel(
        amplitude_at_1m=10 ** (radio.snr_at_1m_db / 20),
        threshold=10 ** (radio.detection_threshold_db / 20),
        bandwidth_hz=radio.bandwidth_hz,
        samples=float(radio.samples or samples_of(radio, anchors, carried)),
        false_alarms=radio.false_alarms,
        max_distance_m=radio.max_distance_m,
        anchor_aperture=np.stack([array.aperture for array in arrays[:-1]]),
        agent_aperture=carried.aperture,
        measures=radio.measures,
        given_detection=radio.detection_probability,
        given_distance_std=radio.distance_std_m,
        window_m=radio.window_m,
        upright=tuple(array.upright for array in arrays) if tall else (),
    )


def samples_of(radio: Radio, anchors: Sequence[Anchor], carried: ArraySpec) -> int:
    """Samples over all antenna pairs, by the frequencies and the first anchor's array."""
    if radio.frequencies is None:
        return PATH_SAMPLES
    return radio.frequencies * _size(anchors[0].array or radio.array) * _size(carried)


def check_samples(radio: Radio, anchors: Sequence[Anchor], agents: Sequence[Agent]) -> None:
    """A number of samples that is given must be that of the frequencies and of some agent's antennas."""
    if radio.frequencies is None or radio.samples is None:
        return
    arrays = [agent.array or radio.array for agent in agents] or [radio.array]
    allowed = sorted({samples_of(radio, anchors, array) for array in arrays})
    if radio.samples not in allowed:
        follows = " or ".join(map(str, allowed))
        raise fault("radio.samples", str(radio.samples), f"{follows}, as frequencies and arrays say")


def waveform_of(radio: Radio, anchors: Sequence[Anchor], agent: Agent, scene: str) -> Waveform:
    """Frequencies, pulse and elements of the signals that an agent would sample.

    Parameters
    ----------
    scene : str
        Its name, for errors.

    Raises
    ------
    InputError
        There are no frequencies, or the anchors' arrays differ in size, or have layers.
    """
    if radio.frequencies is None:
        allowed = (
            "frequencies and frequency_step_hz (say 41 and 1e7, and bandwidth_hz, max_distance_m and "
            "samples, which follow, left out), to sample signals; or a bundled scene that does: "
            + ", ".join(SAMPLED)
        )
        raise InputError(f"{scene}: radio.frequencies", "none", allowed)
    arrays = [(anchor.array or radio.array) for anchor in anchors]
    tall = max(array.layers for array in (*arrays, agent.array or radio.array))
    if tall > 1:
        raise InputError(f"{scene}: array.layers", str(tall), "1: arrays that sample signals are level")
    for index, array in enumerate(arrays):
        if _size(array) != _size(arrays[0]):
            found, allowed = f"{_size(array)} elements", f"{_size(arrays[0])}, as of the first anchor"
            raise InputError(f"{scene}: anchors[{index}].array", found, allowed)
    offset, scale = radio.offset_hz, SPEED_OF_LIGHT / radio.carrier_hz
    pulse = np.ones(len(offset)) if radio.pulse is None else radio.pulse.spectrum(offset)
    return Waveform(
        radio.carrier_hz, offset, pulse.astype(np.complex128),
        scale * np.stack([array.elements for array in arrays]),
        scale * (agent.array or radio.array).elements,
        None, float(np.radians(agent.heading_sensor_deg or 0.0)),
    )  # fmt: skip


def _size(array: ArraySpec) -> int:
    return array.rows * array.columns
