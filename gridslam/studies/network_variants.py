"""The four variants of [Venus2025network], section VI, on the same seed: what clocks and labels are worth.

Noise, misses and clutter are the same in all of them. Where anchors are synchronised, their clocks are right
at all times: a bias that drifts isn't taken away by its first value.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gridslam.errors import InputError
from gridslam.evaluation.metrics import rmse, track_errors
from gridslam.measurements.network import NetworkMeasurements
from gridslam.runs.network_run import SETTLED, map_network
from gridslam.simulation.network import NetworkTruth, shared_air
from gridslam.world.scene import Scene
from gridslam.world.start import assumed_start

VARIANTS = {
    "unsynchronised, unlabelled": (False, False),
    "synchronised, unlabelled": (True, False),
    "unsynchronised, labelled": (False, True),
    "synchronised, labelled": (True, True),
}
"""Whether the anchors' clocks are known, and whether labels are."""


@dataclass(frozen=True, eq=False)
class VariantRun:
    """One variant on one seed.

    Attributes
    ----------
    variant : str
    seed : int
    position_rmse_m, position_bound_m, apparent_bias_rmse_ps, bound_ps : float
        From step 101 on, or from the middle of shorter runs.
    label_errors, labels_judged : int
    """

    variant: str
    seed: int
    position_rmse_m: float
    position_bound_m: float
    apparent_bias_rmse_ps: float
    bound_ps: float
    label_errors: int
    labels_judged: int


def variant_of(
    scene: Scene, names: Sequence[str], seed: int, variant: str
) -> tuple[Scene, NetworkMeasurements, NetworkTruth]:
    """A variant's scene, as its filter is told, and what is heard in it.

    Raises
    ------
    InputError
        No such variant, a scene without clocks, or agents that can't be simulated.
    """
    if variant not in VARIANTS:
        raise InputError("variant", repr(variant), ", ".join(VARIANTS))
    if scene.clocks is None:
        raise InputError(f"{scene.name}: clocks", "none", "a table [clocks]")
    synchronised, labelled = VARIANTS[variant]
    whole = scene.model_dump(exclude_none=True)
    if synchronised:
        for anchor in whole["anchors"]:
            anchor["clock"] = {"prior_ns": 0.0}
    measurements, truth = shared_air(Scene.checked(whole, scene.name), names, seed, len(scene.anchors))
    if labelled:  # false alarms are of each anchor then
        whole["radio"]["false_alarms"] /= len(scene.anchors)
    return (
        Scene.checked(whole, scene.name),
        measurements if labelled else measurements.without_labels(),
        truth,
    )


def run_variants(
    scene: Scene, names: Sequence[str], seeds: Iterable[int], variants: Sequence[str] = tuple(VARIANTS),
    method: str = "network",
) -> list[VariantRun]:  # fmt: skip
    """Run variants on the same seeds, starts drawn from the priors by the seed.

    Raises
    ------
    InputError
        As `variant_of`.
    """
    runs = []
    for seed in seeds:
        for variant in variants:
            variant_scene, measurements, truth = variant_of(scene, names, seed, variant)
            starts = {name: assumed_start(variant_scene, name, seed) for name in names}
            done = map_network(variant_scene, measurements, seed, starts=starts, method=method)
            scores: dict[str, Any] = done.score(truth.clocks, truth)
            first = min(SETTLED, len(measurements) // 2)
            errors = [
                track_errors(run.trajectory, truth.agents[name].trajectory)[0][
                    np.array([e.step >= first for e in run.estimates])
                ]
                for name, run in done.runs.items()
            ]
            columns = "position_bound_m", "apparent_bias_rmse_ps", "bound_ps", "label_errors", "labels_judged"
            known = {name: scores[name] for name in columns}
            runs.append(VariantRun(variant, seed, rmse(np.concatenate(errors)), **known))
    return runs


def medians(runs: Sequence[VariantRun]) -> dict[str, VariantRun]:
    """Medians over the seeds of every variant; label errors are summed."""
    table = {}
    for variant in dict.fromkeys(run.variant for run in runs):
        own = [run for run in runs if run.variant == variant]
        names = ("position_rmse_m", "position_bound_m", "apparent_bias_rmse_ps", "bound_ps")
        middle = {name: float(np.median([getattr(run, name) for run in own])) for name in names}
        sums = {name: sum(getattr(run, name) for run in own) for name in ("label_errors", "labels_judged")}
        table[variant] = replace(own[0], **middle, **sums)  # type: ignore[arg-type]
    return table
