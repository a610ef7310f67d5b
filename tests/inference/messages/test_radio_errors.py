"""Errors of elements and pulse are found from samples along a known way."""

import numpy as np
import pytest
from signal_worlds import received, signal_model

from gridslam.inference.messages.features.radio_errors import (
    Known,
    _bent,
    _first_levels,
    _slopes,
    radio_errors,
)
from gridslam.world.radio import SPEED_OF_LIGHT

PATHS = np.array([[3.0, 4.0, 0.0], [-6.0, 2.0, 0.0], [2.0, -4.0, 8.06]])
POWERS = [4000.0, 2000.0, 1200.0]
WAVELENGTH = SPEED_OF_LIGHT / 7e9


def world(steps, seed=0, element=None):
    """What was heard along a way that turns, by elements and a pulse that nobody knows of."""
    plain, draw = signal_model(), np.random.default_rng(seed)
    wave = plain.waveform
    more = {} if element is None else {"agent_element_m": wave.agent_element_m + element}
    real = signal_model(**more)
    samples, pose = [], []
    for k in range(steps):
        place, heading = np.array([0.1 * k, np.sin(0.2 * k)]), 0.25 * k
        z = received(real, place, heading, PATHS, POWERS, draw)[0]
        samples.append(z)
        pose.append([*place, heading])
    return Known(np.array(samples), np.array(pose), PATHS), wave


@pytest.mark.slow
def test_a_wrong_element_of_a_twentieth_of_a_wavelength_is_found():
    error = np.zeros((4, 2))
    error[2] = np.array([0.04, -0.03]) * WAVELENGTH
    known, wave = world(30, element=error)
    found = radio_errors([known], wave)
    # that all are shifted alike can't be told
    off = (found.element_error_m - found.element_error_m.mean(0)) - (error - error.mean(0))
    assert np.abs(off).max() < 0.01 * WAVELENGTH
    assert np.abs(off / found.element_std_m).max() < 4
    assert np.argmax(np.hypot(*(found.element_error_m - found.element_error_m.mean(0)).T)) == 2
    gap = found.waveform.agent_element_m - wave.agent_element_m
    np.testing.assert_allclose(gap, found.element_error_m, atol=1e-12)


@pytest.mark.slow
def test_nothing_is_wrong_with_a_radio_that_is_as_it_was_drawn():
    known, wave = world(30, seed=1)
    found = radio_errors([known], wave)
    assert np.abs(found.element_error_m - found.element_error_m.mean(0)).max() < 0.01 * WAVELENGTH
    parts = np.log1p(found.pulse_error)
    off = np.array([parts.real - parts.real.mean(), parts.imag - parts.imag.mean()]) / found.pulse_std
    assert np.abs(off).max() < 4.5
    assert 0.6 < np.sqrt((off**2).mean()) < 1.3


@pytest.mark.slow
def test_a_bent_pulse_is_found():
    known, wave = world(40, seed=2)
    bend = np.exp(0.15 * np.cos(np.linspace(0, 6, 41)) + 0.2j * np.sin(np.linspace(0, 9, 41)))
    clean = Known(known.samples * bend, known.pose, known.paths)  # its noise is bent, too, by little
    found = radio_errors([clean], wave)
    ratio = (1 + found.pulse_error) / bend
    ratio /= ratio.mean()
    off = np.array([np.log(ratio).real, np.log(ratio).imag]) / found.pulse_std
    assert np.sqrt((off**2).mean()) < 1.3
    assert np.abs(bend - bend.mean()).mean() > 3 * np.abs(ratio - 1).mean(), "most of it is found"


@pytest.mark.slow
@pytest.mark.parametrize("entry", [0, 5, 8, 20, 49])
def test_slopes_are_those_of_the_log_likelihood(entry):
    known, wave = world(2, seed=3)
    level, size = _first_levels(known, wave), 8 + 2 * 41

    def density(x):
        """By the whole covariance."""
        from gridslam.inference.messages.features.radio_errors import _responses

        plain, total = _bent_as_is(wave, x), 0.0
        for step, z in enumerate(known.samples):
            flat = _responses(known, plain, step)[0].reshape(-1, 3)
            covariance = level[-1] * np.eye(z.size) + (flat * level[:-1]) @ flat.conj().T
            fit = np.vdot(z.ravel(), np.linalg.solve(covariance, z.ravel())).real
            total -= fit + np.linalg.slogdet(covariance)[1]
        return total

    way = 1e-6 * np.eye(size)[entry]
    expected = (density(way) - density(-way)) / 2e-6
    score, _, _ = _slopes(known, wave, level)
    assert score[entry] == pytest.approx(expected, rel=1e-4, abs=1e-3)


def _bent_as_is(wave, at):
    """Without the norm that a waveform's pulse is scaled to."""
    bent = _bent(wave, at)
    part = at[8:].reshape(2, -1)
    object.__setattr__(bent, "pulse", wave.pulse * np.exp(part[0] + 1j * part[1]))
    return bent


@pytest.mark.slow
def test_a_recording_of_a_known_way_tells_its_radio():
    from dataclasses import replace

    from scene_samples import shortened

    import gridslam as gs

    scene = shortened(gs.Scene.load("screen"), 25)
    recording = gs.simulate(scene, "agent1", 1, what="signal")
    wave = recording.waveform
    error = np.zeros((4, 2))
    error[1, 0] = 0.05 * wave.wavelength_m  # what is assumed is wrong, the signals are not
    off_centre = replace(recording, waveform=replace(wave, agent_element_m=wave.agent_element_m - error))
    found = gs.calibrate(scene, off_centre)
    off = (found.element_error_m - found.element_error_m.mean(0)) - (error - error.mean(0))
    assert np.abs(off).max() < 0.02 * wave.wavelength_m
    with pytest.raises(gs.InputError, match="true track"):
        gs.calibrate(scene, replace(off_centre, truth=None))
