"""Scatterers and dense tails: lengths, amplitudes and shadows by hand, power by its mean."""

import numpy as np
import pytest
from signal_samples import sampled_scene

import gridslam as gs
from gridslam.errors import InputError
from gridslam.evaluation.bounds import known_map_bound
from gridslam.simulation.image_source import true_paths
from gridslam.simulation.scattering import dense_tail


def scattering(points, walls=(), radio=None, steps=1):
    base = sampled_scene(walls, radio, steps=steps)
    whole = base.model_dump(exclude_none=True)
    return gs.Scene.checked({**whole, "scatterers": points}, "scattering")


def test_a_scatterer_adds_a_path_with_length_angles_and_amplitude_by_hand():
    """Anchor (0, 0) facing 90 degrees, agent (3, 4) facing 30: over (3, 0), 3 m and 4 m."""
    scene = scattering([{"position_m": [3.0, 0.0], "size_m": 0.6}], radio={"snr_at_1m_db": 40.0})
    paths = true_paths(scene, "me")
    assert paths.bounces.tolist() == [0, 1]
    assert paths.of_walls.tolist() == [True, False]
    assert paths.distance_m[1] == pytest.approx(7.0)
    assert paths.aod_rad[1] == pytest.approx(-np.pi / 2)
    assert paths.aoa_rad[1] == pytest.approx(np.radians(-120))
    assert paths.amplitude[1] == pytest.approx(100 * 0.6 / 12)
    np.testing.assert_allclose(paths.points[1, :2], [[0, 0], [3, 0]])
    assert paths.segment[1].tolist() == [-1, -1]


@pytest.mark.parametrize(("wall", "seen"), [({}, False), ({"blocks": "sight"}, True)])
def test_walls_hide_scatterers_but_screens_of_sights_do_not(wall, seen):
    screen = {"reflects": False, "points_m": [[1.0, -1.0], [1.0, 1.0]], **wall}
    paths = true_paths(scattering([{"position_m": [3.0, 0.0], "size_m": 0.6}], [screen]), "me")
    assert (paths.bounces == 1).any() == seen


def test_samples_and_measurements_hold_the_scatterer():
    scene = scattering([{"position_m": [3.0, 0.0], "size_m": 3.0}], radio={"snr_at_1m_db": 60.0})
    measurements, plain = (
        gs.simulate(s, "me", 3, what="signal").samples[0] for s in (scene, sampled_scene())
    )
    wave = scene.waveform("me")
    matched = [abs(np.vdot(wave.delay_response(d), measurements[0, 0, 0])) for d in (5.0, 7.0, 12.0)]
    assert matched[0] == pytest.approx(200, rel=0.1)
    assert matched[1] == pytest.approx(250, rel=0.1)
    assert matched[2] < 50
    assert plain.shape == measurements.shape
    found = gs.simulate(scene, "me", 3)
    assert np.abs(found.distance_m - 7.0).min() < 0.05
    # what goes over no wall has no place in a bound
    assert known_map_bound(scene, "me").position_m == pytest.approx(
        known_map_bound(scattering([], radio={"snr_at_1m_db": 60.0}), "me").position_m
    )


def test_the_dense_tail_has_its_share_of_power_and_begins_with_the_sight():
    dense = {"power_db": -10.0, "decay_m": 2.0}
    scene = scattering([], radio={"snr_at_1m_db": 40.0, "dense": dense})
    wave, place, draw = scene.waveform("me"), np.array([3.0, 4.0]), np.random.default_rng(0)
    tails = np.array([dense_tail(scene, "me", place, wave, draw)[0, 0, 0] for _ in range(400)])
    # 100^2 / 5^2 = 400, of which a tenth
    assert np.mean((np.abs(tails) ** 2).sum(-1)) == pytest.approx(40, rel=0.1)
    level = [np.mean(np.abs(tails @ wave.delay_response(d).conj()) ** 2) for d in (2.0, 5.7, 9.0)]
    assert level[1] > 3 * level[2] > 3 * level[0]
    assert not dense_tail(sampled_scene(), "me", place, wave, draw).any()


@pytest.mark.parametrize(
    ("point", "field"),
    [
        ({"position_m": [3.0, 0.0]}, r"scatterers\[0\].size_m"),
        ({"position_m": [3.0, 0.0], "size_m": 0.0}, r"scatterers\[0\].size_m"),
        ({"position_m": [0.05, 0.0], "size_m": 1.0}, r"anchors\[0\].position_m"),
        ({"position_m": [3.0, 4.01], "size_m": 1.0}, r"agents\[0\].start_m"),
        ({"position_m": [3.0, 0.0], "size_m": 1.0, "colour": 1}, "unknown key"),
    ],
)
def test_bad_scatterers_are_named(point, field):
    with pytest.raises(InputError, match=field):
        scattering([point])


def test_a_dense_tail_needs_samples():
    with pytest.raises(InputError, match="dense"):
        gs.Scene.checked(
            {"grid": {"x_m": [0.0, 9.0], "y_m": [0.0, 9.0]},
             "anchors": [{"name": "A", "position_m": [1.0, 1.0]}],
             "radio": {"dense": {"power_db": -10.0, "decay_m": 1.0}}},
            "plain",
        )  # fmt: skip
