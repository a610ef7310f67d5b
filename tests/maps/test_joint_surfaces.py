"""What one agent's surfaces have in common: in a map's file, in fusion, in what the next agent believes."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from map_samples import random_map, surfaces

from gridslam.errors import InputError
from gridslam.inference.beliefs.belief import Belief, keep, lines_covariance
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.state import State
from gridslam.maps.fusion import fuse
from gridslam.maps.line_fusion import JointLines
from gridslam.maps.map import Map
from gridslam.maps.map_cells import blocks_of, joint_of
from gridslam.systems.front import inherit_surfaces
from gridslam.world.network_scene import network_model
from gridslam.world.scene import Scene

LINES = ((0.3, 2.0), (-2.0, 1.0), (1.9, 3.0))


def drawn(seed, count, size=0.02):
    """A random covariance of `count` lines, whose correlations are anything."""
    root = np.random.default_rng(seed).normal(size=(2 * count, 2 * count)) * size
    return root @ root.T + 1e-8 * np.eye(2 * count)


def mapped(seed, lines=LINES, joint=None):
    """A map whose surfaces are correlated."""
    joint = drawn(seed, len(lines)) if joint is None else joint
    table = replace(surfaces(lines), line_cov=blocks_of(joint))
    base = Map.blank((-5, -5), 1.0, (10, 10), 0.1)
    return replace(base, surfaces=table, surface_covariance=joint, provenance={"seeds": [seed]})


def test_blocks_and_joint_are_inverses():
    own = blocks_of(drawn(1, 4))
    np.testing.assert_array_equal(blocks_of(joint_of(own)), own)
    assert np.count_nonzero(joint_of(own)) == own.size


def test_the_joint_covariance_comes_back_from_a_file_and_older_files_have_none(tmp_path):
    mapped(1).save(tmp_path / "map.h5")
    np.testing.assert_array_equal(Map.load(tmp_path / "map.h5").surface_covariance, drawn(1, 3))
    with h5py.File(tmp_path / "map.h5", "a") as file:
        del file["surfaces/joint_covariance"]
    assert Map.load(tmp_path / "map.h5").surface_covariance is None
    random_map(1).save(tmp_path / "map.h5")
    assert Map.load(tmp_path / "map.h5").surface_covariance is None


def spoilt(number):
    joint = drawn(1, 3)
    if number == 0:
        joint[0, 5] += 1e-3  # not symmetric
    elif number == 1:
        joint[0, 2] = joint[2, 0] = 2 * np.sqrt(joint[0, 0] * joint[2, 2])
    elif number == 2:
        joint = joint[:4, :4]
    elif number == 3:
        joint[1, 4] = joint[4, 1] = np.nan
    else:
        joint *= 2  # of other surfaces
    return joint


WRONG = ("not symmetric", "not positive definite", r"\(4, 4\)", "NaN or infinity", "blocks")


@pytest.mark.slow
@pytest.mark.parametrize(("number", "why"), list(enumerate(WRONG)))
def test_a_joint_covariance_that_cannot_be_is_refused_in_one_line(tmp_path, number, why):
    mapped(1).save(tmp_path / "map.h5")
    with h5py.File(tmp_path / "map.h5", "a") as file:
        del file["surfaces/joint_covariance"]
        file["surfaces/joint_covariance"] = spoilt(number)
    with pytest.raises(InputError, match=why if number != 2 else "joint_covariance") as caught:
        Map.load(tmp_path / "map.h5")
    assert "map.h5" in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=why):
        replace(mapped(1), surface_covariance=spoilt(number))


@given(seed=st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_fusion_is_the_product_of_joint_gaussians(seed):
    draw = np.random.default_rng(seed)
    truth = np.array(LINES)
    joints = [drawn(seed + n, 3, 0.005) for n in (1, 2)]
    means = [truth + (np.linalg.cholesky(joint) @ draw.normal(size=6)).reshape(3, 2) for joint in joints]
    # walls 0 and 1 are in both maps, in another order; wall 2 of either is its own
    spread = np.zeros((12, 12))
    spread[:6, :6], spread[6:, 6:] = joints
    which = np.zeros((12, 8))  # of each estimate: which of 4 walls
    for row, wall in enumerate((0, 1, 2, 1, 0, 3)):
        which[2 * row : 2 * row + 2, 2 * wall : 2 * wall + 2] = np.eye(2)
    swapped = np.concatenate([means[0], means[1][[1, 0, 2]]])
    order = np.r_[0:6, 8:10, 6:8, 10:12]
    spread = spread[np.ix_(order, order)]
    inverse = np.linalg.inv(spread)
    cov = np.linalg.inv(which.T @ inverse @ which)
    mean = cov @ which.T @ inverse @ swapped.reshape(-1)
    lines, moved = JointLines(swapped, spread).united([[0, 4], [1, 3], [2], [5]])
    std = np.sqrt(np.diag(cov))
    np.testing.assert_allclose((lines.line.reshape(-1) - mean) / std, 0, atol=2e-3)
    np.testing.assert_allclose(lines.covariance / np.outer(std, std), cov / np.outer(std, std), atol=2e-3)
    assert moved.all()  # walls of one map alone follow by their correlation


def test_fused_map_keeps_what_its_surfaces_have_in_common_whatever_the_order_and_the_normals():
    joint = drawn(5, 3, 0.01)
    first = mapped(5, joint=joint)
    sign = np.array([1.0, -1, 1, 1, 1, 1])
    other = ((LINES[0][0] + np.pi, -LINES[0][1]), (0.9, 4.0), (-0.7, 2.5))
    second = mapped(6, other, drawn(6, 3, 0.01) * np.outer(sign, sign))
    fused, again = (fuse(maps, same_frame=True) for maps in ([first, second], [second, first]))
    np.testing.assert_array_equal(fused.surface_covariance, again.surface_covariance)
    assert len(fused.surfaces) == 5
    np.testing.assert_allclose(blocks_of(fused.surface_covariance), fused.surfaces.line_cov)
    row = int(np.abs(fused.surfaces.line - LINES[1]).sum(1).argmin())
    assert np.linalg.det(fused.surfaces.line_cov[row]) < np.linalg.det(first.surfaces.line_cov[1])
    assert fuse([replace(first, surface_covariance=None)], same_frame=True).surface_covariance is None
    np.testing.assert_array_equal(fuse([first]).surface_covariance, joint)


def test_lines_are_told_with_offsets_above_zero_and_so_is_their_covariance():
    joint = drawn(2, 3)
    size = np.zeros((11, 11))
    size[:5, :5], size[5:, 5:] = np.eye(5), joint
    belief = Belief(np.array([0, 0, 0, 0, 0, 0.3, 2.0, 1.0, -1.0, -1.0, -3.0]), size)
    chosen = np.array([True, False, True])
    sign = np.array([1.0, 1, 1, -1])
    expected = keep(belief, chosen).covariance[5:, 5:] * np.outer(sign, sign)
    np.testing.assert_array_equal(lines_covariance(belief, chosen), expected)


def test_the_next_agent_believes_what_the_surfaces_have_in_common():
    scene = Scene.load("exchange")
    one = State.start(scene.filter_model("agent1"))
    several = NetworkState.start(network_model(scene, ["agent1", "agent2"]))
    for state in (one, several):
        begun, alone = (
            inherit_surfaces(state, grid).belief
            for grid in (mapped(3), replace(mapped(3), surface_covariance=None))
        )
        rows = begun.layout.lines
        np.testing.assert_array_equal(begun.covariance[rows, rows], drawn(3, 3))
        assert not begun.covariance[: rows.start, rows].any()
        np.testing.assert_array_equal(blocks_of(alone.covariance[rows, rows]), blocks_of(drawn(3, 3)))
        assert np.count_nonzero(alone.covariance[rows, rows]) == 12
