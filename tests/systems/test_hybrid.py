"""Hybrid SLAM in its scene: what it reaches, its checkpoints, and what it hands over and refuses."""

from dataclasses import fields, is_dataclass, replace

import h5py
import numpy as np
import pytest
from map_samples import of_another_run

import gridslam as gs
from gridslam import runtime
from gridslam.errors import InputError
from gridslam.estimate_tables import FREE
from gridslam.inference.health.reasons import UNSIGHTED
from gridslam.inference.health.signal_watch import EARLY
from gridslam.inference.messages.features.lessons import SETTLED
from gridslam.maps.frames import fitted
from gridslam.maps.fusion import fuse
from gridslam.runs.calibrate import calibrate
from gridslam.systems import values
from gridslam.systems.hybrid import HybridSlam, SightSlam
from gridslam.systems.published.hybrid_known import KnownHybridSlam
from gridslam.world.start import assumed_start

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
HIDDEN = slice(68, 126)
APART = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 1.0], [0.0, -1.0]])
CHECKED_STEPS = (5, 12, 32, 40)
"""With particles; while the first steps, then a segment, are being learned from; between."""
WATCHED = (5, 9, 14, 29, 34, 40)
"""The same, and where learning begins and ends."""


@pytest.fixture(scope="module")
def screen():
    return gs.Scene.load("screen").with_filter(particles=2000)


@pytest.fixture(scope="module")
def recording(screen):
    return gs.simulate(screen, "agent1", 1, what="signal")


def begun(system, scene, recording, **more):
    slam = system(scene, seed=1, waveform=recording.waveform, **more)
    start = assumed_start(scene, "agent1", 1)
    slam.start_at(start.position_m, start.heading_rad)
    return slam


def arrays(value):
    for field in fields(value) if is_dataclass(value) else ():
        inner = getattr(value, field.name)
        yield from [inner] if isinstance(inner, np.ndarray) else arrays(inner)


@pytest.fixture(scope="module")
def run(screen, recording, tmp_path_factory):
    """The whole way: the filter, its estimates, checkpoints, and whether states stayed as they were."""
    folder, slam = tmp_path_factory.mktemp("hybrid"), begun(HybridSlam, screen, recording)
    estimates, kept, before = [], {}, {}
    for scan in recording:
        if scan.step in CHECKED_STEPS:
            kept[scan.step] = folder / f"{scan.step}.h5"
            slam.save(kept[scan.step])
        if scan.step in WATCHED:
            state = slam.state
            copy = [array.copy() for array in arrays(state)]
            estimates.append(slam.step(scan))
            before[scan.step] = all(map(np.array_equal, copy, arrays(state)))
        else:
            estimates.append(slam.step(scan))
    return slam, estimates, kept, before


@pytest.mark.slow
def test_learned_features_carry_the_agent_past_the_screen(run, recording):
    estimates = run[1]
    off = np.array([e.position_m for e in estimates]) - recording.truth.position_m
    assert np.sqrt((off[HIDDEN] ** 2).sum(1).mean()) < 0.15
    assert np.hypot(*off[5:].T).max() < 0.6
    sights = np.array([e.paths.existence[0] for e in estimates])
    assert (sights[10:66] > 0.5).all()
    assert (sights[70:125] < 0.5).all()
    assert (sights[130:] > 0.5).all()
    squares = [x @ np.linalg.solve(e.covariance[:2, :2], x) / 2 for x, e in zip(off, estimates, strict=True)]
    assert 0.3 < np.mean(squares[40:]) < 3
    assert all(e.health.ok for e in estimates[15:])


@pytest.mark.slow
def test_the_learned_features_are_the_images_of_the_anchor(run):
    table = run[0].map().features
    for image in ([15.5, 5.0], [0.5, -19.0], [15.5, -19.0]):
        gap = np.hypot(*(table.position_m - image).T)
        assert gap.min() < 0.5
        assert abs(table.bias_m[gap.argmin()]) < 0.01
        assert table.kind[gap.argmin()] == 1


@pytest.mark.slow
def test_a_step_leaves_the_state_before_as_it_was(run):
    assert run[3] == dict.fromkeys(WATCHED, True)


@pytest.mark.slow
@pytest.mark.parametrize("step", CHECKED_STEPS)
def test_it_goes_on_from_its_checkpoint_bit_for_bit(run, recording, step):
    slam = HybridSlam.resume(run[2][step])
    for k in range(step, step + 26):  # nobody learns ahead, where a segment was being learned from
        estimate = slam.step(recording.scan(k))
    np.testing.assert_array_equal(estimate.position_m, run[1][step + 25].position_m)
    np.testing.assert_array_equal(estimate.covariance, run[1][step + 25].covariance)


