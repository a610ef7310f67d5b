"""Walls that are heard too seldom to be told from clutter at once."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of
from scipy.stats import multivariate_normal

import gridslam as gs
from gridslam import reference
from gridslam.errors import InputError
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.amplitudes import detection_table
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.faint_births import borne_out, remember_leftovers, weigh_by_leftovers
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.motion import predict
from gridslam.inference.messages.unexplained import gather_unexplained
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.scans.leftovers import MEMORY, MOST, Leftovers
from gridslam.inference.scans.unexplained import Unexplained
from gridslam.inference.state.rings import Rings
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives import blocks, tables
from gridslam.systems.soundness import require_sound
from gridslam.world.geometry import wrap
from gridslam.world.radio import BINS, REFLECTION_BINS
from gridslam.world.single_bounces import single_bounces

PLACE, POSE = np.array([1.0, 4.0, 0.3, 0.0]), np.array([-2.0, -1.0, 0.8])
LINE = np.array([0.5 * np.pi, 6.0])
ANGLE = np.radians(4.0)


def at(line, pose, place=PLACE):
    return single_bounces(line, place, pose).value


def borne(line, scan, left, state, model, m=0):
    gain, seen = borne_out(np.array([line]), scan, np.array([m], np.int32), state, left, model.radio, model)
    return gain[0], int(seen[0])


def scene_of(left, spread=1e-8):
    """A model, a state and a scan with one faint measurement of the line, after these leftovers."""
    model = model_of("room", [PLACE[:3], [-3.0, -2.0, 0.0]])
    belief = Belief(np.array([*POSE[:2], 0, 0, POSE[2]]), np.diag(np.full(5, spread)))
    state = replace(state_of(belief, 2), leftovers=left)
    std = np.array([[0.05, ANGLE, ANGLE]])
    scan = AnchorScan.of(0, PLACE[:2], PLACE[2], at(LINE, POSE)[None], std, np.array([2.4]))
    return model, state, scan


def left_over(back, value, steps, amplitude=2.2):
    rows = len(back)
    return Leftovers(
        np.tile(POSE, (steps, 1)), np.tile(1e-10 * np.eye(3), (steps, 1, 1)), np.array(back, np.int64),
        np.zeros(rows, np.int64), np.reshape(value, (-1, 3)), np.tile([0.05, ANGLE, ANGLE], (rows, 1)),
        np.full(rows, amplitude),
    )  # fmt: skip


def test_one_earlier_measurement_counts_as_worked_out_by_hand():
    value = at(LINE, POSE) + np.array([0.06, 0.03, -0.05])
    model, state, scan = scene_of(left_over([1], value, 2))
    gain, seen = borne(LINE, scan, state.leftovers, state, model)
    assert seen == 1
    # the same line, measured twice: what one measurement of three numbers leaves open of two
    noise = np.diag(np.square([0.05, ANGLE, ANGLE]))
    slope, _ = single_bounces(LINE, PLACE, POSE).slopes()
    covariance = np.linalg.inv(slope.T @ np.linalg.inv(noise) @ slope)
    density = multivariate_normal(at(LINE, POSE), slope @ covariance @ slope.T + noise).pdf(value)
    radio, level = model.radio, model.radio.amplitude(at(LINE, POSE)[0], REFLECTION_BINS)
    clutter = np.exp(radio.log_clutter(2.2)) * radio.false_alarms
    ratio = np.exp(radio.log_rician(2.2, level)) * density / clutter
    missed = 1 - radio.detection_probability(level)
    other = radio.detection_probability(
        radio.amplitude(at(LINE, POSE, np.array([-3.0, -2.0, 0.0, 0.0]))[0], REFLECTION_BINS)
    )
    silent = 0.5 + 0.5 * (1 - other) ** 2  # the second anchor heard nothing twice, or can't hear it
    np.testing.assert_allclose(gain, 0.5 * missed * ratio * silent, rtol=2e-3, atol=1e-4)


def test_lines_are_borne_out_as_by_the_plain_twin():
    draw, steps, rows = np.random.default_rng(5), 12, 40
    model, state, _ = scene_of(None, 1e-4)
    pose = POSE + draw.normal(0, [0.4, 0.4, 0.2], (steps, 3))
    root = draw.normal(0, 0.01, (steps, 3, 3))
    lines = LINE + draw.normal(0, [0.1, 0.3], (6, 2))
    back, anchor = np.sort(draw.integers(0, steps, rows)), draw.integers(0, 2, rows)
    of = draw.integers(0, len(lines), rows)
    value = single_bounces(lines[of], model.places[anchor], pose[back]).value
    std = np.full((rows, 3), [0.1, 0.06, 0.06])
    value = value + std * draw.standard_normal((rows, 3))
    left = Leftovers(
        pose, root @ root.transpose(0, 2, 1), back, anchor, value, std,
        draw.uniform(1.8, 4.0, rows),
    )  # fmt: skip
    scan = AnchorScan.of(
        1, model.places[1, :2], model.places[1, 2], single_bounces(lines, model.places[1], POSE).value,
        np.tile([0.05, ANGLE, ANGLE], (len(lines), 1)), np.full(len(lines), 2.4),
    )  # fmt: skip
    order = draw.permutation(len(lines)).astype(np.int32)
    gain, seen = borne_out(lines[order], scan, order, state, left, model.radio, model)
    table, belief = detection_table(model.radio), state.belief
    expected = reference.bear_out(
        1, table.step, table.chance, blocks.Belief(belief.mean, belief.covariance),
        blocks.Anchors(model.places, model.radio.numbers), scan.table,
        blocks.Left(pose, left.covariance, left.begin, left.rows),
        blocks.Borne(lines[order], order, gain, seen, np.zeros((4, 2, BINS))),
    )  # fmt: skip
    np.testing.assert_allclose(gain, expected[0], rtol=1e-5, atol=1e-12)
    np.testing.assert_array_equal(seen, expected[1])
    assert gain.max() > 1
    with pytest.raises(ValueError, match="doesn't exist"):
        borne_out(lines, scan, order + 1, state, left, model.radio, model)


def test_what_leftovers_bear_out_is_in_new_ratios_and_the_old_ones_are_left_alone():
    model, state, scan = scene_of(left_over([1, 2], np.tile(at(LINE, POSE), (2, 1)), 3))
    measured = np.zeros((tables.MEASURED_ROWS, 1))
    measured[tables.NEW] = 1.5
    old = LikelihoodRatios(None, None, np.zeros((tables.ODDS, 0)), np.zeros((5, 0, 1)), measured)
    nobody = np.full((1, 2), -1, np.int32)
    births = Births(np.zeros(1, np.int32), nobody, LINE[None], np.array([0.5]), np.zeros(1, np.int32))
    for array in (measured, births.ratio, births.line):
        array.setflags(write=False)
    found, ratios = weigh_by_leftovers(births, state, scan, old, model.radio, model)
    assert old.new[0] == 1.5
    assert births.ratio[0] == 0.5
    assert found.ratio[0] > 5.0, "an earlier measurement bears it out"
    assert found.seen[0] == 2
    assert ratios.new[0] == pytest.approx(1.5 + found.ratio[0] - 0.5)
    same = weigh_by_leftovers(births, replace(state, leftovers=None), scan, old, model.radio, model)
    assert same == (births, old)
    over = replace(births, hit=np.array([[3, -1]], np.int32))  # a double bounce, by a known surface
    assert weigh_by_leftovers(over, state, scan, old, model.radio, model) == (over, old)


def test_what_a_path_or_a_birth_explains_is_neither_left_over_nor_unexplained():
    model, state, heard = scene_of(Leftovers.none())
    state, work = replace(state, unexplained=Unexplained.none()), Workspace(model, 1, grid=False)
    value = at(LINE, POSE) + np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]])
    scans = [AnchorScan.of(0, PLACE[:2], PLACE[2], value, np.tile(heard.own_std, (3, 1)), np.full(3, 2.4))]
    free = np.array([True, False, True])
    left = remember_leftovers(state, scans, free, model, work=work).leftovers
    np.testing.assert_array_equal(left.value, value[free])
    unexplained = gather_unexplained(state, scans, free, model, work=work).unexplained
    np.testing.assert_array_equal(unexplained.value, value[free][:, ::2])


def test_silence_and_strangers_tell_nothing_for_a_line():
    nothing = left_over([], np.zeros((0, 3)), 20)
    model, state, scan = scene_of(nothing)
    gain, seen = borne(LINE, scan, nothing, state, model)
    assert seen == 0
    np.testing.assert_array_equal(gain, 0)
    strangers = left_over([3, 4], at(LINE, POSE) + np.array([[0.55, 0, 0], [0, 0.5, -0.5]]), 20)
    few = borne(LINE, scan, strangers, state, model)[0]
    again = left_over([3, 4], np.tile(at(LINE, POSE), (2, 1)), 20)
    many = borne(LINE, scan, again, state, model)[0]
    assert few.max() < 1e-3 * many.max()
    value = at(LINE, POSE) + np.array([[0, 0, 0], [0, 0.7, -0.7]])
    mixed, alone = left_over([3, 3], value, 20), left_over([3], value[:1], 20)
    mixed, alone = (borne(LINE, scan, some, state, model)[0] for some in (mixed, alone))
    assert alone.max() > 0
    np.testing.assert_array_equal(mixed, alone, "one of the step that fits counts, whatever else was heard")


def test_leftovers_are_forgotten_by_age_and_by_number():
    left = Leftovers.none()
    for step in range(MEMORY + 40):
        rows = 20 if step > MEMORY else 1
        left = left.joined(
            np.full(3, float(step)), np.eye(3), np.zeros(rows, np.int64), np.full((rows, 3), float(step)),
            np.ones((rows, 3)), np.ones(rows),
        )  # fmt: skip
        assert len(left.pose) == min(step + 1, MEMORY)
        assert len(left) <= MOST
        np.testing.assert_array_equal(left.pose[left.back, 0], left.value[:, 0])
    assert left.back.max() < MEMORY


def test_leftovers_of_a_checkpoint_stand_in_the_order_of_their_steps():
    """Kernels find a step's rows by where they begin."""
    model, state, _ = scene_of(left_over([0, 1, 3], np.ones((3, 3)), 20))
    require_sound(state, model, "here.h5")
    turned = replace(state, leftovers=replace(state.leftovers, back=state.leftovers.back[::-1]))
    with pytest.raises(InputError, match=r"here\.h5/leftovers/back: .*latest step first"):
        require_sound(turned, model, "here.h5")


