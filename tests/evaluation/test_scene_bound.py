"""The bound of a scene, as users ask for it."""

import numpy as np
import pytest
from tiny import TINY

import gridslam as gs
from gridslam.evaluation.bounds import known_map_bound, unknown_map_bound

SCENE = gs.Scene.from_toml(TINY, "tiny")


def test_a_bound_by_name_is_the_one_of_tables():
    known, unknown = gs.bound(SCENE, "agent1"), gs.bound(SCENE, "agent1", known_map=False)
    np.testing.assert_array_equal(known.position_m, known_map_bound(SCENE, "agent1").position_m)
    np.testing.assert_array_equal(unknown.heading_rad, unknown_map_bound(SCENE, "agent1").heading_rad)
    assert len(known.position_m) == len(SCENE.track("agent1"))
    assert (known.position_m <= unknown.position_m + 1e-12).all()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "headed"), [("overlap", False), ("chamber", True)])
def test_samples_have_bounds_of_their_own(name, headed):
    scene = gs.Scene.load(name)
    whose = scene.agents[0].name
    found = gs.bound(scene, whose, what="signal")
    assert np.isfinite(found.position_m).all()
    assert np.isfinite(found.heading_rad).all() == headed


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (("tiny", "agent1"), r"scene: found str"),
        ((SCENE, "nobody"), r"agents: found 'nobody'; allowed: agent1, agent2"),
        ((SCENE,), r"agent"),
        ((SCENE, "agent1", True, "sound"), r"what: found 'sound'; allowed: 'paths' or 'signal'"),
    ],
)
def test_what_has_no_bound_is_refused(given, says):
    with pytest.raises(gs.InputError, match=says):
        gs.bound(*given)


@pytest.mark.slow
def test_scatterers_are_heard_in_samples_and_not_counted():
    with pytest.raises(gs.InputError, match="scatterers"):
        gs.bound(gs.Scene.load("scatter"), what="signal")
