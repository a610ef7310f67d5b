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


def changed(**values):
    """Three random paths, of which one at the first step has other values."""
    paths = traced(3)
    for name, value in values.items():
        getattr(paths, name)[0, 0, 1] = value
    return paths


def silent(paths):
    """The same without any power: what is left is noise."""
    return SimpleNamespace(**(vars(paths) | {"a": (0 * paths.a[0], 0 * paths.a[1])}))


def of_paths(paths, scene=SCREEN, **more):
    """What the paths add to the noise, (K, A, B, M)."""
    whole, noise = (gs.recording_from_sionna(one, scene, HEADING, **more) for one in (paths, silent(paths)))
    return (whole.samples - noise.samples)[:, 0]


def turned_array():
    """The scene with four elements at its anchor, which is turned."""
    tables = SCREEN.model_dump(exclude_none=True)
    tables["radio"]["array"] = {"rows": 2, "columns": 2, "spacing_wavelengths": 0.4}
    tables["anchors"][0]["orientation_deg"] = 35.0
    return gs.Scene.checked(tables, "turned")


def nearer(element, facing, phi, theta):
    """How much nearer to a direction in space an element is than its array's middle, m."""
    c, s = np.cos(facing), np.sin(facing)
    towards = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    return np.array([c * element[0] - s * element[1], s * element[0] + c * element[1], 0.0]) @ towards


@pytest.mark.parametrize("scene", [SCREEN, turned_array()], ids=["one", "turned"])
def test_samples_are_the_sum_of_all_paths_in_space(scene):
    paths, wave = traced(5), scene.waveform("agent1")
    frequency = scene.radio.carrier_hz + wave.offset_hz
    facing = scene.anchor_orientations[0]
    expected = np.zeros((2, *wave.shape[1:]), complex)
    for k, a, b, n in np.ndindex(*expected.shape[:3], 5):
        way = nearer(wave.anchor_element_m[0, a], facing, paths.phi_t[k, 0, n], paths.theta_t[k, 0, n])
        way += nearer(wave.agent_element_m[b], HEADING[k], paths.phi_r[k, 0, n], paths.theta_r[k, 0, n])
        coefficient = paths.a[0][k, 0, 0, 0, n] + 1j * paths.a[1][k, 0, 0, 0, n]
        turn = np.exp(-2j * np.pi * frequency * paths.tau[k, 0, n])
        expected[k, a, b] += coefficient * np.exp(2j * np.pi * way / WAVELENGTH) * turn * wave.pulse
    expected *= 10 ** (42 / 20) * 4 * np.pi / WAVELENGTH / np.sqrt(expected.shape[1] * expected.shape[2])
    np.testing.assert_allclose(of_paths(paths, scene), expected, atol=2e-5 * np.abs(expected).max())


@pytest.mark.slow
def test_the_power_of_thousands_of_scattered_paths_is_all_there():
    paths = traced(2 * CHUNK + 7, seed=1)
    power = (paths.a[0] ** 2 + paths.a[1] ** 2)[:, 0, 0, 0, :-2].sum(1)
    level = 10 ** (42 / 10) * (4 * np.pi / WAVELENGTH) ** 2
    received = (np.abs(of_paths(paths)) ** 2).sum((1, 2, 3))
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
    ("paths", "heading", "more", "why"),
    [
        (traced(3, antennas=2), HEADING, {}, "one at either end"),
        (traced(3, anchors=2), HEADING, {}, "1, as the scene has anchors"),
        (traced(3), HEADING[:1], {}, "one for each of 2"),
        (traced(3), np.nan, {}, "finite"),
        (traced(3), HEADING, {"truth": SCREEN.track("agent1")}, "2, as there are receivers"),
        (traced(3), "abc", {}, "heading_rad: found 'abc'; allowed: one finite number"),
        (traced(3), HEADING, {"truth": 3}, "truth: found int; allowed: a Trajectory"),
        (traced(3), HEADING, {"truth": [1, 2]}, "truth: found list; allowed: a Trajectory"),
        (traced(3), HEADING, {"agent": "nobody"}, "agent1"),
        (SimpleNamespace(**vars(traced(3)) | {"tau": "abc"}), HEADING, {}, "paths: tau: found no numbers"),
        (SimpleNamespace(**vars(traced(3)) | {"a": ("b", "c")}), HEADING, {}, "paths: a: found no numbers"),
        (SimpleNamespace(), HEADING, {}, "Sionna RT"),
        ([], HEADING, {}, "one Paths object or more"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(paths, heading, more, why):
    with pytest.raises(InputError, match=why):
        gs.recording_from_sionna(paths, SCREEN, heading, **more)


@pytest.mark.parametrize("importer", [gs.recording_from_sionna, gs.from_sionna])
@pytest.mark.parametrize(
    ("tau", "found"),
    [(np.nan, "nan"), (np.inf, "inf"), (-1e-9, "-1e-09"), (40.0, "40"), (2e-4, "0.0002")],
)
def test_delays_that_cannot_be_in_seconds_are_refused(importer, tau, found):
    with pytest.raises(
        InputError, match=f"paths: tau: found {found}.* of a valid path; allowed: seconds, 0 to"
    ):
        importer(changed(tau=tau), SCREEN, HEADING)
    importer(changed(tau=tau, valid=False), SCREEN, HEADING)  # padding may hold anything
    importer(changed(tau=20_000 / SPEED_OF_LIGHT), SCREEN, HEADING)


@pytest.mark.parametrize("importer", [gs.recording_from_sionna, gs.from_sionna])
@pytest.mark.parametrize("name", ["a", "phi_t", "theta_r"])
def test_valid_paths_without_gain_or_angle_are_refused_and_counted(importer, name):
    paths = traced(3)
    values = paths.a[0].copy() if name == "a" else getattr(paths, name)
    values[0, ..., 1] = np.nan
    whole = SimpleNamespace(**(vars(paths) | {name: (values, paths.a[1]) if name == "a" else values}))
    with pytest.raises(InputError, match=f"paths: {name}: found 1 of 6 valid paths without a finite number"):
        importer(whole, SCREEN, HEADING)
    whole.valid[0, 0, 1] = False
    importer(whole, SCREEN, HEADING)


@pytest.mark.parametrize("importer", [gs.recording_from_sionna, gs.from_sionna])
@pytest.mark.parametrize("scene", ["screen", None])
def test_what_is_no_scene_is_refused(importer, scene):
    with pytest.raises(InputError, match=f"scene: found {type(scene).__name__}; allowed: a Scene"):
        importer(traced(3), scene, HEADING)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"heading_rad": "abc"}, "heading_rad: found 'abc'; allowed: one finite number"),
        ({"heading_rad": [[0.1]]}, r"heading_rad: found shape \(1, 1\)"),
        ({"least_snr_db": "x"}, "least_snr_db: found 'x'; allowed: a number from -inf to 1000, or None"),
        ({"least_snr_db": 1e6}, "least_snr_db: found 1000000.0"),
        ({"slope_deg": np.nan}, "slope_deg: found nan"),
        ({"carrier_hz": 0}, "carrier_hz: found 0; allowed: a number from 1 to"),
    ],
)
def test_numbers_that_a_table_of_paths_needs_are_checked(more, why):
    with pytest.raises(InputError, match=why):
        gs.from_sionna(traced(3), SCREEN, **{"heading_rad": HEADING} | more)
    assert len(gs.from_sionna(traced(3, flat=True), SCREEN, HEADING, least_snr_db=-np.inf)) == 2
