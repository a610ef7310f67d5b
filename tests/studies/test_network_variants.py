"""The four variants hear the same: only what the filter is told of clocks and labels differs."""

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.errors import InputError
from gridslam.studies.network_variants import VARIANTS, medians, run_variants, variant_of

AGENTS = ["agent1", "agent2"]


@pytest.fixture(scope="module")
def scene():
    return short("exchange", 6, particles=500)


def test_variants_differ_in_clocks_and_labels_alone(scene):
    variants = {name: variant_of(scene, AGENTS, 3, name) for name in VARIANTS}
    (_, free, truth), (labelled_scene, tied, other) = (variants[name] for name in list(VARIANTS)[:2])
    np.testing.assert_array_equal(free.table.aoa_rad, tied.table.aoa_rad)
    true = truth.source >= 0
    np.testing.assert_array_equal(truth.source, other.source)
    bias = truth.clocks.metres(truth.clocks.device)[free.table.step[true], truth.source[true]]
    np.testing.assert_allclose(free.table.distance_m[true] - bias, tied.table.distance_m[true], atol=1e-9)
    assert not other.clocks.metres(("A", "B", "C", "D")).any()
    assert (free.table.anchor == -1).all()
    labelled, (_, named, _) = variants["unsynchronised, labelled"][0], variants["unsynchronised, labelled"]
    assert (named.table.anchor >= 0).all()
    assert labelled.radio.false_alarms == scene.radio.false_alarms / 4
    assert all(anchor.clock.prior_ns == 0 for anchor in labelled_scene.anchors)


@pytest.mark.slow
def test_runs_are_paired_and_summed_up(scene):
    runs = run_variants(scene, AGENTS, [1], list(VARIANTS)[:2])
    assert [run.seed for run in runs] == [1, 1]
    table = medians(runs)
    assert table["synchronised, unlabelled"].position_bound_m < runs[0].position_bound_m
    assert all(run.position_rmse_m < 3 * run.position_bound_m for run in table.values())


@pytest.mark.slow
def test_the_published_method_runs_in_all_of_them(scene):
    whole = scene.model_dump(exclude_none=True)
    for agent in whole["agents"]:
        agent["steps"] = 2
    runs = run_variants(gs.Scene.checked(whole, "short"), AGENTS[:1], [1], method="network-paper")
    assert [run.variant for run in runs] == list(VARIANTS)
    assert all(run.position_rmse_m < 2 for run in runs)
    assert all(run.label_errors == 0 for run in runs if run.variant.endswith(", labelled"))


def test_what_is_no_variant_is_refused(scene):
    with pytest.raises(InputError, match="variant: found 'best'"):
        variant_of(scene, AGENTS, 1, "best")
    with pytest.raises(InputError, match="room: clocks: found none"):
        variant_of(gs.Scene.load("room"), ["agent1"], 1, next(iter(VARIANTS)))
