"""What `run.json` holds: its keys, with types, units, ranges and meanings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from gridslam.errors import InputError
from gridslam.quantity import Quantity
from gridslam.world.start import How

Kind = Literal[
    "number", "whole number", "true or false", "text", "list of text", "two numbers", "list of numbers",
    "lists of numbers", "table", "list",
]  # fmt: skip
TYPES: dict[str, type | tuple[type, ...]] = {
    "number": (int, float), "whole number": int, "true or false": bool, "text": str, "table": dict,
    "list": list,
}  # fmt: skip
PARTS: dict[str, Kind] = {
    "list of text": "text", "two numbers": "number", "list of numbers": "number",
    "lists of numbers": "list of numbers",
}  # fmt: skip
"""What lists hold."""
ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class Entry(Quantity):
    """A key of ``run.json``; `default` says what it means if it is null or missing.

    Attributes
    ----------
    kind : str
    words : tuple of str
        What a text may be; empty for any.
    """

    kind: Kind = "number"
    words: tuple[str, ...] = ()

    @property
    def allowed(self) -> str:
        """Which values, in words."""
        if self.words:
            return ", ".join(f"`{word}`" for word in self.words)
        return super().allowed if "number" in self.kind else self.kind

    def fits(self, value: Any) -> bool:
        """Whether it may be this value, which isn't null."""
        if self.kind in PARTS:
            one = replace(self, kind=PARTS[self.kind])
            whole = isinstance(value, list) and (self.kind != "two numbers" or len(value) == 2)
            return whole and all(
                one.fits(item) or (item is None and self.kind == "list of numbers") for item in value
            )
        right = isinstance(value, TYPES[self.kind]) and isinstance(value, bool) == (
            self.kind == "true or false"
        )
        if not right or "number" not in self.kind:
            return right and (not self.words or value in self.words)
        slack = ROUNDING if self.kind == "number" else 0
        return bool(np.isfinite(value)) and self.least - slack <= value <= self.most + slack


NO_TRACK, NO_TRUTH, NO_CELLS = (
    "true track not known",
    "truth not known, or no surfaces mapped",
    "no cells, or truth not known",
)
NOT_TOLD, NO_CLOCKS, NO_SOURCE = "not told", "true offsets not known", "simulated"


def _rms(name: str, unit: str, meaning: str, without: str) -> Entry:
    return Entry(name, unit, meaning, without, 0)


def _count(name: str, meaning: str, without: str = NOT_TOLD) -> Entry:
    return Entry(name, "1", meaning, without, 0, kind="whole number")


def _share(name: str, meaning: str, without: str = NO_CELLS) -> Entry:
    return Entry(name, "1", meaning, without, 0, 1)


