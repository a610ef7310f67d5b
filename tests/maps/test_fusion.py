"""Fusion of maps: sums of evidence, merged surfaces, and maps that don't belong together."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from map_samples import assert_same, random_map, surfaces

from gridslam.errors import InputError
from gridslam.estimate_tables import SurfaceEstimate, SurfaceStretches
from gridslam.maps.fusion import fuse
from gridslam.maps.map import Map


@given(seeds=st.lists(st.integers(0, 10**6), min_size=2, max_size=3, unique=True), order=st.randoms())
@settings(max_examples=20, deadline=None)
def test_fusion_does_not_depend_on_the_order(seeds, order):
    maps = [random_map(seed, lines=((0.3 + 0.01 * i, 2.0), (-2.0, 1.0 + i))) for i, seed in enumerate(seeds)]
    first = fuse(maps, same_frame=True)
    order.shuffle(maps)
    second = fuse(maps, same_frame=True)
    assert_same(first, second)
    assert first.provenance == second.provenance


@example(evidence=np.ones((2, 2, 3), np.float32))  # alike, but elsewhere
@given(evidence=arrays(np.float32, (2, 2, 3), elements=st.floats(-10, 10, width=32, allow_subnormal=False)))
@settings(max_examples=20, deadline=None)
def test_fused_evidence_is_the_sum_where_maps_overlap(evidence):
    maps = [
        replace(Map.blank((x, 0), 0.5, (2, 3), 0.05), evidence=values, observed=np.ones((2, 3)))
        for x, values in zip((0.0, 0.5), evidence, strict=True)
    ]
    fused = fuse(maps, same_frame=True)
    assert fused.shape == (2, 4)
    np.testing.assert_allclose(fused.evidence[:, 1:3], evidence[0][:, 1:] + evidence[1][:, :2], rtol=1e-6)
    np.testing.assert_array_equal(fused.evidence[:, 0], evidence[0][:, 0])


def fused_surfaces(first, second):
    base = Map.blank((0, 0), 1.0, (10, 10), 0.1)
    return fuse([replace(base, surfaces=first), replace(base, surfaces=second)], same_frame=True).surfaces


def test_wall_seen_by_both_agents_is_one_sharper_wall():
    merged = fused_surfaces(surfaces([(0.5, 6.0)], extent=(-1, 1)), surfaces([(0.502, 6.01)], extent=(0, 3)))
    assert len(merged) == 1
    assert merged.existence[0] == pytest.approx(0.99)
    np.testing.assert_allclose(merged.line[0], [0.501, 6.005], atol=2e-3)
    np.testing.assert_allclose(merged.line_cov[0], np.diag([0.01**2, 0.02**2]) / 2, atol=1e-8)
    np.testing.assert_allclose(merged.extent_m[0], [-1, 3], atol=0.02)
    np.testing.assert_allclose(
        merged.sfv_m[0], 2 * 6.005 * np.array([np.cos(0.501), np.sin(0.501)]), atol=0.04
    )


def test_a_door_that_one_map_has_stays_open_and_what_another_knows_whole_is_closed():
    base, line = Map.blank((0, 0), 1.0, (20, 20), 0.1), surfaces([(0.5, 6.0)], extent=(0, 5))
    rows = np.zeros(2, np.int64)
    doors = replace(base, surfaces=line, stretches=SurfaceStretches(rows, np.array([[0.0, 2.0], [3.0, 5.0]])))
    more = replace(base, surfaces=surfaces([(0.5 - np.pi, -6.0)], extent=(-8, -4)))
    both = fuse([doors, more], same_frame=True)
    np.testing.assert_allclose(both.stretches.extent_m, [[0, 2], [3, 8]], atol=1e-6)
    assert fuse([more], same_frame=True).stretches is None
    whole = replace(doors, stretches=None)
    np.testing.assert_allclose(fuse([doors, whole], same_frame=True).stretches.extent_m, [[0, 5]], atol=1e-6)


def test_same_line_written_with_the_opposite_normal_merges():
    merged = fused_surfaces(surfaces([(0.5, 6.0)]), surfaces([(0.5 - np.pi, -6.0)], extent=(-2, 1)))
    assert len(merged) == 1
    np.testing.assert_allclose(merged.line[0], [0.5, 6.0], atol=1e-9)
    np.testing.assert_allclose(merged.extent_m[0], [-1, 2], atol=1e-9)


@pytest.mark.parametrize(
    ("lines", "opposite"),
    [
        (((0.5, 130.0), (0.5003, 130.01)), False),
        (((2.2, 0.01), (2.2003, -0.03)), True),
        (((2.2, 0.2), (2.2003, -0.01)), True),
        (((2.2, 0.01), (2.2003, 0.03)), False),
    ],
)
def test_correlated_lines_fuse_as_gaussians_wherever_the_map_lies(lines, opposite):
    means = np.array(lines)
    covs = np.array([[[4e-4, 3e-3], [3e-3, 4e-2]], [[9e-4, -2e-3], [-2e-3, 9e-3]]])
    information = np.linalg.inv(covs)
    cov = np.linalg.inv(information.sum(axis=0))
    mean = cov @ np.einsum("sij,sj->i", information, means)
    if mean[1] < 0:  # written with the other normal
        mean, cov = np.array([mean[0] - np.pi, -mean[1]]), cov * [[1, -1], [-1, 1]]
    one = np.array([1.0])
    maps = []
    for line, spread in zip(means, covs, strict=True):
        if opposite and line[1] < 0:
            line, spread = np.array([line[0] - np.pi, -line[1]]), spread * [[1, -1], [-1, 1]]
        table = SurfaceEstimate.from_lines(line[None], spread[None], one, one, one)
        maps.append(replace(Map.blank((110, 60), 1.0, (10, 10), 0.1), surfaces=table))
    merged = fuse(maps, same_frame=True).surfaces
    assert len(merged) == 1
    std = np.sqrt(np.diag(cov))
    np.testing.assert_allclose((merged.line[0] - mean) / std, 0, atol=0.04)
    np.testing.assert_allclose(merged.line_cov[0] / np.outer(std, std), cov / np.outer(std, std), atol=0.05)


@pytest.mark.parametrize(
    ("line", "std"), [((0.5, 6.6), (0.5, 5.0)), ((0.5, 6.3), (0.01, 0.02)), ((2.1, 6.0), (3.0, 5.0))]
)
def test_different_walls_stay_apart(line, std):
    assert len(fused_surfaces(surfaces([(0.5, 6.0)], std), surfaces([line], std))) == 2


def test_surfaces_of_one_map_are_never_merged_with_each_other():
    assert len(fused_surfaces(surfaces([(0.5, 6.0), (0.5, 6.001)]), surfaces([(1.5, 3.0)]))) == 3


def test_map_and_its_successor_would_count_evidence_twice():
    first = random_map(1)
    second = replace(first, provenance={"agents": ["a", "b"], "seeds": [1, 2], "steps": [7, 9]})
    with pytest.raises(InputError, match="independent"):
        fuse([second, first], same_frame=True)


def test_maps_that_do_not_belong_together_are_refused():
    grid = Map.blank((0, 0), 0.1, (4, 4), 0.01)
    with pytest.raises(InputError, match="mean free path"):
        fuse([grid, replace(grid, prior=0.02)], same_frame=True)
    with pytest.raises(InputError, match="cells together"):
        fuse([grid, replace(grid, origin_m=[1e6, 0])], same_frame=True)
    with pytest.raises(InputError, match="no map"):
        fuse([])


def stamped_map(seed, anchors, **more):
    places = {"A": (0.0, 0.0), "B": (5.0, 0.0), "C": (5.0, 5.0), "D": (0.0, 5.0)}
    x, y = zip(*(places[name] for name in anchors), strict=True)
    marks = {"anchors": list(anchors), "anchor_x_m": list(x), "anchor_y_m": list(y), **more}
    return replace(random_map(seed), provenance=marks)


def test_maps_of_one_frame_are_linked_by_anchors_directly_or_by_way_of_others():
    ab, cd, bc = (stamped_map(seed, names) for seed, names in enumerate(("AB", "CD", "BC")))
    assert fuse([ab, cd, bc]).shape == ab.shape
    with pytest.raises(InputError, match=r"fuse: frame of cd.h5: found anchors C, D, none of those of ab.h5"):
        fuse([ab, cd], names=["ab.h5", "cd.h5"])
    assert fuse([ab, cd], same_frame=True).shape == ab.shape
    named = [replace(one, provenance={**one.provenance, "frame": "east"}) for one in (ab, cd)]
    assert fuse(named).provenance["frame"] == "east"


@pytest.mark.parametrize(
    ("first", "second", "shared"),
    [
        (["11112222"], ["11112222"], True),
        (["11112222"], ["1111222233334444"], True),  # some steps later
        (["11112222"], ["99998888", "11112222"], True),  # handed over
        (["11112222"], ["11113333"], False),
        ([""], [""], False),  # of earlier versions: nothing known
        (["11112222"], [""], False),
    ],
)
def test_run_that_is_in_two_maps_is_refused(first, second, shared):
    maps = [
        stamped_map(
            n, "AB", runs=runs, **{key: [n] * len(runs) for key in ("seeds", "steps")}, agents=["x"] * 2
        )
        for n, runs in enumerate((first, second))
    ]
    for pair in (maps, maps[::-1]):
        if not shared:
            assert len(fuse(pair).provenance["runs"]) == len(first + second)
            continue
        with pytest.raises(InputError, match="x's run 11112222") as refused:
            fuse(pair)
        assert "\n" not in str(refused.value)


def test_equal_maps_of_earlier_versions_are_refused():
    grid = random_map(3)
    with pytest.raises(InputError, match="map 1 and map 2, both with the evidence of the same measurements"):
        fuse([grid, grid], same_frame=True)
