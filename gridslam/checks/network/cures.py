"""What of several agents' labels and clocks must be wrong: cures that fit clearly better than what stands.

Among many reflections some fit the angles of a wrong way nearly as well as lines of sight fit those of the
right one. Distances and labels then don't fit that way; as they stand they do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.anchors.rivals import CERTAIN, orders
from gridslam.checks.network.sights import FEWEST, Links, distinct, middle_of, read_as_any
from gridslam.checks.scene.range_errors import LEAST_OFFSET_M
from gridslam.checks.sights.fit import FITTING, fitting, least_share
from gridslam.checks.sights.line_of_sight_filter import Sight, explain
from gridslam.measurements.network import NetworkMeasurements
from gridslam.world.columns import OPTIONAL, VALUES, Columns
from gridslam.world.network_scene import clock_model
from gridslam.world.scene import Scene

EXCHANGED, MISTAKEN = 0.5, 0.12
"""Shares of an anchor's lines of sight with one other label that count as exchanged, and as mistaken rows: up
to 7 % were reflections that look like one."""


@dataclass(frozen=True)
class Cure:
    """What must be wrong for an agent's table to fit.

    Attributes
    ----------
    exchanged : tuple of (int, int)
        Anchors, and those whose label all their rows have.
    mistaken, late : bool
        Labels of some rows besides, and distances beyond what the scene's clocks allow.
    fits : bool
        Whether the table fits then.
    """

    exchanged: tuple[tuple[int, int], ...] = ()
    mistaken: bool = False
    late: bool = False
    fits: bool = False


@dataclass(frozen=True, eq=False)
class Confusion:
    """Lines of sight by anchor and label.

    Attributes
    ----------
    found : (J, J) int
        By anchor (rows) and label (columns).
    exchanged : tuple of (int, int)
        Anchors, and those whose label most of their lines of sight have.
    mistaken : list of (int, int)
        Anchors, and labels that some of their lines of sight have.
    """

    found: NDArray[np.intp]
    exchanged: tuple[tuple[int, int], ...]
    mistaken: list[tuple[int, int]]

    @classmethod
    def of(cls, link: Links, anchors: int) -> Confusion:
        """That of an agent's lines of sight."""
        found = np.zeros((anchors, anchors), np.intp)
        labelled = link.label >= 0
        np.add.at(found, (link.anchor[labelled], link.label[labelled]), 1)
        count, own = found.sum(1), np.arange(anchors)
        share = found / np.maximum(count, 1)[:, None]
        judged, other = count >= FEWEST, share.argmax(1)
        moved: NDArray[np.bool_] = judged & (share.max(1) > EXCHANGED) & (other != own)
        share[own, np.where(moved, other, own)] = 0.0
        mistaken = np.argwhere(judged[:, None] & ~moved[:, None] & (share > MISTAKEN))
        exchanged = tuple((int(i), int(other[i])) for i in np.flatnonzero(moved))
        return cls(found, exchanged, [(int(i), int(j)) for i, j in mistaken])


def needed_cure(link: Links | None, measurements: NetworkMeasurements, scene: Scene, name: str) -> Cure:
    """The simplest cure of those that lines of sight suggest, if it fits clearly better than what is simpler.

    Parameters
    ----------
    link : Links or None
        Lines of sight of the agent by angles alone; without them only labels may be cured.
    """
    part = measurements[name].columns
    table = {key: part[key] for key in ("step", "anchor", *VALUES, *OPTIONAL) if key in part}
    best, gained, held = Cure(), -np.inf, set[int]()
    for cure, labels, shift in _cures(link, table, scene, name):
        if cure.exchanged and link is None and best.fits:
            break
        sight = _as_if(table, labels, shift, scene, name)
        fits = sight.explained >= fitting(scene)
        if cure == Cure():
            if sight.evidence > gained:
                best, gained, held = replace(cure, fits=fits), sight.evidence, _held(sight)
        elif cure.late and held & set(np.flatnonzero(np.abs(shift) > LEAST_OFFSET_M).tolist()):
            continue
        elif sight.evidence > gained + CERTAIN:
            # where walls may hide anchors, angles alone still tell labels, but not how far away all is
            if fits or not (cure.late or link is None or sight.explained < least_share(scene)):
                best, gained = replace(cure, fits=True), sight.evidence
    return best


