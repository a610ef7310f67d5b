"""Whether a state that was read from a file can be one: numbers that kernels and steps rely on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.inference.beliefs.element_gains import ElementGains
from gridslam.inference.beliefs.layout import AGENT, StateLayout
from gridslam.inference.health.range_fits import errors_of
from gridslam.inference.health.range_watch import RangeWatch
from gridslam.inference.health.sight_watch import SightWatch
from gridslam.inference.management.no_mirrors import MOST_CORNERS
from gridslam.inference.messages.ray_amplitudes import AmplitudeModel
from gridslam.inference.messages.surface_walk import LEAST, WIDEST
from gridslam.inference.scans.anchor_measurements import LEAST_STD
from gridslam.inference.scans.leftovers import LEAST_EVIDENCE, MOST_EVIDENCE, REFLECTIONS
from gridslam.inference.state.population import Population
from gridslam.inference.state.published.state_samples import StateSamples
from gridslam.inference.state.rings import BEARINGS, MOVING
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import ANGLES, FORMS, SurfaceBank
from gridslam.io.covariances import is_information
from gridslam.systems.linked_soundness import claims_of_mountings, claims_of_parked
from gridslam.world.filter_model import FilterModel
from gridslam.world.radio import BINS
from gridslam.world.signal_model import SignalModel

Shape = tuple[int, ...]
MOST_HYPOTHESES = 1000
SLACK = 1e-6
"""By which sums of probabilities may be off."""


def require_sound_population(population: Population[State], model: FilterModel, where: str) -> None:
    """Refuse hypotheses whose numbers can't be, or one of whose states can't; see `require_sound`."""
    require_sound_weights(population, where)
    if population.ranges is not None:
        _require_sound_ranges(population.ranges, errors_of(model.senders), f"{where}/ranges")
    require_claims([("early", 0 <= population.early <= 1, "0 to 1")], where)
    if population.sights is not None:
        _require_sound_sights(population.sights, model.senders, f"{where}/sights")
    for number, state in enumerate(population.states):
        require_sound(state, model, f"{where}/states/{number}")


def _require_sound_ranges(ranges: RangeWatch, errors: int, where: str) -> None:
    """Refuse sums of what lines of sight say, of so many errors, that can't be."""
    require_shapes([("information", ranges.information.shape, (errors, errors))], where)
    claims = [
        ("vector", ranges.vector.shape == (errors,), "a number for each error"),
        ("information", is_information(ranges.information), "symmetric and positive, an inverse covariance"),
        ("vector", bool(np.isfinite(ranges.vector).all()), "finite"),
        *((name, 0 <= getattr(ranges, name) < np.inf, "0 or more") for name in ("total", "count", "steps")),
    ]
    require_claims(claims, where)
    for number, late in enumerate(ranges.late):
        _require_sound_ranges(late, errors, f"{where}/late/{number}")
    for loudest in ranges.loudest:
        _require_sound_ranges(loudest, errors, f"{where}/loudest")


def _require_sound_sights(sights: SightWatch, anchors: int, where: str) -> None:
    """Refuse sums of what lines of sight say of so many anchors that can't be."""
    shapes = [
        ("right", sights.right.shape, (anchors,)),
        ("looks", sights.looks.shape, (2, anchors)),
        ("checked", sights.checked.shape, (2, anchors)),
        ("sums", sights.sums.shape, (2, anchors, 4, 4)),
    ]
    require_shapes(shapes, where)
    require_claims([("sums", is_information(sights.sums), "symmetric and positive, sums of squares")], where)


def require_sound_weights(population: Population[Any], where: str) -> None:
    """Refuse hypotheses whose weights can't be."""
    count = len(population.states)
    claims = [
        *claims_of_weights(population.log_weight, count),
        ("guard", -1 <= population.guard < count, "one of the hypotheses, or -1"),
        ("searching", not population.searching or count == 1, "true of one state alone"),
    ]
    require_claims(claims, where)


def claims_of_weights(log_weight: Sequence[float] | Array, count: int) -> list[tuple[str, bool, str]]:
    """What must hold of the weights of so many hypotheses."""
    log = np.array(log_weight)
    return [
        ("log_weight", 0 < count == len(log) <= MOST_HYPOTHESES, "one for each state"),
        ("log_weight", bool(abs(np.exp(log).sum() - 1) <= SLACK), "logs of probabilities"),
    ]


