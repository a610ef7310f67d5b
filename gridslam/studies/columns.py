"""What the files of a study hold: keys and columns, with types, units, ranges and meanings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from gridslam.runs.summary import AGENT, NETWORK, Entry, Kind

NEVER, NO_BOUND, NO_HEADING, NO_SURFACES = (
    "never", "no bound counts what was heard", "nothing tells the heading", "a method that maps none"
)  # fmt: skip
ONE_SEED = "one seed"


def _number(name: str, unit: str, meaning: str, without: str = NEVER) -> Entry:
    return Entry(name, unit, meaning, without, 0)


def _count(name: str, meaning: str, without: str = NEVER) -> Entry:
    return Entry(name, "1", meaning, without, 0, kind="whole number")


def _length(name: str, meaning: str, without: str = NEVER) -> Entry:
    return _number(name, "m", meaning, without)


def _of_heading(name: str, of: str, unit: str = "deg") -> Entry:
    return _number(name, unit, f"as `{of}`, of the heading", NO_HEADING)


def _flat(scores: Iterable[Entry], first: str = "") -> tuple[Entry, ...]:
    """Scores as columns, those in tables by names of their own."""
    return tuple(replace(one, name=first + one.name.replace(".", "_")) for one in scores)


def _text(name: str, meaning: str, without: str = NEVER) -> Entry:
    return Entry(name, "1", meaning, without, kind="text")


HEAD = (
    replace(_text("format", "what it is"), words=("gridslam-study",)),
    _count("version", "of this format"),
    _text("gridslam", "version of the program"),
    Entry("scenes", "1", "scenes as TOML, whole", NEVER, kind="list of text"),
    Entry("settings", "1", "keys of the scene file that were varied, each with its values", NEVER,
          kind="list"),
    Entry("agents", "1", "agents that were asked for; empty for all", NEVER, kind="list of text"),
    replace(_text("start", "what agents were told of their start"), words=("drawn", "exact")),
)  # fmt: skip
"""Of the first line of ``study.jsonl``."""


def _by_step(name: str, unit: str, meaning: str, several: bool = False) -> Entry:
    kind: Kind = "lists of numbers" if several else "list of numbers"
    return Entry(f"agents.NAME.steps.{name}", unit, meaning, "what there isn't", 0, kind=kind)


RECORD = (
    _text("key.scene", "name of the scene"),
    _text("key.hash", "beginning of the SHA-256 of its settings"),
    Entry("key.settings", "1", "the settings that were varied", NEVER, kind="table"),
    _text("key.method", "as `--method` takes it"),
    _count("key.seed", "of measurements, starts and filter"),
    Entry("key.agents", "1", "agents in turn, each from the map that the one before it left", NEVER,
          kind="list of text"),
    replace(_text("key.start", "as in the first line"), words=("drawn", "exact")),
    _text("key.gridslam", "version of the program"),
    _text("source", "beginning of the SHA-256 of the file of a method of one's own; null of others"),
    _number("agents.NAME.cost.seconds_per_step", "s", "as in `run.json`"),
    _number("agents.NAME.cost.peak_memory_mb", "MB", "as in `run.json`"),
    Entry("agents.NAME.scores", "1", "as `agents.NAME` in `run.json`, without these two", NEVER,
          kind="table"),
    _by_step("position_error_m", "m", "by step, in single precision, as all that follow"),
    replace(_by_step("heading_error_rad", "rad", "error of the heading, with its sign"),
            least=-np.pi, most=np.pi),
    _by_step("position_nees", "1", "squared position error in units of the claimed covariance"),
    _by_step("heading_nees", "1", "the same of the heading"),
    _by_step("position_claimed_m", "m", "standard deviation of the position that the filter claims"),
    _by_step("surface_ospa_m", "m", "OSPA distance of found to true surfaces that paths had hit by then"),
    _by_step("image_ospa_m", "m",
             "the same of virtual anchors of the paths believed in, against those of the visible ones"),
    _by_step("surfaces", "1", "surfaces found"),
    _by_step("surface_error_m", "m",
             "by true surface: how far off the found one is that the best assignment gives it; null where"
             " that gives none within 5 m", several=True),
    _by_step("rays", "1", "by anchor: paths that were believed in", several=True),
    _by_step("ray_belief", "1", "by anchor: sum of their probabilities", several=True),
    Entry("network", "1", "as in `run.json`, of several agents at once", "agents in turn", kind="table"),
)  # fmt: skip
"""Of each other line."""
WHO = tuple(
    Entry(name, "1", meaning, NEVER, kind="text")
    for name, meaning in (
        ("scene", "name of the scene; settings that were varied have columns of their own after it"),
        ("method", "as `--method` takes it"),
        ("agent", "whose row it is"),
    )
)
RUNS = (
    *WHO,
    _count("seed", "of measurements, starts and filter"),
    *_flat(one for one in AGENT if "why" not in one.name),
    *_flat((one for one in NETWORK if "ANCHOR" not in one.name), "network_"),
)
"""Of ``runs.csv``; those of `network` in studies of several agents at once."""
STEPS = (
    *WHO,
    _count("step", "from 0 on"),
    _count("runs", "how many were taken together"),
    _length("position_rmse_m", "root mean square of the position errors of that step, over the runs"),
    _length("position_p10_m", "their tenth percentile"),
    _length("position_p90_m", "their ninetieth"),
    _length("position_known_map_bound_m",
            "Cramér-Rao bound of a filter that knows the walls: of it `position_bound_m` in `runs.csv` is the"
            " root mean square over all steps", NO_BOUND),
    _length("position_unknown_map_bound_m", "that of one that doesn't", NO_BOUND),
    _of_heading("heading_rmse_deg", "position_rmse_m"),
    _of_heading("heading_p10_deg", "position_p10_m"),
    _of_heading("heading_p90_deg", "position_p90_m"),
    _of_heading("heading_known_map_bound_deg", "position_known_map_bound_m"),
    _of_heading("heading_unknown_map_bound_deg", "position_unknown_map_bound_m"),
    _number("position_nees", "1", "mean squared position error in units of the claimed covariance"),
    _number("position_nees_low", "1",
            "lower end of the band that holds that mean in 95 % of all cases, were the claims true"),
    _number("position_nees_high", "1", "upper end"),
    _of_heading("heading_nees", "position_nees", "1"),
    _length("mospa_m", "mean OSPA distance of found to true surfaces that paths had hit by then",
            NO_SURFACES),
    _length("mospa_at_bounds_m",
            "mapping error bounds of the walls in the mean ([Li2025adaptive], Fig. 6a): no bound of"
            " `mospa_m`, since they are root mean squares and that is a mean, and they let walls move a"
            " little that stand still", NO_BOUND),
    _length("image_mospa_m", "the same as `mospa_m` of virtual anchors, as in `study.jsonl`", NO_SURFACES),
    _number("surfaces", "1", "mean number of surfaces found", NO_SURFACES),
    _count("surfaces_true", "of those that true paths had hit by then"),
    _number("rays", "1", "mean number of paths that were believed in, of all anchors"),
    _number("ray_belief", "1", "mean sum of their probabilities"),
    _count("rays_true", "paths that were visible"),
    _count("rays_likely", "those that are likelier heard than missed"),
)  # fmt: skip
"""Of ``steps.csv``."""
SUMMARY = (
    *WHO,
    _count("runs", "how many were taken together"),
    _count("diverged", "runs of which any position error exceeded 0.5 m after step 10"),
    _length("position_settled_rmse_m", "root mean square of the position errors, over runs and steps"),
    _number("position_to_known_map_bound", "1",
            "root mean square of the position errors over the bound of a filter that knows the walls",
            NO_BOUND),
    _number("position_to_unknown_map_bound", "1", "that over the bound of one that doesn't", NO_BOUND),
    _length("position_settled_standard_error_m",
            "standard error of `position_settled_rmse_m` over the seeds, by the runs' own mean squares",
            ONE_SEED),
    Entry("position_less_first_m", "m",
          "root mean square of the position errors minus that of the first method of the same scene, settings"
          " and agent, over the seeds that both have", "the first method"),
    _length("position_less_first_standard_error_m",
            "standard error of that difference, in which what the seeds have in common cancels",
            f"the first method, or {ONE_SEED}"),
    _of_heading("heading_settled_rmse_deg", "position_settled_rmse_m"),
    _of_heading("heading_to_known_map_bound", "position_to_known_map_bound", "1"),
    _of_heading("heading_to_unknown_map_bound", "position_to_unknown_map_bound", "1"),
    _of_heading("heading_settled_standard_error_deg", "position_settled_standard_error_m"),
    _number("position_settled_nees", "1",
            "mean squared position error in units of the claimed covariance, over runs and steps: 2 is"
            " right"),
    _number("position_settled_median_nees", "1",
            "median of the same, which single steps don't rule: 1.39 is right"),
    _count("silent_steps", "the sum of those in `runs.csv`, of all steps", "a run has none"),
    Entry("nees_in_band", "1", "share of all steps whose mean squared position error lies in its 95 % band",
          NEVER, 0, 1),
    _length("surface_ospa_m", "mean OSPA distance of found to true surfaces at the end", NO_SURFACES),
    _length("surface_gospa_m",
            "mean GOSPA distance of them at the end: a sum, in which each missing or false one counts 2.5 m",
            f"{NO_SURFACES}, or a run was done before this was counted"),
    _length("image_ospa_m", "OSPA distance of virtual anchors, as in `study.jsonl`, over the steps",
            NO_SURFACES),
    Entry("ray_excess", "1", "paths believed in minus those that were visible, per anchor and step",
          "a method that tells no paths"),
    Entry("likely_ray_excess", "1", "minus those that are likelier heard than missed",
          "a method that tells no paths"),
    _number("seconds_per_step", "s", "median of the runs' times of a step, each the median of its steps"),
)  # fmt: skip
"""Of ``summary.csv``, over the steps on from step 50 (of shorter tracks in the second half)."""
