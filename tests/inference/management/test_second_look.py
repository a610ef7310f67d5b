"""Second looks: what was received is gone through again with the images found since, and evidence decides."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from image_states import with_images

import gridslam as gs
from gridslam.errors import InputError
from gridslam.inference.management.samples import second_look
from gridslam.inference.management.samples.second_look import (
    COST,
    EVERY,
    FEWEST,
    LAST,
    LOOSE_M,
    advance_population,
    begun,
    is_due,
    looked_again,
    with_images_of,
)
from gridslam.inference.state.past import Past
from gridslam.inference.state.population import Population
from gridslam.systems.direct import start
from gridslam.world.signal_model import SignalModel


def scene_of(bounces=2, prior_m=0.1, steps=3):
    """`overlap` of so many bounces, with a start known to so many metres either way."""
    data = gs.Scene.load("overlap").model_dump(exclude_none=True)
    data["radio"]["max_bounces"] = bounces
    data["agents"][0]["steps"], data["agents"][0]["prior"]["position_m"] = steps, prior_m
    return gs.Scene.checked(data, "overlap")


def model_of(scene):
    return SignalModel.of(scene.filter_model("agent1"), scene.waveform("agent1"))


@pytest.fixture(scope="module")
def model():
    return model_of(scene_of())


@pytest.fixture(scope="module")
def scan():
    return gs.simulate(scene_of(), "agent1", seed=1, what="signal").scan(0)


def moving(state, scan, model):
    """A step at which nothing is told."""
    return replace(state, step=state.step + 1), SimpleNamespace(found=[])


def many(model, count=FEWEST):
    """A state with images that are known, far from each other."""
    return with_images(model, *((k % 2, [2.0 * k - 9, 12.0], 0) for k in range(count)))


def with_past(state, model, scans, log_evidence=0.0):
    return replace(Population.of(state), past=Past(start(model), tuple(scans), log_evidence))


@pytest.mark.parametrize(("bounces", "prior_m", "kept"), [(2, 0.1, True), (1, 0.1, False), (2, 3.0, False)])
def test_scans_are_kept_where_walls_reflect_twice_and_the_start_is_known(bounces, prior_m, kept):
    model = model_of(scene_of(bounces, prior_m))
    assert (begun(start(model), model).past is not None) == kept


def test_a_look_starts_as_the_run_did_with_known_images_roughly_in_place(model):
    later = many(model, 4)
    images = replace(
        later.images, existence=np.array([0.99, 0.99, 0.3, 0.99]), bounces=np.array([0, 2, 0, -2])
    )
    later = replace(later, images=images, step=40)
    first = start(model)
    state = with_images_of(first, later)
    assert state.step == 0
    assert state.images.anchor.tolist() == [0, 1]
    assert state.images.bounces.tolist() == [0, 0]
    np.testing.assert_allclose(state.places, later.places[:2], atol=1e-12)
    np.testing.assert_allclose(state.place_covariances, np.tile(LOOSE_M**2 * np.eye(2), (2, 1, 1)), atol=1e-9)
    np.testing.assert_array_equal(state.belief.mean[:4], first.belief.mean)
    np.testing.assert_array_equal(state.belief.covariance[:4, :4], first.belief.covariance)
    assert all(holds for _, holds, _ in state.claims(len(model.anchors)))


def test_images_known_badly_are_left_out(model):
    later = with_images(model, (0, [4.0, 12.0], 0), spread=0.5)
    assert len(with_images_of(start(model), later).images) == 0


@pytest.mark.parametrize(
    ("scans", "images", "due"),
    [(EVERY, FEWEST, True), (EVERY - 1, FEWEST, False), (EVERY, FEWEST - 1, False), (0, FEWEST, False)],
)
def test_looks_wait_for_their_step_and_for_images(model, scan, scans, images, due):
    assert is_due(with_past(many(model, images), model, [scan] * scans)) == due


@pytest.mark.parametrize(("before", "taken"), [(-COST * FEWEST - 20, True), (-COST * FEWEST + 20, False)])
def test_evidence_less_the_cost_of_images_decides(model, scan, before, taken):
    """Scans that tell nothing: the look's log evidence is the cost alone."""
    population = with_past(many(model), model, [scan] * EVERY, before)
    after = looked_again(population, model, moving)
    assert len(after) == 1
    assert (after.best.step == EVERY) == taken
    assert after.past.log_evidence == pytest.approx(np.logaddexp(before, -COST * FEWEST))
    assert population.best.step == 0


def test_as_likely_hypotheses_stay_beside_each_other_until_they_are_one(model, scan):
    far = with_images(model, *((k % 2, [2.0 * k - 9, -12.0], 0) for k in range(FEWEST)))
    population = with_past(many(model), model, [scan] * EVERY, -COST * FEWEST)
    assert len(looked_again(population, model, moving)) == 1
    apart = replace(population, past=replace(population.past, start=replace(far, step=0)))
    moved = replace(apart.best, belief=replace(apart.best.belief, mean=apart.best.belief.mean + 0.7))
    apart = replace(apart, states=(moved,))
    both = looked_again(apart, model, moving)
    assert len(both) == 2
    np.testing.assert_allclose(both.weights, 0.5)
    _, _, amiss = advance_population(both, scan, model, moving)
    assert "places remain" in amiss


def test_nothing_is_kept_once_it_is_too_late(model, scan):
    state = replace(many(model), step=LAST - 1)
    population, _, _ = advance_population(with_past(state, model, [scan] * 3), scan, model, moving)
    assert len(population.past.scans) == 4
    population, _, _ = advance_population(population, scan, model, moving)
    assert population.past.scans == ()
    assert not is_due(population)


def test_a_look_is_taken_when_it_is_due(model, scan, monkeypatch):
    monkeypatch.setattr(second_look, "looked_again", lambda population, *_: replace(population, waited=7))
    for scans, waited in ((EVERY - 1, 7), (EVERY - 2, 0)):
        population, _, _ = advance_population(
            with_past(many(model), model, [scan] * scans), scan, model, moving
        )
        assert population.waited == waited


@pytest.mark.slow
def test_a_run_goes_on_from_a_checkpoint_and_wrong_ones_are_refused(tmp_path):
    scene = scene_of()
    scans = list(gs.simulate(scene, "agent1", seed=2, what="signal"))
    slam = gs.DirectSlam(scene)
    slam.step(scans[0])
    slam.step(scans[1])
    slam.save(tmp_path / "a.h5")
    again = gs.DirectSlam.resume(tmp_path / "a.h5")
    assert len(again.population.past.scans) == 2
    assert again.population.past.log_evidence == slam.population.past.log_evidence
    for one in (slam, again):
        one.step(scans[2])
    np.testing.assert_array_equal(slam.state.belief.mean, again.state.belief.mean)
    assert again.population.past.log_evidence == slam.population.past.log_evidence
    past = slam.population.past
    for broken in (
        replace(past, scans=past.scans * LAST),
        replace(past, scans=(replace(scans[0], heard=np.ones(3, bool)),)),
        replace(past, start=replace(past.start, next_identity=-1)),
    ):
        with pytest.raises(InputError):
            slam.require_sound(replace(slam.population, past=broken), slam.model, "file")