@pytest.mark.slow
@pytest.mark.parametrize("later", [5, 30])
def test_a_lesson_that_ended_at_another_step_is_refused(run, recording, later):
    state = HybridSlam.resume(run[2][32]).state
    lesson = replace(state.lesson, step=state.lesson.step - later)
    with pytest.raises(InputError, match="lesson"):
        HybridSlam.require_sound(replace(state, lesson=lesson), run[0].model, "state")


@pytest.mark.slow
def test_the_next_agent_goes_on_from_the_map(run, screen, recording, tmp_path):
    run[0].map().save(tmp_path / "map.h5")
    prior = of_another_run(gs.Map.load(tmp_path / "map.h5"))
    slam = begun(HybridSlam, screen, recording, prior_map=prior)
    assert len(slam.state.joint.features) == len(prior.features)
    off = [
        np.hypot(*(slam.step(recording.scan(k)).position_m - recording.truth.position_m[k]))
        for k in range(20)
    ]
    assert max(off[15:]) < 0.15
    slam.save(tmp_path / "state.h5")
    again, sheet = HybridSlam.resume(tmp_path / "state.h5").map(), slam.map()
    np.testing.assert_array_equal(again.evidence, sheet.evidence)
    np.testing.assert_array_equal(again.surface_covariance, sheet.surface_covariance)
    assert (sheet.observed | ~prior.observed).all()
    assert len(sheet.surfaces) == len(prior.surfaces)
    with h5py.File(tmp_path / "state.h5", "r+") as file:
        del file["inherited/grid/observed"]
    with pytest.raises(InputError, match="inherited"):
        HybridSlam.resume(tmp_path / "state.h5")
    far = replace(
        prior.features, anchor_m=prior.features.anchor_m + 1, kind=np.full(len(prior.features), FREE)
    )
    others = replace(prior, features=far, surfaces=None, surface_reflection=None, surface_covariance=None)
    assert len(HybridSlam(screen, others).state.joint.features) == 0
    assert len(SightSlam(screen, prior).state.joint.features) == 0  # the line of sight alone


def test_the_line_of_sight_alone_says_whether_it_is_there(screen, recording):
    slam = begun(SightSlam, screen, recording)
    estimates = [slam.step(recording.scan(k)) for k in range(12)]
    off = np.hypot(*(estimates[-1].position_m - recording.truth.position_m[11]))
    assert off < 0.5
    assert estimates[-1].paths.existence[0] > 0.5
    assert slam.state.particles is not None
    assert slam.map().features is not None
    assert len(slam.map().features) == 0


def test_radios_without_a_model_are_refused_in_one_line(screen, recording):
    wave = recording.waveform
    for more, says in (
        ({"agent_element_m": wave.agent_element_m[:3]}, "symmetry"),
        ({"agent_element_m": wave.agent_element_m + 0.01}, "centre"),
        ({"anchor_element_m": np.array([[[0.0, 0.01], [0.0, -0.01]]])}, "1 for hybrid"),
        ({"pulse": wave.pulse * np.linspace(0.1, 1, 81)}, "even"),
    ):
        with pytest.raises(InputError, match=says):
            HybridSlam(screen, waveform=replace(wave, **more))


def test_an_array_needs_a_heading(screen, recording):
    slam = begun(HybridSlam, screen, recording)
    with pytest.raises(InputError, match="heading_rad"):
        slam.step(replace(recording.scan(0), heading_rad=None))
    assert slam.state.step == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("noise", lambda x: -x), ("existence", lambda x: x + 1), ("agent", lambda x: x[:, :3]),
        ("weight", lambda x: 2 * x), ("time_s", lambda x: x[::-1].copy()),
    ],
)  # fmt: skip
def test_a_checkpoint_that_cannot_be_is_refused(screen, recording, tmp_path, monkeypatch, name, spoil):
    slam, put = begun(HybridSlam, screen, recording), values.put
    for k in range(3):
        slam.step(recording.scan(k))
    with monkeypatch.context() as patch:
        patch.setattr(
            values, "put", lambda group, own, x, unit: put(group, own, spoil(x) if own == name else x, unit)
        )
        slam.save(tmp_path / "a.h5")
    with pytest.raises(InputError):
        HybridSlam.resume(tmp_path / "a.h5")


