"""Several agents out of one source: each gets its own paths, and these are the geometry's."""

from types import SimpleNamespace

import numpy as np
import pytest
from scene_samples import short
from tables import same

import gridslam as gs
from gridslam.errors import InputError
from gridslam.measurements.network import NetworkMeasurements
from gridslam.measurements.table import Measurements
from gridslam.simulation.image_source import true_paths
from gridslam.simulation.network import receive_network
from gridslam.world.geometry import wrap
from gridslam.world.radio import SPEED_OF_LIGHT

STEPS, NAMES = 4, ("agent1", "agent3")


@pytest.fixture(scope="module")
def scene():
    return short("exchange", STEPS)


@pytest.fixture(scope="module")
def exact(scene):
    """What both agents' paths are, as measured without noise and with clocks that are right."""
    parts = {}
    for name in NAMES:
        paths, track = true_paths(scene, name), scene.track(name)
        columns = ("step", "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
        table = {key: getattr(paths, key) for key in columns}
        parts[name] = Measurements(
            anchors=scene.anchor_names, time_s=track.time_s[paths.step], steps=STEPS, truth=track, **table
        )
    return NetworkMeasurements.of_agents(parts)


def places(scene, exact):
    """Arrays (places, anchors, paths) of a ray tracer, the agents' places in turn: step by step."""
    table = exact.table
    place = len(NAMES) * table.step + exact.agent
    shape = (len(NAMES) * STEPS, len(scene.anchors))
    number = np.zeros(len(place), int)
    seen = np.zeros(shape, int)
    for row, (at, anchor) in enumerate(zip(place, table.anchor, strict=True)):
        number[row] = seen[at, anchor]
        seen[at, anchor] += 1
    heading = np.stack([scene.track(name).heading_rad for name in NAMES], 1).ravel()[place]
    wavelength = SPEED_OF_LIGHT / scene.radio.carrier_hz
    gain = table.amplitude / scene.signal_model().amplitude_at_1m * wavelength / (4 * np.pi)
    values = {
        "tau": table.distance_m / SPEED_OF_LIGHT,
        "phi_t": wrap(table.aod_rad + scene.anchor_orientations[table.anchor]),
        "phi_r": wrap(table.aoa_rad + heading),
        "gain": gain,
    }
    whole = {name: np.full((*shape, seen.max() + 1), np.nan) for name in values}
    for name, column in values.items():
        whole[name][place, table.anchor, number] = column
    return whole


def sionna(whole):
    valid = np.isfinite(whole["tau"])
    gain = np.nan_to_num(whole["gain"])[:, None, :, None]
    flat = np.full(valid.shape, np.pi / 2)
    return SimpleNamespace(
        a=(gain, np.zeros_like(gain)), tau=np.where(valid, whole["tau"], -1.0), valid=valid,
        phi_t=np.nan_to_num(whole["phi_t"]), phi_r=np.nan_to_num(whole["phi_r"]), theta_t=flat, theta_r=flat,
    )  # fmt: skip


def deepmimo(whole):
    names = {"aod_az": "phi_t", "aoa_az": "phi_r"}
    return [
        {new: np.degrees(whole[old][:, anchor]) for new, old in names.items()}
        | {"delay": whole["tau"][:, anchor], "power": 20 * np.log10(whole["gain"][:, anchor])}
        for anchor in range(whole["tau"].shape[1])
    ]


def close(one, other):
    assert one.agents == other.agents
    for name in one.agents:
        left, right = (part[name] for part in (one, other))
        order = [np.lexsort((part.distance_m, part.anchor, part.step)) for part in (left, right)]
        for key in ("step", "anchor", "time_s", "distance_m", "aod_rad", "aoa_rad", "amplitude"):
            np.testing.assert_allclose(getattr(left, key)[order[0]], getattr(right, key)[order[1]], rtol=1e-6)


def arguments(scene):
    whose = {name: np.arange(STEPS) * len(NAMES) + k for k, name in enumerate(NAMES)}
    tracks = {name: scene.track(name) for name in NAMES}
    heading = {name: tracks[name].heading_rad for name in NAMES}
    return heading, whose, {"truth": tracks, "least_snr_db": -100.0}


def test_sources_of_several_agents_give_each_its_own_paths(scene, exact):
    heading, whose, more = arguments(scene)
    whole = places(scene, exact)
    traced = gs.network_from_sionna(sionna(whole), scene, heading, whose, **more)
    close(traced, exact)
    assert traced.tracks == exact.tracks
    arrays = gs.network_from_deepmimo(deepmimo(whole), scene, heading, whose, **more)
    close(arrays, exact)
    backwards = {name: rows[::-1] for name, rows in whose.items()}
    turned = {name: rows[::-1] for name, rows in heading.items()}
    again = gs.network_from_sionna(sionna(whole), scene, turned, backwards, least_snr_db=-100.0)
    last = again.table.step == STEPS - 1
    first = exact.table.step == 0
    assert set(again.table.distance_m[last].round(6)) == set(exact.table.distance_m[first].round(6))


def test_agents_of_a_source_that_do_not_fit_are_named(scene, exact):
    heading, whose, more = arguments(scene)
    paths = sionna(places(scene, exact))
    cases = [
        ({"heading_rad": 3.0}, "heading_rad: found float; allowed: a dictionary"),
        ({"receivers": [0, 1]}, "receivers: found list; allowed: a dictionary"),
        ({"heading_rad": {"agent1": 0.0}}, "heading_rad: found none of 'agent3'"),
        ({"heading_rad": heading | {"he": 0.0}}, "heading_rad: agent: found 'he'; allowed: agent1, agent3"),
        ({"receivers": {"he": [0]}, "heading_rad": {"he": 0.0}, "truth": {}}, "'he'"),
        ({"receivers": whose | {"agent3": [99]}}, "steps of 'agent3': .*whole numbers from 0 to 7"),
        ({"receivers": {}, "heading_rad": {}, "truth": {}}, "agents: found none"),
    ]
    for change, says in cases:
        asked = {"heading_rad": heading, "receivers": whose, **more} | change
        with pytest.raises(InputError, match=says) as caught:
            gs.network_from_sionna(paths, scene, **asked)
        assert "\n" not in str(caught.value)


def test_agents_with_other_anchors_or_times_are_not_put_together(exact):
    one, other = (exact[name] for name in NAMES)
    rows = {key: getattr(other, key) for key in other.columns}
    moved = Measurements(anchors=one.anchors, steps=STEPS, **rows | {"time_s": other.time_s + 0.1})
    named = Measurements(anchors=("A", "B", "C", "Z"), steps=STEPS, **rows)
    with pytest.raises(InputError, match=r"time_s.*one time for all rows"):
        NetworkMeasurements.of_agents({"a": one, "b": moved})
    with pytest.raises(InputError, match="anchors of 'b': found A, B, C, Z; allowed: A, B, C, D, as of 'a'"):
        NetworkMeasurements.of_agents({"a": one, "b": named})


@pytest.mark.parametrize("unlabelled", [False, True])
def test_receiving_exact_paths_of_several_agents_is_the_simulator(scene, exact, unlabelled):
    measurements = receive_network(exact, scene, 7, unlabelled)
    simulated = gs.simulate(scene, NAMES, 7, unlabelled)
    same(measurements.table, simulated.table)
    np.testing.assert_array_equal(measurements.agent, simulated.agent)
    np.testing.assert_array_equal(measurements.clocks.offset_s, simulated.clocks.offset_s)
    assert (measurements.table.distance_m < 0).any()
    with pytest.raises(InputError, match="anchor: found rows without it"):
        receive_network(exact.without_labels(), scene)
