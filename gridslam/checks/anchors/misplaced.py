"""Anchors that stand elsewhere than the scene says, by where lines of sight of several cross."""

from __future__ import annotations

from dataclasses import replace

from gridslam.checks.anchors.changes import change
from gridslam.checks.anchors.handover_rivals import handover_rival
from gridslam.checks.scene.range_words import offset_cure
from gridslam.checks.sights.crossed import Crossed
from gridslam.checks.tables.unit_hypotheses import Suspicion
from gridslam.inference.health.range_fits import Fit, beyond_doubt, errors_of, named_together, undecided
from gridslam.world.columns import VALUES, Columns
from gridslam.world.filter_model import FilterModel
from gridslam.world.scene import Scene

RIVALS = {"offset", "slant", "rise", "start", "turned"}
"""Kinds of suspicion that another place of an anchor may stand behind."""
RANGES = {"offset", "slant", "rise"}
"""Of them, errors of distances."""
CURED = {"slant", "rise", "turned"}
"""Those that come first if the table fits better as they say than with an anchor elsewhere."""
OTHERWISE = {"names", "turned", "flipped"}
"""Those that handovers tell, where an offset alone would be named."""
LEFT = 0.7
"""Share of the misfit beyond what chance makes that an explanation may leave."""


def with_places(
    found: list[Suspicion], table: Columns, scene: Scene, agent: str | None, cured: Columns | None = None
) -> list[Suspicion]:
    """Suspicions against the scene, with anchors that stand elsewhere instead of them, or beside them.

    Parameters
    ----------
    found : list of Suspicion
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    cured : dict of (K,) arrays, optional
        The same as the suspicions say that it should have been.
    """
    kinds = {item.kind for item in found}
    if not scene.agents or scene.clocks is not None or kinds - RIVALS or not table.keys() >= set(VALUES):
        return found  # units come first, and clocks that nobody set stand for any distance
    model, walls = scene.filter_model(agent), scene.segments()
    seen = Crossed.of(table, model, walls)
    told = bool(kinds & CURED) or not found  # or what the scene allows for
    better = cured if told and cured is not table else None
    if seen is None or (better is not None and seen.is_behind(Crossed.of(better, model, walls))):
        return found
    changed = change(seen, table, model, walls)
    if changed is not None:
        return [changed]
    fits, text = _explaining(seen, model, found)
    if not text:
        return found
    plain, best = (fit.misfit / seen.numbers for fit in (seen.fits[0], fits[0]))
    rival = None if found or fits[0].thing.is_shift else handover_rival(table, scene, agent)
    if rival is not None and rival.kind in OTHERWISE:  # an offset explains part of what that does
        return [rival]
    reason = (
        f"lines of sight of two anchors or more cross at {len(seen.gaps)} steps; misfit per number "
        f"{plain:.1f} as it stands, {best:.1f} so"
    )
    if fits[0].thing.is_shift:
        return [Suspicion("anchor", "place", text, len(fits) == 1, reason)]
    others = [replace(item, certain=False) for item in found if item.kind not in RANGES]
    kind = "slant" if fits[0].thing.is_height(errors_of(model.senders)) else "offset"
    if kind == "offset" and len(fits) == 1:
        text = f"{text}, {offset_cure(fits[0].size[0], fits[0].thing.alike, scene)}"
    return [Suspicion("distance_m", kind, text, len(fits) == 1, reason), *others]


def _explaining(seen: Crossed, model: FilterModel, found: list[Suspicion]) -> tuple[tuple[Fit, ...], str]:
    """Fits of what may be wrong with anchors, and their words; none if they leave most of the misfit.

    Beside what has been found only other places are of interest, and only those beyond doubt.
    """
    fits = beyond_doubt(seen.fits, seen.numbers)
    if not fits and not found:
        fits = undecided(seen.fits, seen.numbers)
    text = named_together(fits, model) if not found or any(fit.thing.is_shift for fit in fits) else ""
    if not text:
        return (), ""
    plain, best = (fit.misfit / seen.numbers for fit in (seen.fits[0], fits[0]))
    return ((), "") if best - 1 > LEFT * (plain - 1) else (fits, text)  # then something else is wrong
