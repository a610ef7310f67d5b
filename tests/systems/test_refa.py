"""Virtual-anchor SLAM as published: it follows, repeats itself, and goes on from sound checkpoints alone."""

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.errors import InputError
from gridslam.systems.published.refa import PublishedVirtualAnchorSlam
from gridslam.systems.published.soundness import require_sound_particles

STEPS = 25


@pytest.fixture(scope="module")
def world():
    scene = short("room", STEPS, particles=1500)
    return scene, gs.simulate(scene, "agent1", 4)


@pytest.mark.slow
def test_it_follows_its_agent_maps_for_every_anchor_and_goes_on_bit_for_bit(world, tmp_path):
    scene, measurements = world
    slam, errors = PublishedVirtualAnchorSlam(scene, seed=5), []
    for scan in measurements:
        if scan.step == STEPS - 2:
            slam.save(tmp_path / "a.h5")
            again = PublishedVirtualAnchorSlam.resume(tmp_path / "a.h5")
        before = slam.state.agent.copy(), slam.state.features.position.copy(), slam.state
        estimate = slam.step(scan)
        np.testing.assert_array_equal(before[2].agent, before[0])
        np.testing.assert_array_equal(before[2].features.position, before[1])
        if scan.step >= STEPS - 2:
            np.testing.assert_array_equal(estimate.covariance, again.step(scan).covariance)
        errors.append(np.linalg.norm(estimate.position_m - measurements.truth.position_m[scan.step]))
    assert np.sqrt(np.mean(np.square(errors[5:]))) < 0.06
    owners = slam.map().surfaces.owner
    assert (np.bincount(owners, minlength=2) >= 3).all()
    known = [(np.pi, 4.0), (0.0, 4.0), (np.pi / 2, 3.0), (-np.pi / 2, 3.0)]
    for angle, offset in known:  # each wall, by one anchor at least
        off = slam.map().surfaces.sfv_m - 2 * offset * np.array([np.cos(angle), np.sin(angle)])
        assert np.linalg.norm(off, axis=-1).min() < 0.5
    assert (estimate.paths.surfaces == -1).all(1).sum() == 2
    np.testing.assert_allclose(
        estimate.paths.points[:, 3], np.tile(estimate.position_m, (len(estimate.paths), 1))
    )


def test_a_start_that_is_told_moves_all_particles(world):
    slam = PublishedVirtualAnchorSlam(world[0], seed=1)
    spread = slam.state.agent.std(0)
    slam.start_at(np.array([1.0, 0.5]), 2.0)
    np.testing.assert_allclose(slam.state.agent[:, [0, 1, 4]].mean(0), [1.0, 0.5, 2.0], atol=0.02)
    np.testing.assert_allclose(slam.state.agent.std(0), spread)


@pytest.mark.parametrize(
    ("name", "change", "part"),
    [
        ("existence", lambda a: a + 2, "existence"),
        ("anchor", lambda a: a + 7, "anchor"),
        ("fixed", lambda a: a & False, "fixed"),
    ],
)
def test_a_checkpoint_that_cant_be_is_refused(world, tmp_path, name, change, part):
    slam = PublishedVirtualAnchorSlam(world[0], seed=1)
    features = slam.state.features
    broken = type(features)(**(vars(features) | {name: change(getattr(features, name))}))
    state = type(slam.state)(**(vars(slam.state) | {"features": broken}))
    with pytest.raises(InputError, match=part):
        require_sound_particles(state, slam.model, "file")