MAP = (
    _share("occupied_precision", "share of the occupied cells within two cells of a true wall"),
    _share("occupied_recall",
           "share of the cells that true paths hit 10 times which are occupied within one cell"),
    _share("free_precision", "share of the cells called free that hold no wall"),
    _share("free_recall",
           "share of the cells that true paths cross, farther than 1.5 cells from a wall, called free"),
    _share("auc", "area under the ROC curve of the occupancy, over hit and crossed cells"),
)  # fmt: skip
"""Scores of the cells."""
HEALTH = (
    _count("unwell_steps", "steps at which something was amiss"),
    _count("why.REASON", "at how many steps this was amiss"),
    _count("most_hypotheses", "most hypotheses at a step"),
)
"""What the filter said of itself."""
AGENT = (
    _count("steps", "steps that were done"),
    Entry("interrupted", "1", "whether it was stopped before the last measurement", NOT_TOLD,
          kind="true or false"),
    _rms("position_rmse_m", "m", "root mean square of the position error", NO_TRACK),
    _rms("position_bound_m", "m",
         "the same of its Cramér-Rao bound with known map; steps at which nothing was heard though 3"
         " detections or more were to be expected tell it nothing",
         "there is none, as for sampled signals of a scene with scatterers, which no bound counts"),
    _rms("position_p95_m", "m", "95th percentile of the position error", NO_TRACK),
    _rms("heading_rmse_deg", "deg", "root mean square of the heading error", NO_TRACK),
    _rms("heading_bound_deg", "deg", "the same of its bound", "as `position_bound_m`"),
    _rms("final_position_error_m", "m", "position error at the last step", NO_TRACK),
    Entry("diverged", "1",
          "whether any position error exceeds 0.5 m after step 10, also of an agent that was found again: a"
          " note says which", NO_TRACK, kind="true or false"),
    _rms("position_std_m", "m", "the filter's own standard deviation of the position, root mean square",
         "not finite"),
    _rms("position_nees", "1",
         "mean squared error of the position in units of the filter's own covariance (NEES), over the steps:"
         " 2 is right, more is too sure of itself", NO_TRACK),
    _rms("position_median_nees", "1",
         "median of the same, which single steps don't rule: 1.39 is right", NO_TRACK),
    _count("silent_steps",
           "steps at which the position is off by more than 4 claimed deviations (roots of the trace of the"
           " position's covariance) while health is well: how often the filter was wrong and didn't say so;"
           " `refa`, `direct-paper` and `network-paper` have no health", NO_TRACK),
    _rms("heading_std_deg", "deg", "the filter's own standard deviation of the heading",
         "nothing tells the heading"),
    _count("surfaces_detected", "surfaces found", "a method that maps none"),
    _count("features", "learned features (hybrid SLAM)", "another method"),
    _count("surfaces_matched",
           "true ones among them: nearer than 0.5 m as feature vectors, each counted once", NO_TRUTH),
    _count("surfaces_true", "surfaces that true paths hit, each curved wall once", NO_TRUTH),
    _count("surfaces_false",
           "surfaces found that lie at no wall: 0.5 m or more as feature vectors from each wall and facet of"
           " the scene, also those that no path hits", NO_TRUTH),
    _rms("surface_ospa_m", "m", "OSPA distance of found to true surfaces (cut-off 5 m, order 1)", NO_TRUTH),
    _rms("surface_gospa_m", "m",
         "GOSPA distance of the same [Rahmathullah2017gospa] (cut-off 5 m, order 1): the sum of the distances"
         " of those found, and 2.5 m for each that is missing or false", NO_TRUTH),
    _share("reflection_mae",
           "mean error of the reflection coefficients of occupied cells within two cells of a wall"),
    *(replace(one, name=f"map.{one.name}") for one in MAP),
    *(replace(one, name=f"health.{one.name}") for one in HEALTH),
    _rms("seconds_per_step", "s",
         "median time of a step: the first ones, which also compile kernels, don't count", NOT_TOLD),
    _rms("peak_memory_mb", "MB", "largest memory of the process", NOT_TOLD),
    Entry("heights.WHAT.height_m", "m", "height of agent, floor or ceiling as believed at the end",
          "it is known"),
    _rms("heights.WHAT.std_m", "m", "its deviation", "it is known"),
    Entry("heights.WHAT.error_m", "m", "its error", "truth not known"),
    _share("coefficients.WHAT.coefficient", "coefficient of floor or ceiling as believed at the end",
           "it is known"),
    _rms("coefficients.WHAT.std", "1", "its deviation", "it is known"),
    Entry("coefficients.WHAT.error", "1", "its error", "truth not known", -1, 1),
    Entry("anchors.WHAT.x_m", "m", "where an anchor stands as believed at the end", "it is known"),
    Entry("anchors.WHAT.y_m", "m", "the same", "it is known"),
    _rms("anchors.WHAT.position_std_m", "m", "its deviation, sqrt(var x + var y)", "it is known"),
    Entry("anchors.WHAT.orientation_deg", "deg", "how it is turned, likewise", "it is known"),
    _rms("anchors.WHAT.orientation_std_deg", "deg", "its deviation", "it is known"),
)  # fmt: skip
"""Scores of an agent, see `gridslam.runs.run.Run.score`."""
NETWORK = (
    _rms("apparent_bias_rmse_ps", "ps",
         "root mean square error of the clocks' offsets between anchors and agents, as distances hold them,"
         " from step 101 on (of short runs the second half)", NO_CLOCKS),
    _rms("bias_rmse_without_common_ps", "ps",
         "the same of every clock's offset, less what all have in common, which nothing tells but a"
         " `reference`", NO_CLOCKS),
    _rms("bound_ps", "ps", "Cramér-Rao bound of the first", "recorded"),
    _rms("position_bound_m", "m",
         "that of the agents' positions from the same step on, map and clocks unknown: not that of"
         " `agents.NAME`, whose map is known", "recorded"),
    _count("steps_to_synchronise.ANCHOR",
           "step from which on its clock stays within 3 ns (without a `reference`: less what all have in"
           " common)",
           f"it ends beyond, or {NO_CLOCKS}"),
    _count("label_errors", "measurements that were believed to be of a wrong anchor", "recorded"),
    _count("labels_judged", "of how many", "recorded"),
)  # fmt: skip
"""Scores of the clocks and labels of several agents, see `gridslam.runs.network_run.NetworkRun.score`."""