def require_shapes(shapes: Iterable[tuple[str, Shape, Shape]], where: str) -> None:
    """Refuse the first part (name, shape, what that has to be) of another shape than it has to be."""
    for name, shape, wanted in shapes:
        if shape != wanted:
            raise InputError(f"{where}/{name}", f"shape {shape}", f"shape {wanted}")


def require_claims(claims: list[tuple[str, bool, str]], where: str) -> None:
    """Refuse the first part of which a claim (part, whether it holds, what is allowed) doesn't hold."""
    for part, holds, allowed in claims:
        if not holds:
            raise InputError(f"{where}/{part}", "numbers that can't be", allowed)


def require_sound(state: State, model: FilterModel, where: str) -> None:
    """Refuse a state whose numbers can't be.

    Parameters
    ----------
    where : str
        Names the file in errors.

    Raises
    ------
    InputError
        With the part, and what is allowed.
    """
    require_shapes(_shapes(state, model), where)
    anchors, bank, calibration = len(model.anchors), state.surfaces, state.calibration
    claims = [
        ("step", state.step >= 0, "0 or more"),
        ("surfaces/identity", len(set(bank.identity.tolist())) == len(bank), "a number for each surface"),
        ("next_identity", state.next_identity > bank.identity.max(initial=-1), "above all identities"),
        *claims_of_bank(bank, "surfaces", anchors),
        ("calibration/weight", calibration.weight > 0, "a positive number"),
        ("calibration/turn_weight", bool((calibration.turn_weight > 0).all()), "positive numbers"),
        ("calibration/clutter", _within(calibration.clutter, 0, np.inf), "0 or more"),
        ("calibration/listened", _within(calibration.listened, 0, np.inf), "0 or more"),
        ("los", _within(state.los, 0, 1), "probabilities"),
        ("turn_variance", _within(np.array(state.turn_variance or 0.0), 0, np.inf), "0 or more, or none"),
        ("corners", _within(state.corners[:, 0], 0, model.senders - 1), "anchors' numbers"),
        ("turn_anchor", 0 <= state.turn_anchor < model.senders, "the number of an anchor"),
        *_claims_of_parts(state, model),
    ]  # fmt: skip
    require_claims(claims, where)


def _shapes(state: State, model: FilterModel) -> Iterator[tuple[str, Shape, Shape]]:
    """Parts of a state, their shapes, and what these have to be: all parts speak of the same surfaces."""
    anchors, surfaces, size = len(model.anchors), len(state.surfaces), len(state.belief.mean)
    layout = StateLayout(1, state.belief.clocks, surfaces, rises=len(model.rise_variance))
    yield "belief/mean", (size,), (layout.size,)
    yield "belief/covariance", state.belief.covariance.shape, (size, size)
    yield "los", state.los.shape, (anchors,)
    if state.sight_nats is not None:
        yield "sight_nats", state.sight_nats.shape, (model.senders,)
    for name in ("clutter", "listened", "turn", "turn_weight"):
        yield f"calibration/{name}", getattr(state.calibration, name).shape, (model.senders,)
    yield "corners", state.corners.shape, (min(len(state.corners), MOST_CORNERS), 3)
    yield from shapes_of_bank(state.surfaces, "surfaces", anchors)
    if state.parked is not None:
        yield "parked/cross", state.parked.cross.shape, (len(state.parked.mean), size)
        yield from shapes_of_bank(state.parked.surfaces, "parked/surfaces", anchors)
    if state.grid is not None:
        for name in ("evidence", "observed", "row"):
            yield f"grid/{name}", getattr(state.grid, name).shape, model.grid.shape
        if state.grid.withheld is not None:
            yield "grid/withheld", state.grid.withheld.shape, model.grid.shape
        yield "grid/hit", state.grid.hit.shape, (len(state.grid.hit), BINS)
    if state.samples is not None:
        count = len(StateSamples.start(model))
        yield "samples/agent", state.samples.agent.shape, (count, AGENT)
        yield "samples/lines", state.samples.lines.shape, (surfaces, count, 2)
        yield "samples/identity", state.samples.identity.shape, (surfaces,)
    if state.leftovers is not None:
        steps, rows = len(state.leftovers.pose), len(state.leftovers)
        parts: dict[str, Shape] = {
            "pose": (steps, 3), "covariance": (steps, 3, 3), "value": (rows, 3), "std": (rows, 3),
        }  # fmt: skip
        for field in fields(state.leftovers):
            found = getattr(state.leftovers, field.name).shape
            yield f"leftovers/{field.name}", found, parts.get(field.name, (rows,))
    places = state.unexplained
    if places is not None:
        tails: dict[str, Shape] = {
            "value": (2,), "std": (2,), "pose": (3,), "covariance": (3, 3),
        }  # fmt: skip
        for field in fields(places):
            found = getattr(places, field.name).shape
            yield f"unexplained/{field.name}", found, (len(places), *tails.get(field.name, ()))
    if state.by_line is not None:
        found = state.by_line.ratio.shape
        yield "by_line/ratio", found, (anchors, *found[1:3], len(REFLECTIONS))
    if state.presence is not None:
        known = len(state.presence.identity)
        yield "presence/identity", state.presence.identity.shape, (known,)
        yield "presence/chance", state.presence.chance.shape, (anchors, known, BINS)
    if state.noise is not None:
        yield "noise", state.noise.shape, (anchors,)
    if state.levels is not None and model.level_prior is not None:
        yield "levels", state.levels.shape, model.level_prior.shape
    if state.elements is not None and isinstance(model, SignalModel):
        none = ElementGains.none(model.waveform)
        for field in fields(none):
            found, wanted = (getattr(elements, field.name).shape for elements in (state.elements, none))
            yield f"elements/{field.name}", found, wanted
    if state.rings is not None:
        count, entries = len(state.rings.anchor), MOVING + 2
        mixture: dict[str, Shape] = {
            "weight": (count, BEARINGS), "mean": (count, BEARINGS, entries),
            "covariance": (count, BEARINGS, entries, entries),
        }  # fmt: skip
        for field in fields(state.rings):
            found = getattr(state.rings, field.name).shape
            yield f"rings/{field.name}", found, mixture.get(field.name, (count,))


