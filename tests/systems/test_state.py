"""A state is a value: it can be kept, saved and gone on from; a step returns another, or nothing."""

import inspect
import sys
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from filter_states import model_of
from scene_samples import shortened

import gridslam as gs
from gridslam.inference.messages.association import Association
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives import tables
from gridslam.systems import adaptive, grid, virtual_anchor
from gridslam.systems.adaptive import AdaptiveSlam
from gridslam.systems.grid import GridSlam
from gridslam.systems.virtual_anchor import VirtualAnchorSlam
from gridslam.world.filter_model import FilterModel

SYSTEMS = [GridSlam, AdaptiveSlam, VirtualAnchorSlam]
STEPS = 12


@pytest.fixture(scope="module")
def scene():
    return shortened(gs.Scene.load("room"), STEPS).with_filter(particles=256)


@pytest.fixture(scope="module")
def scans(scene):
    return list(gs.simulate(scene, "agent1", seed=2))


def arrays(value):
    """All arrays that a value is made of."""
    if isinstance(value, np.ndarray):
        yield value
    elif is_dataclass(value):
        for field in fields(value):
            yield from arrays(getattr(value, field.name))
    elif isinstance(value, dict | list | tuple):
        for part in value.values() if isinstance(value, dict) else value:
            yield from arrays(part)


def frozen(value):
    for array in arrays(value):
        array.setflags(write=False)
    return value


def same(one, two):
    for here, there in zip(arrays(one), arrays(two), strict=True):
        np.testing.assert_array_equal(here, there)


@pytest.mark.parametrize("system", SYSTEMS)
def test_nothing_writes_into_a_state_or_an_info_that_was_returned(system, scene, scans):
    plain, watched = system(scene, seed=3), system(scene, seed=3)
    for scan in scans:
        kept, info = plain.state, frozen(watched.info)
        copies = [array.copy() for array in arrays((kept, info))]
        estimate, other = plain.step(scan), watched.step(scan)
        frozen(watched.state)
        np.testing.assert_array_equal(estimate.covariance, other.covariance)
        for array, copy in zip(arrays((kept, info)), copies, strict=True):
            np.testing.assert_array_equal(array, copy)
    assert len(plain.state.surfaces)


