"""GOSPA of images: what counts as found, missed and false."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.estimate_tables import PathEstimate, SurfaceEstimate
from gridslam.estimates import Estimate
from gridslam.evaluation.image_truth import image_gospa
from gridslam.world.scan import Scan

STEPS = 6


@pytest.fixture(scope="module")
def world():
    scene = short("overlap", STEPS)
    return scene, gs.ground_truth(scene, "agent1")


def believing(scene, truth, step, shift=0.0, without=(), ghost=False):
    """An estimate of all true images of a step, some shifted along their normal, left out or made up."""
    here = truth.paths.at(step).take(truth.paths.at(step).bounces == 1)
    line = truth.segments.line[here.segment[:, 0]] + [0.0, shift]
    keep = ~np.isin(np.arange(len(here)), without)
    line, owner = line[keep], here.anchor[keep]
    if ghost:
        line, owner = np.vstack([line, [0.3, 20.0]]), np.append(owner, 0)
    size = len(line)
    number = np.arange(size)
    table = SurfaceEstimate.from_lines(
        line, np.tile(np.eye(2) * 1e-4, (size, 1, 1)), np.full(size, 0.5), np.full(size, 0.1), np.ones(size),
        owner=owner,
    )  # fmt: skip
    far, nowhere = np.ones(size), np.zeros((size, 4, 2))
    both = np.stack([number, number], -1)
    paths = PathEstimate(owner, both, far, far, far, far, far, nowhere)
    scan = Scan(step, float(step), np.zeros(0, int), *[np.zeros(0)] * 4)
    return Estimate.of_pose(scan, [0, 0], 0.0, np.eye(5), surfaces=table, paths=paths)


def test_true_images_have_no_error_and_shifts_count_twice(world):
    estimates = [believing(*world, step, 0.05) for step in range(STEPS)]
    count = np.bincount(world[1].paths.at(0).anchor[world[1].paths.at(0).bounces == 1], minlength=2)
    np.testing.assert_allclose(image_gospa(*world[:1], estimates, world[1])[:, 0], 0.1 * count, atol=1e-9)
    exact = [believing(*world, step) for step in range(STEPS)]
    np.testing.assert_allclose(image_gospa(world[0], exact, world[1]), 0, atol=1e-9)


def test_missed_and_false_images_cost_a_metre_each(world):
    missing = image_gospa(world[0], [believing(*world, 0, without=[0])], world[1])
    assert missing.sum() == pytest.approx(1.0)
    false = image_gospa(world[0], [believing(*world, 0, ghost=True)], world[1])
    np.testing.assert_allclose(false[:, 0], [1.0, 0.0], atol=1e-9)


def test_an_image_that_is_out_of_sight_for_long_is_not_asked_for(world):
    """Nor is it false, once the method hasn't believed in its path for as long."""
    first = believing(*world, 0, ghost=True)
    later = [believing(*world, step) for step in range(1, STEPS)]
    hidden = []
    for estimate in later:
        ghost = first.surfaces.take(np.arange(len(first.surfaces)) == len(first.surfaces) - 1)
        table = SurfaceEstimate.from_lines(
            np.vstack([estimate.surfaces.line, ghost.line]),
            np.concatenate([estimate.surfaces.line_cov, ghost.line_cov]),
            *(np.ones(len(estimate.surfaces) + 1),) * 3,
            owner=np.append(estimate.surfaces.owner, 0),
        )
        hidden.append(replace(estimate, surfaces=table, detected=np.ones(len(table), bool)))
    error = image_gospa(world[0], [first, *hidden], world[1], lately=3)
    np.testing.assert_allclose(error[0], [1, 1, 1, 0, 0, 0], atol=1e-9)
