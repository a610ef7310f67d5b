"""Samples of what Sionna RT traced: every path as its direction in space has it, and no power lost."""

from types import SimpleNamespace

import numpy as np
import pytest

import gridslam as gs
from gridslam.errors import InputError
from gridslam.importers.sionna_samples import CHUNK
from gridslam.world.radio import SPEED_OF_LIGHT

SCREEN = gs.Scene.load("screen")
WAVELENGTH = SPEED_OF_LIGHT / SCREEN.radio.carrier_hz
HEADING = np.array([0.3, -1.2])


def traced(paths, seed=0, steps=2, anchors=1, antennas=1, flat=False):
    """Random paths as Sionna RT gives them, the last two of them padding."""
    draw = np.random.default_rng(seed)
    shape = steps, anchors, paths + 2
    around = {name: draw.uniform(-np.pi, np.pi, shape) for name in ("phi_t", "phi_r")}
    up = {name: np.full(shape, np.pi / 2) + (not flat) * draw.normal(0, 0.5, shape)
          for name in ("theta_t", "theta_r")}  # fmt: skip
    tau = draw.uniform(3, 25, shape) / SPEED_OF_LIGHT
    tau[..., paths:] = -1
    gain = (draw.normal(size=shape) + 1j * draw.normal(size=shape)) * 1e-4
    whole = np.broadcast_to(gain[:, None, :, None], (steps, antennas, anchors, antennas, paths + 2))
    return SimpleNamespace(a=(whole.real, whole.imag), tau=tau, valid=tau > 0, **around, **up)


def silent(paths):
    """The same without any power: what is left is noise."""
    return SimpleNamespace(**(vars(paths) | {"a": (0 * paths.a[0], 0 * paths.a[1])}))


def of_paths(paths, scene=SCREEN, **more):
    """What the paths add to the noise, (K, B, M)."""
    whole, noise = (gs.recording_from_sionna(one, scene, HEADING, **more) for one in (paths, silent(paths)))
    return (whole.samples - noise.samples)[:, 0, 0]


def test_samples_are_the_sum_of_all_paths_in_space():
    paths, wave = traced(5), SCREEN.waveform("agent1")
    frequency = SCREEN.radio.carrier_hz + wave.offset_hz
    expected = np.zeros((2, *wave.shape[2:]), complex)
    for k in range(2):
        c, s = np.cos(HEADING[k]), np.sin(HEADING[k])
        for n in range(5):
            phi, theta = paths.phi_r[k, 0, n], paths.theta_r[k, 0, n]
            towards = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
            for b, (x, y) in enumerate(wave.agent_element_m):
                nearer = np.array([c * x - s * y, s * x + c * y, 0.0]) @ towards
                coefficient = paths.a[0][k, 0, 0, 0, n] + 1j * paths.a[1][k, 0, 0, 0, n]
                turn = np.exp(-2j * np.pi * frequency * paths.tau[k, 0, n])
                expected[k, b] += coefficient * np.exp(2j * np.pi * nearer / WAVELENGTH) * turn * wave.pulse
    expected *= 10 ** (42 / 20) * 4 * np.pi / WAVELENGTH / np.sqrt(len(wave.agent_element_m))
    np.testing.assert_allclose(of_paths(paths), expected, atol=2e-5 * np.abs(expected).max())


def test_the_power_of_thousands_of_scattered_paths_is_all_there():
    paths = traced(2 * CHUNK + 7, seed=1)
    power = (paths.a[0] ** 2 + paths.a[1] ** 2)[:, 0, 0, 0, :-2].sum(1)
    level = 10 ** (42 / 10) * (4 * np.pi / WAVELENGTH) ** 2
    received = (np.abs(of_paths(paths)) ** 2).sum((1, 2))
    # a sum of random phases over some 25 m of 500 MHz: some forty shares, each exponential
    np.testing.assert_allclose(received.sum(), level * power.sum(), rtol=0.35)


def test_a_recording_says_what_was_measured_and_parts_join():
    paths, draw = traced(3, flat=True), np.arange(2)
    first, second = (
        SimpleNamespace(
            a=tuple(part[[k]] for part in paths.a),
            **{name: value[[k]] for name, value in vars(paths).items() if name != "a"},
        )
        for k in draw
    )
    whole = gs.recording_from_sionna(paths, SCREEN, HEADING, seed=3)
    joined = gs.recording_from_sionna([first, second], SCREEN, HEADING, seed=3)
    np.testing.assert_array_equal(whole.samples, joined.samples)
    np.testing.assert_allclose(whole.heading_rad, HEADING)
    np.testing.assert_allclose(np.diff(whole.time_s), 0.1)
    assert whole.anchors == ("A",)
    noise = gs.recording_from_sionna(silent(traced(3, steps=60)), SCREEN, 0.0).samples
    assert (np.abs(noise) ** 2).mean() == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize(
    ("paths", "heading", "more", "said"),
    [
        (traced(3, antennas=2), HEADING, {}, "one at either end"),
        (traced(3, anchors=2), HEADING, {}, "1, as the scene has anchors"),
        (traced(3), HEADING[:1], {}, "one for each of 2"),
        (traced(3), np.nan, {}, "finite"),
        (traced(3), HEADING, {"truth": SCREEN.track("agent1")}, "2, as there are receivers"),
        (traced(3), HEADING, {"agent": "nobody"}, "agent1"),
        (SimpleNamespace(), HEADING, {}, "Sionna RT"),
        ([], HEADING, {}, "one Paths object or more"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(paths, heading, more, said):
    with pytest.raises(InputError, match=said):
        gs.recording_from_sionna(paths, SCREEN, heading, **more)