@pytest.mark.parametrize("system", SYSTEMS)
def test_no_message_of_a_step_writes_into_likelihood_ratios_or_births(system, scene, scans, monkeypatch):
    """What a line returned is read-only, and the same at the step's end: kernels don't see flags."""
    plain, module, returned = system(scene, seed=3), sys.modules[system.advance.__module__], []
    expected = [plain.step(scan).covariance for scan in scans]

    def guard(name):
        function = getattr(module, name)

        def guarded(*arguments, **more):
            result = function(*arguments, **more)
            for part in result:
                if isinstance(part, LikelihoodRatios):  # its pairs are the workspace's
                    part = part.odds, part.message, part.measured
                if isinstance(part, Births | tuple):
                    returned.extend((name, array, array.copy()) for array in arrays(frozen(part)))
            return result

        monkeypatch.setattr(module, name, guarded)

    births = {"admitted_births", "propose_births"} & set(vars(module))
    assert len(births) == 1
    for name in {"evaluate", "learn_clutter", "weigh_by_leftovers"} & set(vars(module)) | births:
        guard(name)
    watched = system(scene, seed=3)
    for scan, covariance in zip(scans, expected, strict=True):
        np.testing.assert_array_equal(watched.step(scan).covariance, covariance)
        assert {"evaluate", *births} <= {name for name, *_ in returned}
        for name, array, copy in returned:
            np.testing.assert_array_equal(array, copy, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("system", SYSTEMS)
def test_a_step_can_be_taken_again_from_any_state_that_was_kept(system, scene, scans):
    slam, kept = system(scene, seed=3), []
    for scan in scans:
        kept.append(slam.state)
        slam.step(scan)
    again, model = system(scene, seed=3), slam.model
    for number in (7, 2, 7):
        state = kept[number]
        for scan in scans[number:]:
            state, info = system.advance(state, scan, model, again.work)
        same(state, slam.state)
        assert info.health.why == slam.info.health.why


def owner(array):
    """The array whose memory it is."""
    return array if array.base is None else owner(array.base)


def test_to_keep_every_state_of_a_run_takes_13_bytes_a_cell_and_little_else(scene, scans):
    slam, kept = GridSlam(scene, seed=3), []
    for scan in scans:
        slam.step(scan)
        kept.append(slam.state)
    own = {id(whole): whole.nbytes for state in kept for whole in map(owner, arrays(state))}
    cells, rows = kept[-1].grid.evidence.size, len(kept[-1].grid.hit)
    assert rows < 0.1 * cells, "coefficients are those of cells that were hit"
    assert sum(own.values()) < len(kept) * (13 * cells + 80 * rows + 60_000)


def interrupted(after, function, *arguments):
    """Call a function, and raise at the line of ours of this number; return how many lines came."""
    ours, lines = str(Path(gs.__file__).parent), 0

    def watch(frame, event, _):
        nonlocal lines
        if not frame.f_code.co_filename.startswith(ours) or "/kernels/" in frame.f_code.co_filename:
            return None
        if event == "line":
            lines += 1
            if lines == after:
                raise KeyboardInterrupt
        return watch

    before = sys.gettrace()
    sys.settrace(watch)
    try:
        function(*arguments)
    finally:
        sys.settrace(before)
    return lines


@pytest.mark.slow
@pytest.mark.parametrize("system", SYSTEMS)
def test_a_step_that_is_interrupted_at_any_line_leaves_the_old_state_whole(system, scene, scans):
    slam, plain = system(scene, seed=3), system(scene, seed=3)
    for scan in scans[:6]:
        slam.step(scan)
        plain.step(scan)
    everywhere = interrupted(-1, plain.step, scans[6])
    assert everywhere > 500
    before = slam.state
    copies = [array.copy() for array in arrays(before)]
    for place in np.random.default_rng(4).integers(1, everywhere - 50, 20).tolist():
        with pytest.raises(KeyboardInterrupt):
            interrupted(place, slam.step, scans[6])
        assert slam.state is before
        for array, copy in zip(arrays(before), copies, strict=True):
            np.testing.assert_array_equal(array, copy)
    slam.step(scans[6])
    same(slam.state, plain.state)
    for scan in scans[7:]:
        same(slam.step(scan).covariance, plain.step(scan).covariance)


@pytest.mark.parametrize("system", SYSTEMS)
def test_every_system_goes_on_from_its_checkpoint_bit_for_bit(system, scene, scans, tmp_path):
    slam = system(scene, seed=3)
    for scan in scans[:7]:
        slam.step(scan)
    slam.save(tmp_path / "here.h5")
    again = system.resume(tmp_path / "here.h5")
    same(again.state, slam.state)
    for scan in scans[7:]:
        same(slam.step(scan).covariance, again.step(scan).covariance)
    same(slam.state, again.state)
    others = [other for other in SYSTEMS if other is not system]
    for other in others:
        with pytest.raises(gs.InputError, match="method"):
            other.resume(tmp_path / "here.h5")


@pytest.fixture(scope="module")
def seven_steps_on(scene, scans):
    """A filter that is written, and not stepped on."""
    slam = GridSlam(scene, seed=3)
    for scan in scans[:7]:
        slam.step(scan)
    return slam


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("belief/mean", lambda data: np.full(data.shape, np.nan)),
        ("belief/covariance", lambda data: -data),
        ("belief/covariance", lambda data: data + np.triu(np.ones(data.shape), 1)),
        ("surfaces/existence", lambda data: np.full(data.shape, np.inf)),
        ("los", lambda data: np.full(data.shape, np.nan)),
        ("grid/row", lambda data: data + 10_000),
        ("grid/row", lambda data: np.where(data >= 0, 0, -1)),
        ("grid/row", lambda data: data.astype(float)),
        ("surfaces/existence", lambda data: data + 7),
        ("surfaces/identity", lambda data: 0 * data),
        ("surfaces/identity", lambda data: data + 10_000),
        ("surfaces/reflection", lambda data: -data),
        ("surfaces/owner", lambda data: data + 99),
        ("calibration/turn_weight", lambda data: -data),
        ("grid/evidence", lambda data: np.full(data.shape, np.nan)),
        ("ranges/information", lambda data: data[:2, :2]),
        ("ranges/vector", lambda data: np.full(data.shape, np.nan)),
        ("sights/sums", lambda data: np.full(data.shape, np.nan)),
        ("sights/looks", lambda data: data[:1]),
    ],
)
def test_a_checkpoint_whose_numbers_cannot_be_is_refused(name, spoil, seven_steps_on, tmp_path, monkeypatch):
    from gridslam.systems import checkpoint, values

    slam, put = seven_steps_on, values.put

    def spoiled(group, own, value, units):
        ours = f"{group.name.strip('/')}/{own}".endswith(name)
        put(group, own, spoil(np.asarray(value)) if ours else value, units)

    with monkeypatch.context() as patch:
        patch.setattr(values, "put", spoiled)
        slam.save(tmp_path / "here.h5")
    with h5py.File(tmp_path / "here.h5", "r") as file:
        assert file.attrs["version"] == checkpoint.VERSION
    with pytest.raises(gs.InputError, match=name.rpartition("/")[2]):
        GridSlam.resume(tmp_path / "here.h5")