def _cures(
    link: Links | None, table: Columns, scene: Scene, name: str
) -> Iterator[tuple[Cure, NDArray[np.intp], Array]]:
    """Cures from the simplest on, with the labels and the offsets (J,) m that the table has by them."""
    stands, anchors = table["anchor"], len(scene.anchors)
    half = clock_model(scene, [name]).half_width_m
    widest, nothing = half[:anchors] + half[anchors], np.zeros(anchors)
    late = nothing if link is None else _offsets(link, anchors)
    allowed = [nothing]
    if widest.any():
        by_label = _by_labels(table, scene, name)
        allowed += [np.clip(shift, -widest, widest) for shift in (_offsets(by_label, anchors), late)]
    labels = list(_relabelled(link, stands, anchors))
    for (cure, anchor), shift in product(labels, allowed):
        yield cure, anchor, shift
    if (np.abs(late) > widest).any():
        for cure, anchor in labels:
            yield replace(cure, late=True), anchor, late


def _held(sight: Sight) -> set[int]:
    """Anchors that all the same stand and measure as the scene says: two agree on the way by chance never."""
    held = {int(number) for number in np.flatnonzero(np.nan_to_num(sight.shares) >= FITTING)}
    return held if len(held) > 1 else set()


def _relabelled(
    link: Links | None, stands: NDArray[np.intp], anchors: int
) -> Iterator[tuple[Cure, NDArray[np.intp]]]:
    """Labels (K,) as they stand, and as lines of sight have them; without those, all orders of anchors."""
    yield Cure(), stands
    if (stands < 0).all():
        return
    if link is None:
        for order in orders(anchors):
            pairs = tuple((new, old) for old, new in enumerate(order) if new != old)
            yield Cure(tuple(sorted(pairs))), np.where(stands < 0, -1, np.array(order)[stands])
        return
    confusion, renamed = Confusion.of(link, anchors), stands.copy()
    for anchor, label in confusion.exchanged:
        renamed[stands == label] = anchor
    if confusion.exchanged:
        yield Cure(confusion.exchanged), renamed
    if confusion.mistaken:
        labelled, rows_too = link.label >= 0, renamed.copy()
        rows_too[link.row[labelled]] = link.anchor[labelled]
        yield Cure(confusion.exchanged, mistaken=True), rows_too


def _by_labels(table: Columns, scene: Scene, name: str) -> Links:
    """Lines of sight by angles and the labels as they stand."""
    rows, anchor = read_as_any(table["anchor"], len(scene.anchors))
    angles: Columns = {key: table[key][rows] for key in table if key != "distance_m"} | {"anchor": anchor}
    return distinct(table, rows, angles, explain(angles, scene, name), scene, name)


def _offsets(link: Links, anchors: int) -> Array:
    """Middle of how much the distances of each anchor are too long, (J,) m; 0 of those hardly seen."""
    each = [link.late_m[link.anchor == number] for number in range(anchors)]
    return np.array([middle_of(late)[0] if len(late) >= FEWEST else 0.0 for late in each])


def _as_if(table: Columns, labels: NDArray[np.intp], shift: Array, scene: Scene, name: str) -> Sight:
    """What lines of sight explain with these labels, and distances too long by `shift` (J,) m."""
    rows, anchor = read_as_any(labels, len(scene.anchors))
    read: Columns = {key: values[rows] for key, values in table.items()} | {"anchor": anchor}
    return explain(read | {"distance_m": read["distance_m"] - shift[anchor]}, scene, name)
