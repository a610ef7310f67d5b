"""Paths that a ray tracer lists more than once count once, and no others do."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gridslam as gs
from gridslam.importers.raytracers import TracedPaths, plane_table
from gridslam.importers.repeated_paths import SAME_M, SAME_RAD, repeated
from gridslam.world.radio import SPEED_OF_LIGHT

ALCOVE, SCREEN = gs.Scene.load("alcove"), gs.Scene.load("screen")


def alike(one, other):
    """Whether two paths [length (m), four angles] are the same, number by number."""
    turned = [abs((a - b + np.pi) % (2 * np.pi) - np.pi) for a, b in zip(one[1:], other[1:], strict=True)]
    return abs(one[0] - other[0]) < SAME_M and max(turned) < SAME_RAD


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 9), st.integers(0, 3))
def test_of_paths_that_are_the_same_the_loudest_is_left(seed, count, missing):
    draw = np.random.default_rng(seed)
    path = np.column_stack([draw.choice([4.0, 7.5], count), draw.choice([-1.0, 0.5, np.pi], (count, 4))])
    path[:, 1:] += draw.choice([0.0, 0.2, 3.0], (count, 4), p=[0.8, 0.1, 0.1]) * SAME_RAD
    path[:, 0] += draw.choice([0.0, 0.3, 5.0], count, p=[0.8, 0.1, 0.1]) * SAME_M
    path[:, 1:] += 2 * np.pi * draw.integers(-1, 2, (count, 4))
    path[draw.permutation(count)[: min(missing, count)], 0] = np.nan
    gain, others = draw.choice([1.0, 2.0], count), range(count)
    plain = [
        any(alike(path[k], path[q]) and (gain[q], -q) > (gain[k], -k) for q in others if q != k)
        for k in others
    ]
    found = repeated(path[None, :, 0] / SPEED_OF_LIGHT, [path[None, :, a] for a in range(1, 5)], gain[None])
    np.testing.assert_array_equal(found, [plain])


def test_padding_is_no_path_and_costs_nothing():
    """Of -1 or 0 s, as arrays of other tracers have it: compared pair by pair, it took seconds."""
    padding, angles = np.full((20, 3, 2000), -1.0), [np.zeros((20, 3, 2000))] * 4
    padding[..., 1000:] = 0.0
    assert not repeated(padding, angles, np.ones_like(padding)).any()


def copied(paths, number, **moved):
    """The paths (steps, anchors, L) with one of them once more at the end, moved by so much."""

    def more(name, values):
        return np.concatenate([values, values[..., number : number + 1] + moved.get(name, 0.0)], -1)

    return {name: more(name, values) for name, values in paths.items()}


def on_plane():
    """Four random paths of three steps and the scene's anchors, in the plane."""
    draw, shape = np.random.default_rng(3), (3, len(ALCOVE.anchors), 4)
    level = np.full(shape, np.pi / 2)
    return {
        "delay_s": draw.uniform(3, 9, shape) / SPEED_OF_LIGHT,
        "departure_rad": draw.uniform(-3, 3, shape),
        "arrival_rad": draw.uniform(-3, 3, shape),
        "departure_zenith_rad": level,
        "arrival_zenith_rad": level,
        "gain": np.full(shape, 1e-3),
    }


@pytest.mark.parametrize(
    ("name", "moved", "more"),
    [("delay_s", 3e-6 / SPEED_OF_LIGHT, 0), ("arrival_rad", 3e-4, 0), ("departure_rad", 2 * np.pi, 0),
     ("delay_s", 4e-3 / SPEED_OF_LIGHT, 1), ("departure_rad", 2e-2, 1), ("arrival_rad", 2e-2, 1),
     ("departure_zenith_rad", 5e-3, 1), ("arrival_zenith_rad", 5e-3, 1)],
)  # fmt: skip
def test_tables_hold_a_path_once(name, moved, more):
    paths = on_plane()
    twice = TracedPaths(**copied(paths, 1, **{name: moved}))
    table = plane_table(twice, ALCOVE, 0.0)["distance_m"]
    once = plane_table(TracedPaths(**paths), ALCOVE, 0.0)["distance_m"]
    for anchor, lengths in table.items():
        assert np.isfinite(lengths).sum() == np.isfinite(once[anchor]).sum() + 3 * more
        np.testing.assert_array_equal(lengths[:, :4], once[anchor])


def test_a_faint_copy_hides_no_loud_path():
    paths = on_plane()
    faint = {**paths, "gain": paths["gain"].copy()}
    faint["gain"][..., 1] = 1e-12
    twice = {name: np.concatenate([faint[name], paths[name][..., 1:2]], -1) for name in paths}
    once = plane_table(TracedPaths(**paths), ALCOVE, 0.0)["distance_m"]
    for anchor, lengths in plane_table(TracedPaths(**twice), ALCOVE, 0.0)["distance_m"].items():
        np.testing.assert_array_equal(lengths[:, [0, 4, 2, 3]], once[anchor])
        assert np.isnan(lengths[:, 1]).all()


def traced(paths):
    """The same as Sionna RT gives them, of one anchor."""
    names = {"tau": "delay_s", "phi_t": "departure_rad", "phi_r": "arrival_rad"}
    names |= {"theta_t": "departure_zenith_rad", "theta_r": "arrival_zenith_rad"}
    one = {ours: values[:, :1] for ours, values in paths.items()}
    gain = one["gain"][:, None, :, None]
    columns = {theirs: one[ours] for theirs, ours in names.items()}
    return SimpleNamespace(a=(gain, 0 * gain), valid=np.ones(one["delay_s"].shape, bool), **columns)


def test_samples_hold_a_path_once():
    paths = on_plane()
    whole, twice, others = (
        gs.recording_from_sionna(traced(one), SCREEN, 0.0).samples
        for one in (paths, copied(paths, 1), copied(paths, 1, departure_rad=2e-2))
    )
    np.testing.assert_array_equal(twice, whole)
    assert np.abs(others - whole).max() > 0.1
    risen = gs.recording_from_sionna(traced(copied(paths, 1, arrival_zenith_rad=5e-3)), SCREEN, 0.0).samples
    assert np.abs(risen - whole).max() > 0.1, "over the ceiling, not the floor"
    missing = traced(copied(paths, 1))
    missing.valid[..., 1] = False
    left = gs.recording_from_sionna(missing, SCREEN, 0.0).samples
    np.testing.assert_allclose(left, whole, atol=1e-5)