@pytest.mark.parametrize("system", SYSTEMS)
def test_what_a_user_does_to_an_estimate_does_nothing_to_the_state(system, scene, scans):
    slam, plain = system(scene, seed=3), system(scene, seed=3)
    for scan in scans:
        estimate = slam.step(scan)
        plain.step(scan)
        for array in arrays(estimate):
            if array.flags.writeable:
                array[...] = 1
    same(slam.state, plain.state)


def test_virtual_anchors_claim_no_evidence_of_a_map_that_they_dont_use(scene, scans):
    first = GridSlam(scene, seed=1)
    for scan in scans[:4]:
        first.step(scan)
    slam = VirtualAnchorSlam(scene, prior_map=first.map(), seed=1)
    assert slam.map().provenance["runs"] == [""]
    assert len(slam.map().provenance["agents"]) == 1


def test_evidence_with_rings_is_that_of_all_causes():
    """Distances alone: rings and what may begin them take part in the association, so in its normaliser."""
    scene = shortened(gs.Scene.load("seminar"), 6).with_filter(particles=256)
    slam = VirtualAnchorSlam(scene, seed=1)
    for scan in gs.simulate(scene, scene.agents[0].name, seed=1):
        slam.step(scan)
    assert len(slam.state.rings)
    whole = alone = 0.0
    for exchange in slam.info.exchanges:
        given = exchange.given
        np.testing.assert_array_equal(exchange.measured[tables.NEW], given.new)
        assert (given.new > 1).any(), "rings may begin"
        whole += exchange.log_evidence
        paths = Association.alone(given.nu, given.claimed, given.new)
        alone += replace(exchange, given=paths).log_evidence
    assert whole > alone + 3, "rings that are heard again are worth something"


def test_a_filter_is_handed_nothing_of_the_walls_or_the_track():
    """A step takes a `FilterModel`, which has no place for them: that it can't look is a matter of type."""
    for system in (grid, adaptive, virtual_anchor):
        assert inspect.signature(system.step).parameters["model"].annotation == "FilterModel"
        assert "Scene" not in vars(system)
    names = {field.name for field in fields(FilterModel)}
    assert not names & {"walls", "segments", "waypoints_m", "agents", "track", "truth"}
    scene = gs.Scene.load("canyon")
    model = scene.filter_model()
    walls = {tuple(corner) for wall in scene.walls for corner in np.round(wall.corners, 6).tolist()}
    held = {
        tuple(row)
        for array in arrays(model)
        for row in np.round(np.atleast_2d(array), 6)[..., :2].reshape(-1, 2).tolist()
    }
    assert not held & walls


def test_a_model_without_an_agent_is_refused():
    scene = gs.Scene.load("room").model_copy(update={"agents": ()})
    with pytest.raises(gs.InputError, match="agents"):
        scene.filter_model()


def test_what_hypotheses_share_is_made_once_and_of_the_same_objects_alone(scene):
    work, made = GridSlam(scene, seed=1).work, []
    one, two = np.zeros(2), np.zeros(2)

    def make(*of):
        made.append(of)
        return len(made)

    assert [work.once(make, one), work.once(make, one), work.once(make, two)] == [1, 1, 2]
    assert work.once(make, one, two) == 3
    for other in range(200):  # forgotten arrays' numbers are given to others
        assert work.once(make, np.full(2, other)) == 4 + other
    assert work.once(make, one) == 204


def test_stages_of_a_step_add_up_and_workspaces_are_their_filters_own(scene, scans):
    one, two = GridSlam(scene, seed=3), GridSlam(scene, seed=3)
    for scan in scans[:3]:
        seconds = one.step(scan).seconds
        parts = one.info.seconds
        assert {"evaluation", "updates", "births", "cells", "bookkeeping"} <= set(parts)
        assert 0 < sum(parts.values()) <= seconds
        two.step(scan)
    assert one.work is not two.work
    settings = model_of("room", particles=320).settings
    assert Workspace(replace(one.model, settings=settings), seed=1).particles.count == 320
