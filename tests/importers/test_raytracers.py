"""Sionna RT's and DeepMIMO's paths become the measurements of the same geometry, whatever their layout."""

import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scene_samples import with_levels
from scipy.optimize import linear_sum_assignment
from tables import same

import gridslam as gs
from gridslam.errors import InputError
from gridslam.evaluation.bounds import known_map_bound
from gridslam.evaluation.metrics import diverged, rmse, track_errors
from gridslam.measurements.table import Measurements
from gridslam.runs.map_scene import map_scene
from gridslam.simulation.image_source import receive, simulate, true_paths
from gridslam.world.geometry import wrap
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene

ROOM = Scene.load("room")
TRACK = ROOM.track("agent1")
STEPS = 20
WAVELENGTH = SPEED_OF_LIGHT / ROOM.radio.carrier_hz


def exact():
    """The room's own paths, as measured without noise."""
    paths = true_paths(ROOM, "agent1")
    rows = np.flatnonzero(paths.step < STEPS)
    rows = rows[np.lexsort((paths.distance_m[rows], paths.anchor[rows], paths.step[rows]))]
    names = ("step", "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    cut = {name: getattr(paths, name)[rows] for name in names}
    return Measurements(anchors=("A", "B"), time_s=TRACK.time_s[cut["step"]], steps=STEPS, **cut)


def world(measurements):
    """Arrays (steps, anchors, paths) as a ray tracer gives them: world directions, padded with NaN."""
    counts = np.zeros((STEPS, 2), int)
    np.add.at(counts, (measurements.step, measurements.anchor), 1)
    place = np.concatenate([np.arange(n) for n in counts.ravel()])
    shape = (STEPS, 2, counts.max() + 2)
    columns = {
        "tau": measurements.distance_m / SPEED_OF_LIGHT,
        "phi_t": wrap(measurements.aod_rad + ROOM.anchor_orientations[measurements.anchor]),
        "phi_r": wrap(measurements.aoa_rad + TRACK.heading_rad[measurements.step]),
        "theta_t": np.full(len(measurements.step), np.pi / 2),
        "theta_r": np.full(len(measurements.step), np.pi / 2),
        "gain": measurements.amplitude / ROOM.signal_model().amplitude_at_1m * WAVELENGTH / (4 * np.pi),
    }
    table = {name: np.full(shape, np.nan) for name in columns}
    for name, values in columns.items():
        table[name][measurements.step, measurements.anchor, place] = values
    return table


def sionna_like(table, antennas=1):
    """Sionna RT's layout: padding has delay -1 and angle 0, and a flag; 5 dimensions unless synthetic."""
    valid = ~np.isnan(table["tau"])
    phase = np.exp(1j * np.arange(valid.size)).reshape(valid.shape)
    gain = np.where(valid, np.nan_to_num(table["gain"]) * phase, 0)
    gain = np.broadcast_to(gain[:, None, :, None], (STEPS, antennas, 2, antennas, valid.shape[2]))
    other = {name: np.nan_to_num(table[name]) for name in ("phi_t", "phi_r", "theta_t", "theta_r")}
    other |= {"tau": np.where(valid, table["tau"], -1), "valid": valid}
    if antennas > 1:
        other = {
            name: np.repeat(np.repeat(v[:, None, :, None], antennas, 1), antennas, 3)
            for name, v in other.items()
        }
    return SimpleNamespace(a=(gain.real, gain.imag), **other)


def close(one, other):
    np.testing.assert_array_equal(one.step, other.step)
    np.testing.assert_array_equal(one.anchor, other.anchor)
    for name in ("distance_m", "amplitude"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-9)
    for name in ("aod_rad", "aoa_rad"):
        np.testing.assert_allclose(wrap(getattr(one, name) - getattr(other, name)), 0, atol=1e-9)


LEAST = {"least_snr_db": -100.0}
HEADING = TRACK.heading_rad[:STEPS]


@pytest.mark.parametrize("antennas", [1, 2])
def test_sionna_paths_give_the_geometry_back(antennas):
    measurements = exact()
    close(gs.from_sionna(sionna_like(world(measurements), antennas), ROOM, HEADING, **LEAST), measurements)


def test_one_paths_object_per_step_gives_the_same():
    whole = sionna_like(world(exact()))
    parts = [
        SimpleNamespace(
            a=tuple(part[k : k + 1, ..., : 10 + k % 3] for part in whole.a),
            **{n: v[k : k + 1, :, : 10 + k % 3] for n, v in vars(whole).items() if n != "a"},
        )
        for k in range(STEPS)
    ]
    together = gs.from_sionna(parts, ROOM, HEADING, **LEAST)
    assert len(together) == STEPS
    assert (np.bincount(together.step) == [2 * (10 + k % 3) for k in range(STEPS)]).all()


def test_uplink_swaps_the_ends():
    down = sionna_like(world(exact()))
    up = SimpleNamespace(
        a=tuple(np.transpose(part, (2, 3, 0, 1, 4)) for part in down.a),
        tau=np.swapaxes(down.tau, 0, 1),
        valid=np.swapaxes(down.valid, 0, 1),
        phi_t=np.swapaxes(down.phi_r, 0, 1),
        phi_r=np.swapaxes(down.phi_t, 0, 1),
        theta_t=np.swapaxes(down.theta_r, 0, 1),
        theta_r=np.swapaxes(down.theta_t, 0, 1),
    )
    close(gs.from_sionna(up, ROOM, HEADING, uplink=True, **LEAST), exact())


def test_paths_over_floor_and_steep_paths_are_left_out_and_slopes_projected():
    table = world(exact())
    slope = np.zeros(table["tau"].shape)
    slope[:, 0] = np.radians(5)  # a higher anchor: down there, up here
    table["theta_t"], table["theta_r"] = table["theta_t"] + slope, table["theta_r"] - slope
    close(
        gs.from_sionna(sionna_like(table | {"tau": table["tau"] / np.cos(slope)}), ROOM, HEADING, **LEAST),
        exact(),
    )
    steep = gs.from_sionna(sionna_like(table), ROOM, HEADING, slope_deg=4.0, **LEAST)
    assert set(steep.anchor) == {1}
    floor = table | {"theta_r": np.pi - table["theta_r"]}  # down at both ends
    assert set(gs.from_sionna(sionna_like(floor), ROOM, HEADING, **LEAST).anchor) == {1}


def test_weak_paths_are_left_out_and_the_carrier_sets_the_gain():
    paths = sionna_like(world(exact()))
    measurements = gs.from_sionna(paths, ROOM, HEADING)
    assert measurements.amplitude.min() > ROOM.signal_model().threshold
    assert len(measurements.step) == (exact().amplitude > ROOM.signal_model().threshold).sum()
    double = gs.from_sionna(paths, ROOM, HEADING, carrier_hz=2 * ROOM.radio.carrier_hz, **LEAST)
    np.testing.assert_allclose(double.amplitude, 2 * exact().amplitude, rtol=1e-9)


@pytest.mark.parametrize("users", [None, np.arange(STEPS)[::-1]])
def test_deepmimo_arrays_give_the_geometry_back(users):
    rows = slice(None) if users is None else users
    sets = [{name: values[rows] for name, values in one.items()} for one in deepmimo()]
    close(gs.from_deepmimo(sets, ROOM, HEADING, users=users, **LEAST), exact())
    flat = [{k: v for k, v in s.items() if not k.endswith("_el")} for s in sets]
    close(gs.from_deepmimo(flat, ROOM, HEADING, users=users, **LEAST), exact())


def deepmimo():
    """The room's paths as DeepMIMO has them, one dictionary per anchor."""
    table = world(exact())
    names = {"aod_az": "phi_t", "aoa_az": "phi_r", "aod_el": "theta_t", "aoa_el": "theta_r"}
    return [
        {new: np.degrees(table[old][:, anchor]) for new, old in names.items()}
        | {"delay": table["tau"][:, anchor], "power": 20 * np.log10(table["gain"][:, anchor])}
        for anchor in range(2)
    ]


@pytest.mark.parametrize(
    ("names", "change", "told"),
    [
        (["delay"], lambda x: 1e9 * x, r"delay: found [\d.]+ in the median; allowed: seconds"),
        (["delay"], lambda x: 1e6 * x, r"delay: found [\d.]+ in the median; allowed: seconds"),
        (["aod_az", "aoa_az"], np.radians, "aod_az, aoa_az: found none beyond .*; allowed: degrees"),
        (["aod_el", "aoa_el"], np.radians, "aod_el, aoa_el: found none beyond .*; allowed: degrees"),
    ],
)
def test_deepmimo_arrays_of_other_units_are_refused(names, change, told):
    """They were mapped, metres off."""
    sets = [one | {name: change(one[name]) for name in names} for one in deepmimo()]
    with pytest.raises(InputError, match=told):
        gs.from_deepmimo(sets, ROOM, HEADING, **LEAST)


def test_what_is_missing_of_deepmimo_is_told_without_what_may_be():
    first, second = deepmimo()
    del second["power"]
    with pytest.raises(InputError) as told:
        gs.from_deepmimo([first, second], ROOM, HEADING)
    allowed = "all of delay, aod_az, aoa_az, power (aod_el and aoa_el may be left out)"
    assert f"datasets[1].power: found none; allowed: {allowed}" in str(told.value)


def test_deepmimo_paths_over_floor_and_ceiling_are_kept_where_the_scene_has_them():
    bare = Scene.load("ceiling")
    scene, track = with_levels(bare), bare.track("agent1")
    paths = true_paths(scene, "agent1")
    paths = paths.take(paths.step < 3)
    ways = scene.verticals("agent1")
    way = np.searchsorted(ways.over, paths.over)
    rise = np.arccos(-ways.height[way, paths.anchor] / paths.distance_m)  # of the anchor's image, from above
    up = np.where(paths.over > 0, np.pi - rise, rise)
    at_1m = scene.signal_model().amplitude_at_1m
    columns = {
        "delay": paths.distance_m / SPEED_OF_LIGHT,
        "aod_az": np.degrees(paths.aod_rad + scene.anchor_orientations[paths.anchor]),
        "aoa_az": np.degrees(paths.aoa_rad + track.heading_rad[paths.step]),
        "aod_el": np.degrees(up),
        "aoa_el": np.degrees(np.pi - rise),
        "power": 20 * np.log10(paths.amplitude / at_1m * WAVELENGTH / 4 / np.pi),
    }
    sets = []
    for anchor in range(len(scene.anchors)):
        place = np.zeros(len(paths), int)
        for step in range(3):
            rows = np.flatnonzero((paths.step == step) & (paths.anchor == anchor))
            place[rows] = np.arange(len(rows))
        own = paths.anchor == anchor
        sets.append({name: np.full((3, place.max() + 2), np.nan) for name in columns})
        for name, values in columns.items():
            sets[-1][name][paths.step[own], place[own]] = values[own]
    for world, kept in ((scene, paths), (bare, paths.take(paths.over == 0))):
        found = gs.from_deepmimo(sets, world, track.heading_rad[:3], **LEAST)
        order = np.lexsort((kept.distance_m, kept.anchor, kept.step))
        heard = np.lexsort((found.distance_m, found.anchor, found.step))
        for name in ("step", "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude"):
            np.testing.assert_allclose(
                getattr(found, name)[heard], getattr(kept, name)[order], rtol=1e-9, atol=1e-9, err_msg=name
            )
    assert {int(over) for over in paths.over} == {0, 1, 2}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "where"),
    [
        (lambda p: p.__delattr__("phi_r"), "paths: phi_r"),
        (lambda p: setattr(p, "tau", p.tau[0]), "paths: tau"),
        (lambda p: setattr(p, "theta_t", p.theta_t[:, :, :3]), "paths: theta_t"),
        (lambda p: setattr(p, "a", p.a[0][0]), "paths: a"),
        (lambda p: setattr(p, "a", None), "paths: a"),
        (lambda p: setattr(p, "a", tuple(part[:3] for part in p.a)), "paths: a"),
    ],
)
def test_strange_paths_objects_are_refused(change, where):
    paths = sionna_like(world(exact()))
    change(paths)
    with pytest.raises(InputError) as caught:
        gs.from_sionna(paths, ROOM, HEADING)
    assert caught.value.where == where