def shapes_of_bank(
    bank: SurfaceBank, name: str, links: int, anchors: int | None = None
) -> Iterator[tuple[str, Shape, Shape]]:
    """Parts of a bank of surfaces, their shapes, and what these have to be; as `SurfaceBank.empty`."""
    surfaces = len(bank)
    whole: dict[str, Shape] = {
        "reflection": (surfaces, BINS), "extent": (surfaces, 2), "single": (links, surfaces),
        "double": (links, surfaces, surfaces), "walk": (surfaces, 2), "outermost": (surfaces, 8),
        "angles": (surfaces, links if anchors is None else anchors, ANGLES),
        "forms": (surfaces, FORMS),
    }  # fmt: skip
    for field in fields(bank):
        found = getattr(bank, field.name).shape
        yield f"{name}/{field.name}", found, whole.get(field.name, (surfaces,))


def claims_of_bank(bank: SurfaceBank, name: str, anchors: int) -> list[tuple[str, bool, str]]:
    """What must hold of surfaces."""
    ends, ways = np.isnan(bank.extent), np.isnan(bank.outermost.reshape(-1, 4))
    return [
        (f"{name}/extent", bool((ends.all(1) == ends.any(1)).all()), "both ends, or neither"),
        (f"{name}/outermost", bool((ways.all(1) == ways.any(1)).all()), "four numbers of a path, or none"),
        (f"{name}/owner", _within(bank.owner, -1, anchors - 1), "an anchor's number, or -1"),
        (f"{name}/age", _within(bank.age, 0, np.inf), "0 or more"),
        (f"{name}/seen", _within(bank.seen, 0, np.inf), "0 or more"),
        (f"{name}/angles", _within(bank.angles[..., [0, 2, 4, 5]], 0, np.inf), "0 or more"),
        (f"{name}/forms", _are_covariances(bank.forms[:, 2:5], bank.forms[:, 7:10]), "covariances"),
        (f"{name}/walk", _within(bank.walk, LEAST, np.log(max(WIDEST))), "-0.5 to 4.61"),
        (f"{name}/reflection", _sums_to_one(bank.reflection), "probabilities"),
        *((f"{name}/{part}", _within(getattr(bank, part), 0, 1), "probabilities")
          for part in ("existence", "single", "double")),
    ]  # fmt: skip