def _text(name: str, meaning: str, without: str = NOT_TOLD) -> Entry:
    return Entry(name, "1", meaning, without, kind="text")


SUMMARY = (
    _text("scene", "name of the scene"),
    _text("method", "as `--method` takes it"),
    _count("seed", "of all random numbers"),
    replace(_text("start",
                  "where starts come from: `drawn` from the prior, `exact` (a simulated agent's true one), or"
                  " `scene`: of what was recorded, the scene's `start_m`, as its author wrote it; from"
                  " Python, `told`: a pose that was handed over"), words=get_args(How)),
    Entry("starts.NAME.position_m", "m", "where the filter assumed the agent at its start", NOT_TOLD,
          kind="two numbers"),
    Entry("starts.NAME.heading_deg", "deg", "heading that it assumed", NOT_TOLD),
    _count("particles", "number of particles; `hybrid` has them at its first steps alone",
           "a method that draws none (`direct`, `direct_grid`)"),
    _text("device", "where the kernels ran"),
    _text("versions.PACKAGE", "of Python and of the packages that matter"),
    Entry("notes", "1",
          "what was said beside `health`, before the run and below its table: whether it was cut short, who"
          " was lost, what is suspected of measurements or a true track, what the method can't tell, heights",
          NOT_TOLD, kind="list of text"),
    _text("source.file", "name of the file of measurements; of several files `source` is a list", NO_SOURCE),
    _text("source.sha256", "its checksum", NO_SOURCE),
    _text("map.file", "folder and name of the earlier map that the run began with", "it began with none"),
    _text("map.sha256", "its checksum", "it began with none"),
    *(replace(one, name=f"network.{one.name}") for one in NETWORK),
    *(replace(one, name=f"agents.NAME.{one.name}") for one in AGENT),
)  # fmt: skip
"""All keys; words in capitals stand for any name."""


def blank(entries: tuple[Entry, ...]) -> dict[str, Any]:
    """Scores none of which is known: None under each name."""
    return dict.fromkeys(one.name.partition(".")[0] for one in entries if ".WHAT." not in one.name)


def hold(summary: Mapping[str, Any], where: str) -> None:
    """Refuse the first value that can't be; keys that aren't described are passed over.

    Parameters
    ----------
    summary : mapping
        As JSON has it.
    where : str
        What errors call it.

    Raises
    ------
    InputError
        With key, value and what is allowed.
    """
    for key, value, one in described(summary):
        if value is None or one is None or (isinstance(one, Entry) and one.fits(value)):
            continue
        allowed = one.allowed if isinstance(one, Entry) else "a table"
        raise InputError(f"{where}: {key}", f"{value!r}"[:60], allowed)


def described(
    summary: Mapping[str, Any], entries: Iterable[Entry] = SUMMARY
) -> Iterator[tuple[str, Any, Entry | dict[str, Any] | None]]:
    """All keys of a summary with their values, and what is described of them.

    That is an `Entry`, a dictionary of those of a table where there is none, or None.
    """
    tree: dict[str, Any] = {}
    for one in entries:
        *above, last = one.name.split(".")
        place = tree
        for part in above:
            place = place.setdefault(part, {})
        place[last] = one
    yield from _told(summary, tree, "")


def _told(value: Any, known: Any, key: str) -> Iterator[tuple[str, Any, Any]]:
    if isinstance(value, list) and key == "source":
        for number, item in enumerate(value):
            yield from _told(item, known, f"{key}[{number}]")
    elif isinstance(value, Mapping) and isinstance(known, dict):
        anyone = next((name for name in known if name.isupper()), None)
        for name, item in value.items():
            yield from _told(item, known.get(name, known.get(anyone)), f"{key}.{name}" if key else str(name))
    else:
        yield key, value, known
