"""``filter.representation = "particles"``: the same front door, outputs and checkpoints."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.errors import InputError
from gridslam.systems.published.direct_paper import PublishedDirectSlam
from gridslam.systems.published.network_paper import PublishedNetworkSlam
from gridslam.systems.published.refa import PublishedVirtualAnchorSlam
from gridslam.systems.soundness import require_sound
from gridslam.systems.virtual_anchor import VirtualAnchorSlam

STEPS = 20


@pytest.fixture(scope="module")
def world():
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    data["agents"][0]["steps"] = STEPS
    data["filter"] |= {"particles": 1500, "representation": "particles"}
    scene = gs.Scene.checked(data, "room")
    return scene, gs.simulate(scene, "agent1", 4)


@pytest.mark.slow
@pytest.mark.parametrize("system", [gs.AdaptiveSlam, gs.GridSlam])
def test_it_follows_maps_and_goes_on_bit_for_bit(system, world, tmp_path):
    scene, measurements = world
    slam, errors = system(scene, seed=5), []
    for scan in measurements:
        if scan.step == STEPS - 2:
            slam.save(tmp_path / "a.h5")
            again = system.resume(tmp_path / "a.h5")
        before = slam.state
        kept = before.samples.agent.copy(), before.samples.lines.copy()
        estimate = slam.step(scan)
        np.testing.assert_array_equal(before.samples.agent, kept[0])
        np.testing.assert_array_equal(before.samples.lines, kept[1])
        if scan.step >= STEPS - 2:
            np.testing.assert_array_equal(estimate.covariance, again.step(scan).covariance)
        errors.append(np.linalg.norm(estimate.position_m - measurements.truth.position_m[scan.step]))
    assert np.sqrt(np.mean(np.square(errors[5:]))) < 0.06
    assert estimate.detected.sum() >= 4
    np.testing.assert_array_equal(slam.state.samples.identity, slam.state.surfaces.identity)
    np.testing.assert_allclose(slam.state.samples.agent[:, :2].mean(0), estimate.position_m)
    assert not slam.state.belief.covariance[:5, 5:].any()
    if system is gs.GridSlam:
        assert slam.map().observed.any()


def test_a_start_that_is_told_moves_all_particles(world):
    slam = gs.AdaptiveSlam(world[0], seed=1)
    slam.start_at(np.array([1.0, 0.5]), 2.0)
    np.testing.assert_allclose(slam.state.samples.agent[:, [0, 1, 4]].mean(0), [1.0, 0.5, 2.0], atol=1e-6)
    np.testing.assert_allclose(slam.state.belief.mean[[0, 1, 4]], [1.0, 0.5, 2.0])


def test_methods_that_take_no_particles_say_so(world):
    with pytest.raises(InputError, match=r"filter\.representation.*'particles' for va"):
        VirtualAnchorSlam(world[0])


def test_a_checkpoint_whose_particles_dont_fit_is_refused(world):
    slam = gs.AdaptiveSlam(world[0], seed=1)
    samples = slam.state.samples
    for broken in (None, replace(samples, agent=samples.agent[:5]), replace(samples, identity=np.array([3]))):
        with pytest.raises(InputError, match="samples"):
            require_sound(replace(slam.state, samples=broken), slam.model, "file")


STARTS = {
    PublishedVirtualAnchorSlam: ("room", lambda state: state.agent),
    PublishedDirectSlam: ("overlap", lambda state: state.agent),
    PublishedNetworkSlam: ("exchange", lambda state: state.agents[0]),
    gs.AdaptiveSlam: (None, lambda state: state.samples.agent),
}


@pytest.mark.parametrize("system", STARTS)
def test_a_start_draws_particles_by_its_seed(world, system):
    """Or all runs of a study would begin with one draw of the prior."""
    name, particles = STARTS[system]
    scene = world[0] if name is None else gs.Scene.load(name).with_filter(particles=50)
    first, again, other = (particles(system(scene, seed=seed).state) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not (first == other).any()