def _are_covariances(*triples: Array) -> bool:
    """Whether these (S, 3), xx, xy and yy, are those of covariances."""
    parts = np.concatenate(triples).T
    slack = 1 + 1e-9
    return bool((parts[[0, 2]] >= 0).all() and (parts[1] ** 2 <= slack * parts[0] * parts[2]).all())


def _claims_of_parts(state: State, model: FilterModel) -> list[tuple[str, bool, str]]:
    """What must hold of the parts that not every system keeps."""
    claims = claims_of_parked(state) + claims_of_mountings(state, model)
    if state.parked is not None:
        claims += claims_of_bank(state.parked.surfaces, "parked/surfaces", len(model.anchors))
    anchors, grid, rings = len(model.anchors), state.grid, state.rings
    if state.noise is not None:
        claims.append(("noise", _within(state.noise, 0, np.inf), "0 or more"))
    if state.elements is not None and isinstance(model, SignalModel):
        claims.append(("elements", state.elements.is_sound(model.waveform), "sums of its waveform"))
    levels, prior = state.levels, model.level_prior
    claims.append(
        ("levels", (levels is None) == (prior is None), "where coefficients of levels aren't known")
    )
    if levels is not None and prior is not None:
        known = ~prior.any(1)
        sound = not levels[known].any() and _sums_to_one(levels[~known])
        claims.append(("levels", sound, "probabilities, 0 for a known coefficient"))
    if state.by_line is not None:
        positive = _within(state.by_line.ratio, LEAST_EVIDENCE, MOST_EVIDENCE)
        claims += [
            ("by_line/ratio", positive, "evidence between its limits"),
            ("by_line/ratio", min(state.by_line.ratio.shape[1:3]) > 1, "two angles and two offsets, or more"),
        ]
    if state.presence is not None:
        claims.append(("presence/chance", _within(state.presence.chance, -1, 1), "probabilities, or -1"))
    left = state.leftovers
    if left is not None:
        claims += [
            ("leftovers/anchor", _within(left.anchor, 0, anchors - 1), "anchors' numbers"),
            ("leftovers/back", _within(left.back, 0, len(left.pose) - 1), "a row of pose"),
            ("leftovers/back", bool((np.diff(left.back) >= 0).all()), "the latest step first"),
            ("leftovers/std", _within(left.std, LEAST_STD, np.inf), "above 0"),
            ("leftovers/amplitude", _within(left.amplitude, LEAST_STD, np.inf), "above 0"),
        ]
    if state.unexplained is not None:
        whose, std = state.unexplained.anchor, state.unexplained.std
        claims += [
            ("unexplained/anchor", _within(whose, 0, anchors - 1), "anchors' numbers"),
            ("unexplained/std", _within(std, LEAST_STD, np.inf), "above 0"),
        ]
    if grid is not None:
        rows = np.sort(grid.row[grid.row >= 0])
        each = np.array_equal(rows, np.arange(len(grid.hit))) and _within(grid.row, -1, np.inf)
        claims.append(("grid/row", each, "each row of the table once, or -1"))
    if state.amplitudes is not None:
        nodes = len(AmplitudeModel.of(model.radio).nodes)
        fits = all(
            len(row) == nodes and _sums_to_one(row[None]) for row, _ in state.amplitudes.known.values()
        )
        claims.append(("amplitudes/probability", fits, f"probabilities over {nodes} nodes"))
        whose = np.array([key[0] for key in state.amplitudes.known], np.int64)
        claims.append(("amplitudes/key", _within(whose, 0, anchors - 1), "anchors' numbers"))
    wanted, samples = model.settings.representation == "particles", state.samples
    claims.append(("samples", wanted == (samples is not None), f"as filter.representation says: {wanted}"))
    if samples is not None:
        same = np.array_equal(samples.identity, state.surfaces.identity)
        claims.append(("samples/identity", same, "those of the surfaces"))
    if rings is not None:
        claims += [
            ("rings/anchor", _within(rings.anchor, 0, anchors - 1), "anchors' numbers"),
            ("rings/existence", _within(rings.existence, 0, 1), "probabilities"),
            ("rings/weight", _sums_to_one(rings.weight), "probabilities"),
        ]
    return claims


def _within(values: NDArray[Any], low: float, high: float) -> bool:
    return bool(((values >= low) & (values <= high)).all())


def _sums_to_one(rows: Array) -> bool:
    return bool((rows >= 0).all() and (np.abs(rows.sum(-1) - 1) < SLACK).all())