def test_devices_that_do_not_match_are_refused():
    paths = sionna_like(world(exact()))
    with pytest.raises(InputError, match="heading_rad"):
        gs.from_sionna(paths, ROOM, HEADING[:-1])
    with pytest.raises(InputError, match="transmitters"):
        gs.from_sionna(paths, Scene.load("canyon"), 0.0, uplink=True)
    for sets, where in (([], "datasets"), ({}, "datasets"), ([{}], r"datasets\[0\].delay")):
        with pytest.raises(InputError, match=where):
            gs.from_deepmimo(sets, ROOM, 0.0)


def test_receiving_exact_paths_is_the_simulator():
    paths = true_paths(ROOM, "agent1")
    names = ("step", "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    columns = {name: getattr(paths, name) for name in names}
    clean = Measurements(anchors=("A", "B"), time_s=TRACK.time_s[paths.step], steps=len(TRACK), **columns)
    same(receive(clean, ROOM, "agent1", 7), simulate(ROOM, "agent1", 7))
    with pytest.raises(InputError, match="aoa_rad"):
        receive(replace(clean, aoa_rad=np.where(paths.step == 3, np.nan, paths.aoa_rad)), ROOM, "agent1")


# ---- the real package


@pytest.fixture(scope="module")
def traced(tmp_path_factory):
    """Runs the real ray tracer on a scene, every `step`-th place of its agent."""
    if find_spec("sionna") is None:
        pytest.skip("Sionna RT isn't installed")

    def run(scene, step, building="plane"):
        file = tmp_path_factory.mktemp("sionna") / "paths.npz"
        script = Path(__file__).parents[1] / "helpers" / "sionna_world.py"
        done = subprocess.run(
            [sys.executable, str(script), scene, str(step), str(file), building],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode < 0 or "LLVM" in (done.stderr.splitlines() or [""])[-1]:
            pytest.skip("Sionna RT can't run here: no LLVM that Dr.Jit likes (DRJIT_LIBLLVM_PATH)")
        assert done.returncode == 0, done.stderr
        with np.load(file) as content:
            arrays = dict(content)
        return SimpleNamespace(a=tuple(arrays.pop("a")), **arrays)

    return run


@pytest.mark.parametrize(("name", "step"), [("room", 15), ("alcove", 30), ("ceiling", 30)])
def test_real_sionna_traces_the_paths_of_the_image_source_simulator(traced, name, step):
    scene = Scene.load(name)
    track, truth = scene.track("agent1"), true_paths(scene, "agent1")
    measurements = gs.from_sionna(traced(name, step), scene, track.heading_rad[::step], **LEAST)
    rows = np.flatnonzero(truth.step % step == 0)
    assert len(measurements.step) == len(rows)
    for number in range(len(measurements)):
        scan, true = measurements.scan(number), truth.at(number * step)
        gap = np.abs(scan.distance_m[:, None] - true.distance_m)
        gap += np.abs(wrap(scan.aod_rad[:, None] - true.aod_rad)) + np.abs(
            wrap(scan.aoa_rad[:, None] - true.aoa_rad)
        )
        gap += 1e3 * (scan.anchor[:, None] != true.anchor)
        assert gap.min(0).max() < 1e-3
        assert gap.min(1).max() < 1e-3
        sight = gap[:, true.bounces == 0].argmin(0)
        np.testing.assert_allclose(scan.amplitude[sight], true.amplitude[true.bounces == 0], rtol=1e-5)


def test_real_sionna_traces_the_paths_over_floor_and_ceiling(traced, tmp_path):
    scene = with_levels(Scene.load("ceiling"))
    (tmp_path / "levels.toml").write_text(scene.to_toml(), encoding="utf-8")
    track, truth = scene.track("agent1"), true_paths(scene, "agent1")
    measurements = gs.from_sionna(
        traced(str(tmp_path / "levels.toml"), 50, "office"), scene, track.heading_rad[::50], **LEAST
    )
    for number in range(len(measurements)):
        scan, true = measurements.scan(number), truth.at(number * 50)
        gap = np.abs(scan.distance_m[:, None] - true.distance_m)
        gap += np.abs(wrap(scan.aod_rad[:, None] - true.aod_rad))
        gap += np.abs(wrap(scan.aoa_rad[:, None] - true.aoa_rad)) + (scan.anchor[:, None] != true.anchor)
        assert gap.min(1).max() < 1e-2
        traceable = true.bounces + (true.over > 0) <= 2  # it was asked for so many
        assert gap.min(0)[traceable].max() < 1e-2
        assert (true.over[gap.argmin(1)] > 0).sum() > 8


def louder(name):
    """A scene with 40 dB at 1 m."""
    whole = Scene.load(name).model_dump(exclude_none=True)
    return Scene.checked({**whole, "radio": {**whole["radio"], "snr_at_1m_db": 40.0}}, "louder")


def detected_paths(clean, scene):
    """Those of the scene's own paths that were traced, with traced amplitudes: the bound needs the walls."""
    truth = true_paths(scene, "agent1")
    amplitude = np.full(len(truth), np.nan)
    for number in range(len(clean)):
        scan, rows = clean.scan(number), np.flatnonzero(truth.step == number)
        true = truth.at(number)
        gap = np.abs(scan.distance_m[:, None] - true.distance_m)
        gap += np.abs(wrap(scan.aod_rad[:, None] - true.aod_rad))
        gap += np.abs(wrap(scan.aoa_rad[:, None] - true.aoa_rad)) + (scan.anchor[:, None] != true.anchor)
        own, other = linear_sum_assignment(np.minimum(gap, 1.0))
        same = gap[own, other] < 3e-3
        amplitude[rows[other[same]]] = scan.amplitude[own[same]]
    found = np.isfinite(amplitude)
    assert found.sum() > 0.99 * len(clean.step)
    return replace(truth.take(found), amplitude=amplitude[found])


@pytest.mark.parametrize(
    ("name", "building", "most"),
    [
        ("room", "plane", 1.2),
        ("alcove", "plane", 1.3),
        ("ceiling", "plane", 1.3),
        ("sionna_scenes/warehouse.toml", "warehouse", 1.5),
        ("sionna_scenes/office.toml", "office", 1.5),
    ],
)
def test_measurements_of_real_sionna_are_mapped(traced, name, building, most):
    """Its materials, 6 GHz, 40 dB at 1 m: reflection varies with the angle, which the filter doesn't know."""
    place = str(Path(__file__).parent / name) if "/" in name else name
    scene = louder(place)
    track = scene.track("agent1")
    clean = gs.from_sionna(
        traced(place, 1, building), scene, track.heading_rad, truth=track, least_snr_db=-6.0
    )
    bound = known_map_bound(scene, "agent1", detected_paths(clean, scene))
    for seed in (1, 2, 3):
        run = map_scene(scene, receive(clean, scene, "agent1", seed), seed=seed)
        position, _ = track_errors(run.trajectory, track)
        assert not diverged(position)
        assert rmse(position) < most * rmse(bound.position_m)
        assert len(run.surfaces) >= 4
