"""Simulated samples: phases by hand, amplitudes by the SNR, angles found by plain beams."""

import numpy as np
import pytest
from signal_samples import C, sampled_scene

import gridslam as gs
from gridslam.errors import InputError
from gridslam.simulation.image_source import true_paths
from gridslam.world.scene_files import bundled_scenes
from gridslam.world.waveform import Waveform

ARRAY = {"rows": 2, "columns": 2, "spacing_wavelengths": 0.25}


def test_phase_turns_backwards_over_frequency_and_ahead_at_the_nearer_element():
    offsets = 1e7 * (np.arange(10) - 4.5)
    element = np.array([[0.0, 0.0], [0.0, 0.0125]])
    wave = Waveform(5.9958491e9, offsets, np.ones(10), element[None], element)
    # 10 MHz and 7.494811 m: 1e7 x 7.494811 / 299792458 = 0.25 turns, backwards
    delay = wave.delay_response(7.494811)
    assert np.angle(delay[1:] / delay[:-1]) == pytest.approx(np.full(9, -np.pi / 2), abs=1e-6)
    assert np.linalg.norm(delay) == pytest.approx(1)
    # lambda = 5 cm: 1.25 cm nearer to a wave from the left is a quarter turn ahead, from the right behind
    for angle, ahead in ((np.pi / 2, np.pi / 2), (-np.pi / 2, -np.pi / 2), (0.0, 0.0)):
        response = wave.agent_response(angle)
        assert np.angle(response[1] / response[0]) == pytest.approx(ahead, abs=1e-6)
        assert np.linalg.norm(response) == pytest.approx(1)


def test_folding_and_bandwidth_by_hand():
    wave = sampled_scene().waveform("me")
    assert wave.folding_m == pytest.approx(29.9792458)
    assert wave.bandwidth_hz == pytest.approx(4e8)
    here, there = wave.delay_response(3.0), wave.delay_response(32.9792458)
    assert abs(np.vdot(here, there)) == pytest.approx(1), "what lies beyond folds back"


@pytest.mark.slow
def test_snr_of_the_line_of_sight_is_that_of_the_radio_over_all_samples():
    """30 dB at 1 m and 5 m away: u^2 = 1000 / 25 = 40, whatever antennas and frequencies share it."""
    for array in (ARRAY, {"rows": 1, "columns": 1}):
        scene = sampled_scene(radio={"snr_at_1m_db": 30.0, "array": array}, steps=1)
        wave, track = scene.waveform("me"), scene.track("me")
        paths = true_paths(scene, "me")
        response = np.einsum(
            "a,b,m->abm", wave.anchor_response(0, paths.aod_rad[0]), wave.agent_response(paths.aoa_rad[0]),
            wave.delay_response(5.0),
        )  # fmt: skip
        assert np.linalg.norm(track.position_m[0]) == pytest.approx(5.0)
        samples = [gs.simulate(scene, "me", seed, what="signal").samples[0, 0] for seed in range(200)]
        matched = np.array([np.vdot(response, z) for z in samples])
        assert np.mean(np.abs(matched) ** 2) == pytest.approx(40 + 1, rel=0.1), "and noise of variance 1"
        rest = [z - m * response for z, m in zip(samples, matched, strict=True)]
        assert np.mean(np.abs(rest) ** 2) == pytest.approx(1 - 1 / rest[0].size, rel=0.05)


@pytest.mark.slow
def test_steady_amplitudes_keep_their_modulus_and_swerling_ones_fade():
    for fading, spread in (("steady", 0.0), ("swerling1", 1.0)):
        scene = sampled_scene(radio={"snr_at_1m_db": 80.0, "fading": fading}, steps=1)
        wave = scene.waveform("me")
        response = wave.delay_response(5.0)
        samples = [gs.simulate(scene, "me", seed, what="signal").samples[0, 0, 0, 0] for seed in range(300)]
        power = np.array([np.abs(np.vdot(response, z)) ** 2 for z in samples])
        assert power.mean() == pytest.approx(1e8 / 25, rel=0.2)
        assert power.std() / power.mean() == pytest.approx(spread, abs=0.2 if spread else 0.01)


def test_delay_profile_peaks_at_the_length_and_plain_beams_find_both_angles():
    array = {"rows": 3, "columns": 3, "spacing_wavelengths": 0.4}
    scene = sampled_scene(radio={"snr_at_1m_db": 60.0, "array": array}, steps=1)
    z = gs.simulate(scene, "me", 3, what="signal").samples[0, 0].astype(complex)
    profile = np.abs(np.fft.ifft(z, 4096, axis=-1)).sum((0, 1))
    assert np.argmax(profile) * C / (4096 * 1e7) == pytest.approx(5.0, abs=0.05)
    # elements by hand: columns along x (forward), rows along y, 0.4 x 4.9965 cm apart, about the middle
    q = 0.4 * C / 6e9 * np.array([[x, y] for y in (-1, 0, 1) for x in (-1, 0, 1)])
    beams = np.radians(np.arange(-180, 180))
    look = np.exp(2j * np.pi * 6e9 / C * (np.column_stack([np.cos(beams), np.sin(beams)]) @ q.T))
    # the agent leaves the anchor at 53.13 deg, less 90; it hears it from -126.87 deg, less 30
    power = np.abs(
        np.einsum("ta,abm,m->tb", look.conj(), z, np.exp(2j * np.pi * scene.radio.offset_hz * 5 / C))
    )
    assert np.degrees(beams[np.argmax((power**2).sum(1))]) == pytest.approx(53.13 - 90, abs=1.5)
    power = np.abs(
        np.einsum("tb,abm,m->ta", look.conj(), z, np.exp(2j * np.pi * scene.radio.offset_hz * 5 / C))
    )
    assert np.degrees(beams[np.argmax((power**2).sum(1))]) == pytest.approx(-126.87 - 30, abs=1.5)