def test_a_faint_surface_has_as_many_chances_to_be_confirmed_as_a_loud_one():
    model, state, _ = scene_of(None)
    belief = Belief(np.array([*state.belief.mean, *LINE]), 1e-6 * np.eye(7))
    state = replace(state_of(belief, 2), time_s=0.0)
    for coefficient in (BINS - 1, 1):
        reflection = np.eye(BINS)[[coefficient]]
        bank = replace(state.surfaces, reflection=reflection)
        moved = predict(replace(state, surfaces=bank), 1.0, 0, model)
        level = model.radio.amplitude(
            [at(LINE, POSE, p)[0] for p in model.places], REFLECTION_BINS[coefficient]
        )
        chance = model.radio.detection_probability(np.asarray(level)).max()
        assert moved.surfaces.age[0] == pytest.approx(chance, abs=2e-3)
        assert chance > 0.95 or (coefficient == 1 and chance < 0.1)
        own = predict(replace(state, surfaces=bank, rings=Rings.empty()), 1.0, 0, model)
        assert own.surfaces.age[0] == 1.0, "virtual anchors learn no coefficient"
    often = replace(state.surfaces, seen=np.array([8]), reflection=np.eye(BINS)[[0]])
    assert predict(replace(state, surfaces=often), 1.0, 0, model).surfaces.age[0] == 1.0


@pytest.mark.slow
def test_walls_heard_once_in_ten_steps_are_mapped_and_clutter_is_not():
    scene = gs.Scene.load("room")
    agent = scene.agents[0].model_copy(update={"steps": 120})
    faint = scene.model_copy(update={"materials": {"concrete": 0.17}, "agents": (agent,)})
    slam = gs.GridSlam(faint, seed=2)
    for scan in gs.simulate(faint, "agent1", seed=2):
        slam.step(scan)
    best = slam.population.best
    often = best.belief.lines[(best.surfaces.existence > 0.5) & (best.surfaces.seen >= 5)]
    walls = np.array([[0, 4.0], [np.pi, 4.0], [0.5 * np.pi, 3.0], [-0.5 * np.pi, 3.0]])
    turn = np.abs(wrap(often[:, None, 0] - walls[:, 0]))
    same = (turn < 0.1) & (np.abs(often[:, None, 1] - walls[:, 1]) < 0.2)
    assert same.any(1).all(), "nothing else is seen so often"
    assert same.any(0).sum() >= 3, "one of four without what was left over before"
