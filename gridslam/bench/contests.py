"""What each kernel is given in a race with its NumPy twin, how much work it is, and what the twin takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam import reference
from gridslam.bench.stages import Function
from gridslam.kernels import ALREADY_LISTED
from gridslam.kernels.primitives.blocks import ONLY

Array = NDArray[Any]


class Case(dict[str, Any]):
    """Arguments of one launch, by name.

    Attributes
    ----------
    lasting : frozenset of str
        Those that most launches get from an earlier one: the very same arrays.
    """

    lasting: frozenset[str] = frozenset()


def _drawn(case: Case) -> Array:
    """Rays of the paths that there are, (L, R, 14)."""
    return np.asarray(case["drawn"].reshape(len(case["path"]), -1, 14)[: _listed(case)])


def _senders(case: Case) -> NDArray[np.intp]:
    """Paths that send messages."""
    likely = np.flatnonzero(case["factor"][: _listed(case), 1] > 0.5)  # rays of others were never drawn
    return likely[_drawn(case)[likely, :, 12].mean(1) > case["frame"][5]]


def _visits(case: Case) -> int:
    """Cells that the rays of possible paths cross, and those that they meet, each counted once.

    Of paths that may send: others aren't cast. The kernel walks them for V, and again for their messages.
    """
    total, likely = 0, case["factor"][: _listed(case), 1] > 0.5
    for rays, count in zip(_drawn(case)[likely], case["path"][: _listed(case)][likely, 0], strict=True):
        for row in rays[rays[:, 12] > 0.5]:
            corners, normals = row[:8].reshape(4, 2)[: count + 2], row[8:12].reshape(2, 2)[:count]
            crossed, met = reference.cells_of(
                corners, normals, case["frame"], case["where"].shape, case["frame"][7]
            )
            total += len(crossed) + sum(len(cells) for cells in met)
    return total


@dataclass(frozen=True)
class Contest:
    """What the benchmark knows of a kernel.

    Attributes
    ----------
    unit : str
    twin : callable
        Takes arguments of the kernel by name, and `given`.
    units : callable
        How many units a case has.
    rows : tuple of str
        Arguments without which, or without whose rows, there is nothing to do.
    given : callable
        The twin's arguments that the kernel doesn't have.
    size : callable, optional
        Which launch of a step is the largest, if not by its units.
    changes : tuple of str
        Arguments that the kernel reads and changes.
    """

    unit: str
    twin: Function
    units: Callable[[Case], int]
    rows: tuple[str, ...] = ("path",)
    given: Callable[[Case], dict[str, Any]] = lambda case: {}
    size: Callable[[Case], int] | None = None
    changes: tuple[str, ...] = ()


def _path_particles(case: Case) -> int:
    return len(case["path"]) * case["state"].shape[1]


def _samples(case: Case) -> int:
    return (
        len(case["scan"])
        * len(case["known"])
        * len(case["whose"])
        * min(case["state"].shape[1], case["noise"].shape[1])
    )


def _paths(case: Case) -> int:
    return len(case["path"])


def _listed(case: Case) -> int:
    return int(case["found"][0])


def _noted(case: Case) -> int:
    return int(case["count"][0])


def _surfaces(case: Case) -> int:
    return len(case["surface"])


def _cast_twin(case: Case) -> dict[str, Any]:
    """What was drawn of the sending paths; the kernel draws them itself, and casts the others for V alone."""
    send = _senders(case)
    rows = _drawn(case)[send].reshape(-1, 14)
    traversed, hit = case["occupied"].reshape(2, *case["where"].shape)
    return {
        "corners": rows[:, :8].reshape(-1, 4, 2), "normals": rows[:, 8:12].reshape(-1, 2, 2),
        "possible": rows[:, 12], "bounces": case["path"][send, 0], "worth": case["factor"][send, 0],
        "traversed": traversed, "hit": hit, "rays": case["state"].shape[1],
        "outside": case["frame"][3], "clip": case["frame"][4], "spared": case["frame"][7],
    }  # fmt: skip


def _born(case: Case) -> int:
    return int(case["born"][0, 0])


def _messages(case: Case) -> int:
    return int(np.prod(case["message"].shape[1:]))


CONTESTS = {
    "fold_messages": Contest(
        "cell",
        reference.fold_messages,
        lambda case: case["before"].size,
        ("before", "news"),
        changes=("message", "news", "observed"),
    ),
    "associate": Contest("pair", reference.associate, _messages, ("message", "odds", "measured")),
    "bear_out": Contest("line", reference.bear_out, lambda case: len(case["line"]), ("scan", "line")),
    "initialise_surface": Contest("path", reference.initialise_surface, lambda case: 1, ("scan",)),
    "cast": Contest(
        "cell visit",
        reference.cast,
        _visits,
        given=_cast_twin,
        rows=("path", "found", "mean"),
        # that sends: it lists no paths, and tells no coefficients
        size=lambda case: _listed(case) if case["choice"][ONLY] == ALREADY_LISTED else -1,
    ),
    "describe": Contest("path", reference.describe, _listed, ("surface", "places", "table"), size=_surfaces),
    "find_duplicates": Contest(
        "pair", reference.find_duplicates, lambda case: len(case["foot"]) ** 2, ("foot",)
    ),
    "evaluate": Contest(
        "path-particle",
        reference.evaluate,
        _path_particles,
        ("path", "probability", "predicted", "scan", "odds", "root", "blocks", "message", "measured"),
    ),
    "fit_forms": Contest(
        "surface",
        reference.fit_forms,
        lambda case: len(case["form"]),
        ("heard", "place", "line", "form"),
        changes=("form",),
    ),
    "list_paths": Contest("path", reference.list_paths, _listed, ("surface",), size=_surfaces),
    "weigh_by_visibility": Contest(
        "path", reference.weigh_by_visibility, _born, ("born",), changes=("proposal", "measured")
    ),
    "find_ghosts": Contest(
        "pair", reference.find_ghosts, lambda case: len(case["surface"]) ** 2, ("surface",)
    ),
    "learn": Contest(
        "path",
        reference.learn,
        _noted,
        ("count",),
        changes=("surface", "where", "held", "used", "foot", "extent", "times", "outermost"),
    ),
    "learn_ratios": Contest(
        "path",
        reference.learn_ratios,
        _noted,
        ("count",),
        changes=("surface", "where", "held", "used", "foot", "extent", "times", "outermost"),
    ),
    "listen": Contest(
        "node",
        reference.listen,
        lambda case: case["ahead"].size,
        ("ahead", "scan", "responsible", "density"),
    ),
    "mark": Contest("path", reference.mark, _paths, changes=("foot", "extent", "times", "outermost")),
    "near": Contest("measurement", reference.near, lambda case: len(case["scan"]), ("scan", "places")),
    "polylines": Contest("path-ray", reference.polylines, _path_particles),
    "propose": Contest("sample", reference.propose, _samples, ("scan",), changes=("measured",)),
    "walk": Contest("node", reference.walk, lambda case: case["ahead"].size, ("ahead", "length")),
    "update": Contest(
        "path",
        reference.update,
        _paths,
        ("path", "share", "scan", "odds", "message", "measured"),
        changes=(
            "mean",
            "covariance",
            "message",
            "measured",
            "surface",
            "sight",
            "single",
            "double",
            "sums",
            "count",
            "noted",
            "factor",
            "summary",
            "begin",
            "detection",
        ),
    ),
}

PARTS = {"associate": "update", "learn_ratios": "learn"}
"""Kernels that no course launches, and those whose arguments they can be given: one is part of the other, or
is it but for who evaluates, in a method on samples."""
