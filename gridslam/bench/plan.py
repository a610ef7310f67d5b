"""How much is measured."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Plan:
    """How much is measured; the defaults take a few minutes.

    Attributes
    ----------
    particles : tuple of int
        Those of the whole steps on `alcove`.
    canyon : int
        Particles on `canyon`.
    before : int
        Steps before anything is timed.
    timed : int
        Steps of which the median is taken.
    watched : int
        Steps that are split by stage.
    later : int
        Steps before `canyon` is timed once more, when most of its surfaces are known.
    kernel_particles : int
        Particles at which the kernels' cases are taken.
    kernel_before : int
        Steps after which they are.
    kernel_s : float
        Seconds of repeats for each kernel, and each twin.
    growth_particles : int
        Particles at which the growth in everything else is measured.
    surfaces : tuple of int
        Sides of the polygons in which growth with surfaces is measured.
    false_alarms : tuple of float
        Clutter per anchor and step.
    cell_m : tuple of float
        Sides of cells.
    hypotheses : tuple of int
        How many are stepped at `kernel_particles` (of one; several have fewer each).
    steps : tuple of int
        Lengths of a run.
    repeats : int
        How often a process is started.
    paths : int
        How many are superposed at once, of sampled signals; what their twins take grows with it.
    features : tuple of int
        Numbers of learned features.
    feature_particles : int
        Particles at which their kernels are timed.
    """

    particles: tuple[int, ...] = (1_000, 3_000, 10_000, 30_000, 60_000)
    canyon: int = 10_000
    before: int = 12
    timed: int = 20
    later: int = 150
    watched: int = 20
    kernel_particles: int = 10_000
    kernel_before: int = 60
    kernel_s: float = 1.0
    growth_particles: int = 3_000
    surfaces: tuple[int, ...] = (3, 4, 6, 8, 12)
    false_alarms: tuple[float, ...] = (2.0, 8.0, 32.0, 64.0)
    cell_m: tuple[float, ...] = (0.2, 0.1, 0.05, 0.025)
    hypotheses: tuple[int, ...] = (1, 5, 20)
    steps: tuple[int, ...] = (24, 48, 120, 240)
    repeats: int = 3
    paths: int = 13
    features: tuple[int, ...] = (3, 8, 15, 30, 60)
    feature_particles: int = 1_000


QUICK = Plan(
    particles=(256, 1_024), canyon=256, before=1, timed=2, later=3, watched=1, kernel_particles=4,
    kernel_before=2, kernel_s=0.01, growth_particles=256, surfaces=(3, 4), false_alarms=(2.0, 8.0),
    cell_m=(0.2, 0.1), hypotheses=(1, 2), steps=(2, 4), repeats=1, paths=2, features=(3,),
    feature_particles=8,
)  # fmt: skip
"""Everything once, in half a minute: to see that it works, not to believe its numbers."""