def test_pulse_has_half_its_power_at_half_its_width_and_ends_with_the_band():
    radio = {"frequencies": 81, "pulse": {"kind": "rrc", "rolloff": 0.6, "width_hz": 5e8}}
    scene = sampled_scene(radio=radio)
    power = np.abs(scene.waveform("me").pulse) ** 2
    assert power.sum() == pytest.approx(1)
    # flat up to (1 - 0.6) / 2 x 500 = 100 MHz, half at 250, nothing at (1 + 0.6) / 2 x 500 = 400 MHz
    assert power[30:51] / power[40] == pytest.approx(np.ones(21))
    assert power[[15, 65]] / power[40] == pytest.approx([0.5, 0.5])
    assert power[[0, 80]] == pytest.approx([0, 0], abs=1e-12)
    assert scene.radio.bandwidth_hz == 5e8


def test_heading_is_there_where_a_sensor_is_and_as_good_as_it():
    assert gs.simulate(sampled_scene(), "me", what="signal").heading_rad is None
    exact = gs.simulate(sampled_scene(heading_sensor_deg=0.0), "me", what="signal")
    assert exact.heading_rad == pytest.approx(np.full(3, np.pi / 6))
    assert exact.waveform.heading_std_rad == 0
    rough = [gs.simulate(sampled_scene(heading_sensor_deg=2.0), "me", s, what="signal") for s in range(60)]
    errors = np.concatenate([samples.heading_rad - np.pi / 6 for samples in rough])
    assert np.degrees(errors.std()) == pytest.approx(2.0, rel=0.25)


def test_walls_that_reflect_nothing_hide_and_give_no_path():
    mirror = {"material": "concrete", "points_m": [[-6.0, 6.0], [6.0, 6.0]]}
    screen = {"reflects": False, "points_m": [[1.0, 2.0], [2.0, 2.0]]}  # across the line of sight
    behind = {"reflects": False, "points_m": [[-6.0, -6.0], [6.0, -6.0]]}
    for walls, bounces in (([mirror], [0, 1]), ([mirror, screen], [1]), ([mirror, behind], [0, 1])):
        assert true_paths(sampled_scene(walls, steps=1), "me").bounces.tolist() == bounces
    double = [{**screen, "points_m": [[0.1, 2.0], [2.0, 2.0]]}, mirror]  # across the reflected path, too
    assert true_paths(sampled_scene(double, steps=1), "me").bounces.tolist() == []
    sight = [{**double[0], "blocks": "sight"}, mirror]
    assert true_paths(sampled_scene(sight, steps=1), "me").bounces.tolist() == [1]


def test_same_seed_same_samples_and_another_seed_others():
    scene = sampled_scene()
    one, two, other = (gs.simulate(scene, "me", seed, what="signal").samples for seed in (1, 1, 2))
    assert np.array_equal(one, two)
    assert not np.isclose(one, other).any()


@pytest.mark.parametrize(
    ("radio", "field"),
    [
        ({"frequencies": 7}, "radio.frequencies"),
        ({"frequency_step_hz": None}, "frequency_step_hz"),
        ({"bandwidth_hz": 1e9}, "radio.bandwidth_hz"),
        ({"max_distance_m": 60.0}, "radio.max_distance_m"),
        ({"samples": 40}, "radio.samples"),
        ({"pulse": {"width_hz": 5e8}}, "radio.pulse.width_hz"),
        ({"fading": "rayleigh"}, "radio.fading"),
    ],
)
def test_radio_that_contradicts_itself_is_refused(radio, field):
    with pytest.raises(InputError, match=rf"sampled: .*{field}"):
        sampled_scene(radio={k: v for k, v in radio.items()} | {})


def test_what_follows_from_frequencies_may_be_said_and_survives_writing():
    scene = sampled_scene(radio={"bandwidth_hz": 4e8, "max_distance_m": 29.9792458, "samples": 41})
    assert gs.Scene.from_toml(scene.to_toml()) == scene
    assert sampled_scene().signal_model("me").samples == 41
    assert sampled_scene(radio={"array": ARRAY}).signal_model("me").samples == 41 * 16


def test_a_scene_without_frequencies_samples_nothing_and_says_which_do():
    with pytest.raises(
        InputError, match=r"radio.frequencies: found none; allowed: frequencies and"
    ) as caught:
        gs.simulate(gs.Scene.load("room"), "agent1", what="signal")
    sampled = [name for name in bundled_scenes() if gs.Scene.load(name).radio.frequencies is not None]
    assert caught.value.allowed.endswith(f"bundled scene that does: {', '.join(sampled)}")


def test_frequencies_as_the_error_says_make_a_scene_of_paths_one_of_samples():
    room = gs.Scene.load("room").model_dump(exclude_none=True)
    follows = ("bandwidth_hz", "max_distance_m", "samples")
    radio = {key: value for key, value in room["radio"].items() if key not in follows}
    sampling = {**radio, "frequencies": 41, "frequency_step_hz": 1e7, "array": {"rows": 1, "columns": 1}}
    agent = {**room["agents"][0], "steps": 2}
    scene = gs.Scene.checked({**room, "radio": sampling, "agents": [agent]}, "sampled")
    assert gs.simulate(scene, agent["name"], what="signal").samples.shape[-1] == 41


def test_what_a_scene_samples_is_one_of_two():
    with pytest.raises(InputError, match="'paths' or 'signal'"):
        gs.simulate(gs.Scene.load("room"), "agent1", what="samples")