@pytest.mark.slow
def test_a_map_that_explains_the_first_steps_worse_than_none_is_not_believed(run, screen, recording):
    sheet = of_another_run(run[0].map())
    for off in (0.0, 1.2, 3.0):
        moved = replace(
            sheet.features, position_m=sheet.features.position_m + off * APART[: len(sheet.features)]
        )
        prior = replace(
            sheet, features=moved, surfaces=None, surface_reflection=None, surface_covariance=None
        )
        slam = begun(HybridSlam, screen, recording, prior_map=prior)
        for k in range(16):
            found = slam.step(recording.scan(k))
        bank = slam.state.joint.features
        left = np.isin(bank.identity, np.arange(len(moved)))
        assert np.hypot(*(found.position_m - recording.truth.position_m[15])) < 0.2
        if off:  # gone, or as good as gone
            assert (bank.presence[left] < 0.1).all()
            assert (bank.presence[~left] > 0.5).sum() == 3
        else:
            assert left.all()


def test_nobody_goes_on_from_the_map_of_an_agent_that_was_lost(screen, recording, tmp_path):
    maker = KnownHybridSlam(screen)
    assert len(HybridSlam(screen, prior_map=maker.map()).state.joint.features) == 3
    maker.now = maker.now._replace(believed=replace(maker.state, early=EARLY + 0.01))
    maker.map().save(tmp_path / "map.h5")
    sheet = gs.Map.load(tmp_path / "map.h5")
    assert sheet.lost == "agent1"
    assert str(sheet).endswith("agent1 noticed that it was lost>")
    assert fitted(sheet, screen, "map.h5")[1].endswith(
        "agent1 noticed in the end that it was lost, so nobody goes on from it"
    )
    following = HybridSlam(screen, prior_map=sheet)
    assert len(following.state.joint.features) == 0
    assert not following.map().lost
    with pytest.raises(InputError, match="map 2: found a map of agent1, which noticed in the end"):
        fuse([KnownHybridSlam(screen, seed=1).map(), sheet])
    with pytest.raises(InputError, match="calibrate: map: found a map of agent1, which noticed"):
        calibrate(screen, recording, sheet)


def test_a_lost_agent_leaves_the_map_that_it_began_with_as_it_was(screen):
    first = KnownHybridSlam(screen).map()
    second = HybridSlam(screen, prior_map=first)
    second.now = second.now._replace(believed=replace(second.state, early=EARLY + 0.01))
    sheet = second.map()
    assert not sheet.lost
    third = HybridSlam(screen, prior_map=sheet)
    np.testing.assert_array_equal(third.map().features.position_m, first.features.position_m)
    assert third.map().provenance["agents"] == ["agent1", "agent1"]  # the first and itself


@pytest.mark.slow
def test_scattered_paths_as_strong_as_the_sight_do_not_carry_the_agent_off_at_the_start():
    """Without features for the first steps, the agent is 4.7 m off when particles end."""
    scene = gs.Scene.load("scatter").with_filter(particles=2000)
    recording = gs.simulate(scene, "agent1", 5, what="signal")
    slam = HybridSlam(scene, seed=5, waveform=recording.waveform)
    start = assumed_start(scene, "agent1", 5)
    slam.start_at(start.position_m, start.heading_rad)
    for step in range(16):
        found = slam.step(recording.scan(step))
    assert np.hypot(*(found.position_m - recording.truth.position_m[15])) < 0.7
    state = slam.state
    assert len(state.joint.features) > 5
    assert len(state.before.features) == 0, "they are for the time being"
    assert len(state.segment) == 16
    assert state.next_identity > state.joint.features.identity.max()


@pytest.mark.slow
def test_who_begins_hidden_says_so_until_a_line_of_sight_was_heard(screen, recording):
    """And hears it when it comes, though it never was: its power isn't that of the noise about the start."""
    slam, truth = HybridSlam(screen, seed=1, waveform=recording.waveform), screen.track("agent1")
    first = HIDDEN.start + 20
    shown = HIDDEN.stop - first
    slam.start_at(truth.position_m[first], float(truth.heading_rad[first]))
    scans = list(recording)[first : HIDDEN.stop + 16]
    whole = [slam.step(scan) for scan in scans]
    off = [np.hypot(*(one.position_m - truth.position_m[first + k])) for k, one in enumerate(whole)]
    assert len(slam.map().features)
    assert all(UNSIGHTED in one.health.why for one in whole[SETTLED:shown])
    assert all(one.health.ok for one in whole[-5:])
    assert max(off[-5:]) < 0.2 < max(off[SETTLED:shown])
