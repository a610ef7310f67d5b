"""Where surfaces were hit, and that the ends of their stretches follow what is learned of their lines."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gridslam import runtime
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.particles import at_mean
from gridslam.inference.management.merging import merge
from gridslam.inference.messages.detections import mark_detections
from gridslam.inference.state.polylines import draw_paths
from gridslam.inference.state.rays import Rays
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.geometry import mirror, unit

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
ANCHOR = np.array([[0.0, 0.0, 0.0]])
WALL = (0.5 * np.pi, 1.0)  # y = 1; its tangent points to negative x
SINGLE = Rays.of(0, 1, 0, 0, np.ones(1), np.ones(1))


def at(state, agent, *lines):
    """The state with the agent there, and with these lines."""
    mean = np.concatenate([agent, np.zeros(3), np.ravel(lines)])
    return replace(state, belief=Belief(mean, 1e-4 * np.eye(len(mean))))


def marked(state, rays=SINGLE, share=0.9):
    """The state after its anchor's rays were heard with this probability."""
    model = model_of(anchors=ANCHOR)
    return mark_detections(
        state, rays, np.full(len(rays), share), model, work=Workspace(model, 1, grid=False)
    )


def one_wall():
    return state_of(Belief(np.concatenate([np.zeros(5), WALL]), np.eye(7)))


def bounce_off(line, anchor, agent):
    """Where along a line a path is reflected off it, by the anchor's image."""
    image, normal = mirror(np.asarray(line), anchor), unit(line[0])
    share = (line[1] - image @ normal) / ((agent - image) @ normal)
    return (image + share * (agent - image)) @ unit(line[0] + 0.5 * np.pi)


def test_ends_of_a_stretch_follow_the_line():
    first, second = np.array([4.0, 0.0]), np.array([2.0, -1.0])
    state = marked(at(one_wall(), first, WALL))
    np.testing.assert_allclose(state.surfaces.extent, [[-2, -2]], atol=1e-6)  # half way
    state = marked(at(state, second, WALL))
    np.testing.assert_allclose(state.surfaces.extent, [[-2, -2 / 3]], atol=1e-6)
    turned = (WALL[0] + 0.1, 1.05)
    moved = marked(at(state, [9.0, 9.0], turned), share=0.4)  # not heard again
    ends = [bounce_off(turned, ANCHOR[0, :2], agent) for agent in (first, second)]
    np.testing.assert_allclose(moved.surfaces.extent, [ends], atol=1e-6)
    assert ends[0] > -1.7, "a tenth of a radian is 0.3 m here"
    assert (moved.surfaces.seen, moved.surfaces.foot) == (state.surfaces.seen, state.surfaces.foot)
    np.testing.assert_allclose(state.surfaces.extent, [[-2, -2 / 3]], atol=1e-6)  # a value


def test_a_poor_first_line_leaves_no_wall_where_none_was_hit():
    """The line is born turned; the hit that was put far off comes back as the line is learned."""
    state = marked(at(one_wall(), [4.0, 0.0], (WALL[0] + 0.25, 1.0)))
    assert state.surfaces.extent[0, 1] > -1.4
    state = marked(at(state, [3.9, 0.0], WALL))
    np.testing.assert_allclose(state.surfaces.extent, [[-2, -1.95]], atol=1e-6)


def test_what_another_agent_left_stays():
    state = one_wall()
    state = replace(state, surfaces=replace(state.surfaces, extent=np.array([[-2.5, 3.0]])))
    state = marked(at(state, [8.0, 0.0], WALL))
    np.testing.assert_allclose(state.surfaces.extent, [[-4, 3]], atol=1e-6)
    turned = (WALL[0] - 0.1, 1.0)
    moved = marked(at(state, [8.0, 0.0], turned), share=0.1)
    end = bounce_off(turned, ANCHOR[0, :2], np.array([8.0, 0.0]))
    np.testing.assert_allclose(moved.surfaces.extent, [[end, 3.0]], atol=1e-6)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_single_and_double_bounces_hit_where_they_are_drawn(seed):
    draw = np.random.default_rng(seed)
    lines = np.column_stack([draw.uniform(-3, 3, 2), draw.uniform(2, 6, 2)])
    agent, last = draw.uniform(-2, 2, 2), int(draw.integers(2))
    first = 1 - last if draw.random() < 0.7 else last
    rays = Rays.of(0, 1 + (first != last), last, first, np.ones(1), np.ones(1))
    state = at(state_of(Belief(np.zeros(9), np.eye(9))), agent, lines)
    drawn = draw_paths(rays, at_mean(state.belief), model_of(anchors=ANCHOR).places)
    assume(drawn.seen[0, 1] == 1)  # it is possible
    bank = marked(state, rays).surfaces
    met = sorted({last, first})
    np.testing.assert_allclose(bank.extent[met], np.repeat(bank.foot[met, None], 2, 1), atol=1e-4)
    assert np.isnan(np.delete(bank.extent, met, 0)).all()


def test_of_two_that_are_one_the_outermost_hits_are_kept():
    mean = np.concatenate([np.zeros(5), WALL, WALL])
    state = state_of(Belief(mean, 1e-4 * np.eye(9)))
    marks = np.repeat([[1.0, 2.0], [3.0, 4.0]], 4, 1)
    for extent, kept in (
        ([[-3, -1], [0, 2]], (1, 4)),
        ([[0, 2], [-3, -1]], (3, 2)),
        ([[np.nan, np.nan], [-3, -1]], (3, 4)),
    ):
        bank = replace(state.surfaces, extent=np.array(extent, float), outermost=marks)
        (merged, _) = merge(bank, state.belief)
        assert merged.extent.tolist() == [[np.nanmin(extent), np.nanmax(extent)]]
        assert merged.outermost.tolist() == [[kept[0]] * 4 + [kept[1]] * 4]
