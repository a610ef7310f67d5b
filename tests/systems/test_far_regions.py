"""Regions far from the origin: the same run, wherever a user puts it, and coordinates of the user's own."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gridslam as gs
from gridslam.errors import InputError
from gridslam.estimate_tables import SurfaceEstimate
from gridslam.evaluation.bounds import unknown_map_bound
from gridslam.evaluation.network_bounds import network_bound
from gridslam.evaluation.surface_truth import surface_scores
from gridslam.simulation.network import shared_air
from gridslam.systems.far_regions import about, middle_of, moved_map, moved_surfaces
from gridslam.systems.published.hybrid_known import KnownHybridSlam
from gridslam.world.start import Start

BY = np.array([250.0, -80.0])
METHODS = {
    "grid": gs.GridSlam, "adaptive": gs.AdaptiveSlam, "va": gs.VirtualAnchorSlam, "network": gs.NetworkSlam,
    "network_grid": gs.NetworkGridSlam,
}  # fmt: skip


def moved_scene(scene, by):
    """The scene somewhere else."""
    data = scene.model_dump(exclude_none=True)
    x, y = by

    def there(point):
        return (point[0] + x, point[1] + y, *point[2:])

    data["grid"]["x_m"] = tuple(np.add(data["grid"]["x_m"], x))
    data["grid"]["y_m"] = tuple(np.add(data["grid"]["y_m"], y))
    for anchor in data["anchors"]:
        anchor["position_m"] = there(anchor["position_m"])
    for wall in data["walls"]:
        wall["points_m"] = [there(point) for point in wall["points_m"]]
    for scatterer in data.get("scatterers", []):
        scatterer["position_m"] = there(scatterer["position_m"])
    for agent in data["agents"]:
        agent["start_m"] = there(agent["start_m"])
        agent["waypoints_m"] = [there(point) for point in agent["waypoints_m"]]
    return gs.Scene.checked(data, scene.name)


HERE = gs.Scene.load("room").with_filter(particles=512)
THERE = moved_scene(HERE, BY)
HEARD = list(gs.simulate(HERE, "agent1", seed=4))[:30]


def ended(scene, method, prior=None, steps=30, start=None):
    slam = METHODS[method](scene, prior, seed=2)
    if start is not None:
        slam.start_at(*start)
    for scan in HEARD[:steps]:
        estimate = slam.step(scan)
    return slam, estimate


def same_surfaces(there, here):
    """Lines, covariances and stretches, where offsets are from the origin of each."""
    moved, _ = moved_surfaces(here, BY)
    for name in ("line", "line_cov", "extent_m", "sfv_m", "sfv_cov_m2", "existence", "reflection"):
        np.testing.assert_allclose(getattr(there, name), getattr(moved, name), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_a_run_far_off_is_the_run_at_the_origin_moved(method):
    (near, here), (far, there) = (ended(scene, method) for scene in (HERE, THERE))
    np.testing.assert_allclose(there.position_m - BY, here.position_m, atol=1e-6)
    np.testing.assert_allclose(there.hypotheses.position_m - BY, here.hypotheses.position_m, atol=1e-6)
    np.testing.assert_allclose(there.covariance, here.covariance, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(there.paths.points - BY, here.paths.points, atol=1e-5)
    assert len(here.surfaces) > 3
    same_surfaces(there.surfaces, here.surfaces)
    same_surfaces(far.map().surfaces, near.map().surfaces)
    np.testing.assert_array_equal(far.map().origin_m, np.add(near.map().origin_m, BY))
    np.testing.assert_allclose(far.map().evidence, near.map().evidence, atol=0.05)


def test_northings_are_coordinates_as_any_and_tables_keep_their_millimetres(tmp_path):
    by = np.array([500_000.0, 5_000_000.0])
    (_, here), (far, there) = (ended(scene, "grid") for scene in (HERE, moved_scene(HERE, by)))
    np.testing.assert_allclose(there.position_m - by, here.position_m, atol=1e-6)
    surfaces = far.map().surfaces
    far.map().to_csv(tmp_path)
    rows = np.genfromtxt(tmp_path / "surfaces.csv", delimiter=",", names=True)
    offset = dict(zip(rows["identity"].astype(int), rows["offset_m"], strict=True))
    for identity, line in zip(surfaces.identity.tolist(), surfaces.line, strict=True):
        assert abs(offset[identity] - line[1]) < 1e-3


def test_maps_are_handed_on_in_the_users_coordinates(tmp_path):
    maps = []
    for scene in (HERE, THERE):
        ended(scene, "grid")[0].map().save(tmp_path / "map.h5")
        maps.append(gs.Map.load(tmp_path / "map.h5"))
    second = list(gs.simulate(HERE, "agent1", seed=9))
    found = []
    for scene, prior in zip((HERE, THERE), maps, strict=True):
        slam = gs.GridSlam(scene, prior, seed=3)
        for scan in second[:10]:
            estimate = slam.step(scan)
        found.append((estimate, slam.map()))
    (here, near), (there, far) = found
    np.testing.assert_allclose(there.position_m - BY, here.position_m, atol=1e-5)
    same_surfaces(far.surfaces, near.surfaces)
    np.testing.assert_allclose(
        far.surface_covariance, moved_map(near, BY).surface_covariance, rtol=1e-3, atol=1e-7
    )


def test_another_start_is_told_in_the_users_coordinates():
    body = HERE.agents[0]
    start = np.array(body.start_m) + np.array([0.1, -0.1]), np.radians(body.start_heading_deg)
    _, here = ended(HERE, "adaptive", steps=3, start=start)
    _, there = ended(THERE, "adaptive", steps=3, start=(start[0] + BY, start[1]))
    np.testing.assert_allclose(there.position_m - BY, here.position_m, atol=1e-6)


def test_a_checkpoint_far_off_is_gone_on_from(tmp_path):
    slam, _ = ended(THERE, "adaptive", steps=8)
    slam.save(tmp_path / "far.h5")
    other = gs.AdaptiveSlam.resume(tmp_path / "far.h5")
    one, two = slam.step(HEARD[8]), other.step(HEARD[8])
    np.testing.assert_array_equal(one.position_m, two.position_m)
    np.testing.assert_array_equal(slam.map().surfaces.line, other.map().surfaces.line)


def test_a_checkpoint_that_reckons_about_elsewhere_is_refused(tmp_path):
    """Versions before reckoned about the origin, and their checkpoints didn't say so."""
    ended(THERE, "network", steps=2)[0].save(tmp_path / "far.h5")
    with h5py.File(tmp_path / "far.h5", "r+") as file:
        del file["run"].attrs["origin_m"]
    with pytest.raises(InputError, match=r"far.h5: /run/origin_m: found \(0 0\) m; allowed: \(250 -80\) m"):
        gs.NetworkSlam.resume(tmp_path / "far.h5")


def test_where_the_region_holds_the_origin_nothing_is_moved():
    model = HERE.filter_model()
    assert about(model, middle_of(HERE.grid)) is model
    far = about(THERE.filter_model(), middle_of(THERE.grid))
    np.testing.assert_array_equal(far.origin_m, BY)
    np.testing.assert_allclose(far.anchor_positions, model.anchor_positions, atol=1e-9)
    np.testing.assert_allclose(far.start_mean, model.start_mean, atol=1e-9)
    np.testing.assert_allclose(far.middle, model.middle, atol=1e-9)


@given(st.integers(0, 10_000), st.tuples(st.floats(-300, 300), st.floats(-300, 300)))
def test_moved_surfaces_are_the_same_places(seed, by):
    """Points on each line, and its ends, move along; there and back all is as before."""
    draw, by = np.random.default_rng(seed), np.array(by)
    root = draw.normal(size=(3, 2, 2))
    table = SurfaceEstimate.from_lines(
        np.column_stack([draw.uniform(-np.pi, np.pi, 3), draw.uniform(0.1, 9, 3)]),
        0.01 * root @ root.transpose(0, 2, 1), np.full(3, 0.5), np.full(3, 0.01), np.ones(3),
        np.sort(draw.normal(size=(3, 2)), 1),
    )  # fmt: skip
    moved, slope = moved_surfaces(table, by)
    assert (moved.line[:, 1] >= 0).all()
    ends = np.sort(moved.ends_m - by, axis=1)
    np.testing.assert_allclose(ends, np.sort(table.ends_m, axis=1), atol=1e-9)
    small = 1e-6 * draw.normal(size=(3, 2))
    other, _ = moved_surfaces(replace(table, line=table.line + small), by)
    change = other.line - moved.line
    change[:, 0] = (change[:, 0] + np.pi) % (2 * np.pi) - np.pi
    near = np.abs(moved.line[:, 1]) > 1e-3  # a line through the origin may be turned over by so little
    np.testing.assert_allclose(change[near], np.einsum("kij,kj->ki", slope, small)[near], atol=1e-8)
    back, _ = moved_surfaces(moved, -by)
    np.testing.assert_allclose(back.line_cov, table.line_cov, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(back.extent_m, table.extent_m, atol=1e-9)


def test_scores_and_bounds_are_those_of_the_region_at_the_origin():
    """Feature vectors from far off called each wall false that was a degree off."""
    scores = [
        surface_scores(ended(scene, "adaptive")[0].map().surfaces, gs.ground_truth(scene, "agent1"))
        for scene in (HERE, THERE)
    ]
    assert scores[0]["surfaces_matched"] > 2
    assert scores[1] == pytest.approx(scores[0], abs=1e-4)
    bounds = [unknown_map_bound(scene, "agent1") for scene in (HERE, THERE)]
    clocked = [network_bound(scene, shared_air(scene, ("agent1",), 1, 4)[1]) for scene in (HERE, THERE)]
    np.testing.assert_allclose(*(one.position_m[-1] for one in clocked), rtol=1e-6)
    for name in ("position_m", "surface_m"):
        np.testing.assert_allclose(*(getattr(one, name)[-1] for one in bounds), rtol=1e-6)


AGENTS = ("agent1", "agent2", "agent3")


def network_run(scene, steps=16):
    """Three agents; anchors that measurements don't tell apart, clocks that nobody set; starts told."""
    slam = gs.NetworkSlam(scene, agents=AGENTS, seed=2)
    heard = gs.simulate(EXCHANGE, AGENTS, 4, unlabelled=True)
    tracks = {name: scene.track(name) for name in AGENTS}
    slam.start_all({name: Start(track.position_m[0], track.heading_rad[0]) for name, track in tracks.items()})
    for scan in list(heard)[:steps]:
        estimate = slam.step(scan)
    return slam, estimate


EXCHANGE = gs.Scene.load("exchange")


def test_agents_whose_clocks_are_open_are_where_they_were_moved_to():
    (near, here), (far, there) = (network_run(scene) for scene in (EXCHANGE, moved_scene(EXCHANGE, BY)))
    for name, own in here.agents.items():
        np.testing.assert_allclose(there.agents[name].position_m - BY, own.position_m, atol=1e-5)
        np.testing.assert_allclose(there.agents[name].paths.points - BY, own.paths.points, atol=1e-5)
    np.testing.assert_allclose(there.offset_s, here.offset_s, atol=1e-13)
    assert len(near.map().surfaces) == 4
    same_surfaces(far.map().surfaces, near.map().surfaces)


@pytest.mark.parametrize(
    ("name", "method"),
    [("overlap", gs.DirectSlam), ("chamber", gs.DirectGridSlam), ("screen", KnownHybridSlam)],
)
def test_samples_far_off_say_what_they_say_at_the_origin(name, method):
    """By surfaces about the region's middle; by images and learned features, which are places, anyhow."""
    ends = []
    for scene in (gs.Scene.load(name), moved_scene(gs.Scene.load(name), BY)):
        heard = gs.simulate(scene, scene.agents[0].name, 4, what="signal")
        slam = method(scene, seed=2, waveform=heard.waveform)
        for scan in list(heard)[:12]:
            estimate = slam.step(scan)
        ends.append((estimate, slam.map()))
    (here, near), (there, far) = ends
    np.testing.assert_allclose(there.position_m - BY, here.position_m, atol=1e-5)
    np.testing.assert_allclose(there.paths.points - BY, here.paths.points, atol=1e-4)
    same_surfaces(there.surfaces, here.surfaces)
    if near.features is not None:
        np.testing.assert_allclose(far.features.position_m - BY, near.features.position_m, atol=1e-5)
