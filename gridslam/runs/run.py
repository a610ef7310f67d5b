"""What a run returns: the track, the surfaces, the map, and how good they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from typing import TYPE_CHECKING, Any

import numpy as np

from gridslam.errors import InputError
from gridslam.estimate_tables import SurfaceEstimate
from gridslam.estimates import AnchorEstimate, Estimate
from gridslam.maps.map import Map
from gridslam.runs.summary import AGENT, MAP, blank
from gridslam.wording import counted
from gridslam.world.filter_model import detected
from gridslam.world.scene import Scene
from gridslam.world.start import Start
from gridslam.world.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gridslam.simulation.image_source import Truth


@dataclass(frozen=True, eq=False)
class Run:
    """One agent's run.

    Attributes
    ----------
    scene : Scene
        Resolved scene, with the settings that the run used.
    agent, method, device : str
        Who, how and where.
    seed : int
        Seed of all random numbers.
    estimates : list of Estimate
        One per step, (N).
    trajectory : Trajectory
        Estimated track, N poses.
    covariance : (N, 5, 5) float64
        Of [x, y, vx, vy, heading] at each step.
    surfaces : SurfaceEstimate
        Surfaces detected at the end.
    map : Map
        The map at the end.
    seconds_per_step, peak_memory_mb : float
        What the run cost: the median time of a step, the greatest memory.
    interrupted : bool
        Whether it was stopped before the last measurement.
    began : Start
        The start that the filter assumed.
    unheard : tuple of int
        Steps at which nothing was heard at all.
    """

    scene: Scene
    agent: str
    method: str
    seed: int
    device: str
    estimates: list[Estimate]
    trajectory: Trajectory
    covariance: np.ndarray
    surfaces: SurfaceEstimate
    map: Map
    seconds_per_step: float
    peak_memory_mb: float
    began: Start
    interrupted: bool = False
    unheard: tuple[int, ...] = ()

    @property
    def start(self) -> str:
        """How the start was taken: "drawn" from the prior, "exact", "told", or "scene" (as written there)."""
        return self.began.how

    def __repr__(self) -> str:
        """One line."""
        whole = ", interrupted" if self.interrupted else ""
        who = f"{self.agent} in {self.scene.name} by {self.method}, seed {self.seed}"
        size = f"{counted(len(self.estimates), 'step')}, {counted(len(self.surfaces), 'surface')}"
        unwell = sum(not one.health.ok for one in self.estimates)
        whole = f", unwell at {counted(unwell, 'step')}{whole}" if unwell else whole
        return f"<Run of {who}: {size}{whole}>"

    def plot(
        self,
        truth: Truth | Trajectory | None = None,
        earlier: Sequence[Truth] = (),
        width_cm: float | None = None,
    ) -> Figure:
        """A figure of the map and the track, with the true track if there is one.

        Parameters
        ----------
        truth : Truth, Trajectory or None
            A Truth tells which surfaces lie where no wall is, too.
        earlier : sequence of Truth
            As in `score`; the figure is the same without them.
        width_cm : float, optional
            Of the figure, cm, from 5 to 50, as ``gridslam plot --width``: 8.8 suits a column of a paper, and
            letters follow. Default: 18.3.

        Returns
        -------
        matplotlib.figure.Figure
            Notebooks show it; ``savefig`` writes it.

        Raises
        ------
        InputError
            The truth, or one of the earlier ones, is none or that of another scene, or no such width.
        """
        from gridslam.drawing.map_figure import draw_map, fit_legends
        from gridslam.drawing.widths import fonts, inches
        from gridslam.evaluation.surface_truth import false_surfaces
        from gridslam.simulation.image_source import Truth

        track, false = self._own_track(truth, earlier), None
        if isinstance(truth, Truth):
            false = false_surfaces(self.map.surfaces, truth)
        shown = self.map, self.scene, self.trajectory, track, self.estimates
        if width_cm is None:  # letters are the user's
            return draw_map(*shown, false=false)
        width = inches(width_cm)
        with fonts(width):
            figure = draw_map(*shown, width, false)
            fit_legends(figure)
        return figure

    def _repr_html_(self) -> str:
        from gridslam.drawing.map_figure import inlined

        return inlined(self.plot(), repr(self)[1:-1])

    def score(self, truth: Truth | Trajectory | None = None, earlier: Sequence[Truth] = ()) -> dict[str, Any]:
        """Score the run; the keys are those of one agent in ``run.json``.

        Parameters
        ----------
        truth : Truth, Trajectory or None
            A track alone gives the errors of the track. What lacks its truth is None.
        earlier : sequence of Truth
            Of the agents whose map the run began with: map and surfaces, which hold what they found, are
            judged against the paths of all; the track against its own truth.

        Notes
        -----
        A run that ended early is judged against the steps it did. The bounds are the root mean squares over
        the run of `gridslam.evaluation.bounds.known_map_bound`; silence counts as such
        (`gridslam.evaluation.ground_truth.heard_paths`).

        Raises
        ------
        InputError
            The truth, or one of the earlier ones, is none or that of another scene; or the track doesn't
            cover the run.
        """
        from gridslam.evaluation.consistency import complaints, nees, wrong_and_well
        from gridslam.evaluation.ground_truth import known_bound, tells_heading
        from gridslam.evaluation.metrics import (
            diverged,
            map_scores,
            p95,
            reflection_mae,
            rmse,
            track_errors,
        )
        from gridslam.evaluation.surface_truth import surface_scores
        from gridslam.simulation.image_source import Truth
        from gridslam.systems.registry import kind_of, maps_features

        track = self._own_track(truth, earlier)
        found = self.surfaces.take(detected(self.surfaces.existence, self.scene.filter))
        maps_surfaces = self.map.surfaces is not None or len(found) > 0
        scores: dict[str, Any] = blank(AGENT) | {
            "steps": len(self.trajectory),
            "interrupted": self.interrupted,
            "position_std_m": float(np.sqrt(np.trace(self.covariance[:, :2, :2], axis1=1, axis2=2).mean())),
            "heading_std_deg": float(np.degrees(np.sqrt(self.covariance[:, 4, 4].mean()))),
            "surfaces_detected": len(found) if maps_surfaces else None,
            "features": maps_features(self.method, self.map.features),
            "map": blank(MAP),
            "health": {
                "unwell_steps": sum(not e.health.ok for e in self.estimates),
                "why": complaints(self.estimates),
                "most_hypotheses": max((len(e.hypotheses) for e in self.estimates), default=0),
            },
            "seconds_per_step": float(self.seconds_per_step),
            "peak_memory_mb": float(self.peak_memory_mb),
        }
        if self.estimates and self.estimates[-1].heights:
            scores["heights"] = self._heights(isinstance(truth, Truth), track)
        if self.estimates and self.estimates[-1].coefficients:
            scores["coefficients"] = self._coefficients(isinstance(truth, Truth))
        if self.estimates and self.estimates[-1].anchors:
            scores["anchors"] = {name: _stands(one) for name, one in self.estimates[-1].anchors.items()}
        if track is not None and not track.in_hole(self.trajectory.time_s).all():
            seen = ~track.in_hole(self.trajectory.time_s)
            position, heading = (error[seen] for error in track_errors(self.trajectory, track))
            claimed = self.covariance[seen, :2, :2]
            each = nees(position, claimed)
            squared, middle = float(each.mean()), float(np.median(each))
            length, own = np.linalg.norm(position, axis=1), np.sqrt(np.trace(claimed, axis1=1, axis2=2))
            scores |= {
                "position_rmse_m": rmse(position),
                "position_p95_m": p95(position),
                "heading_rmse_deg": float(np.degrees(rmse(heading))),
                "final_position_error_m": float(np.linalg.norm(position[-1])),
                "diverged": diverged(position),
                "position_nees": squared if np.isfinite(squared) else None,  # of a deviation of 0
                "position_median_nees": middle if np.isfinite(middle) else None,
                "silent_steps": wrong_and_well(list(compress(self.estimates, seen)), length, own),
            }
        takes = kind_of(self.method)
        bound = known_bound(self.scene, self.agent, truth, takes, self.unheard)
        if bound is not None:
            done = slice(len(self.trajectory))
            scores["position_bound_m"] = rmse(bound.position_m[done])
            scores["heading_bound_deg"] = float(np.degrees(rmse(bound.heading_rad[done])))
        if not tells_heading(self.scene, self.agent, takes):
            scores |= dict.fromkeys(("heading_rmse_deg", "heading_bound_deg", "heading_std_deg"))
        if isinstance(truth, Truth):
            whole = truth.first(len(self.trajectory)).joined(earlier)
            if maps_surfaces:  # nor does every method tell surfaces
                scores |= surface_scores(found, whole)
                scores["reflection_mae"] = reflection_mae(self.map, whole.segments)
            if self.map.observed.any():  # not every method tells cells
                scores["map"] = map_scores(self.map, whole.segments, whole.paths)
        return scores

    def _coefficients(self, simulated: bool) -> dict[str, dict[str, float | None]]:
        """Coefficients of floor and ceiling as estimated, deviations, and errors where all is simulated."""
        levels = {"floor": self.scene.floor, "ceiling": self.scene.ceiling}
        true = {n: level.coefficient for n, level in levels.items() if simulated and level is not None}
        return {
            name: {"coefficient": found, "std": std, "error": found - true[name] if name in true else None}
            for name, (found, std) in self.estimates[-1].coefficients.items()
        }

    def _heights(self, simulated: bool, went: Trajectory | None) -> dict[str, dict[str, float | None]]:
        """Estimated heights, their deviations, and errors where scene or true track have them, m."""
        true = (
            {name: one[0] for name, one in self.scene.uncertain_heights(self.agent).items()}
            if simulated
            else {}
        )
        last = self.estimates[-1]
        if went is not None and went.height_m is not None:
            true["agent"] = float(np.interp(last.time_s, went.time_s, went.height_m))
        return {
            name: {"height_m": height, "std_m": std, "error_m": height - true[name] if name in true else None}
            for name, (height, std) in last.heights.items()
        }

    def _own_track(self, truth: Truth | Trajectory | None, earlier: Sequence[Truth]) -> Trajectory | None:
        """The true track of whatever a user hands over as the truth, if all of it can be this run's."""
        from gridslam.evaluation.ground_truth import require_earlier, require_same_world
        from gridslam.simulation.image_source import Truth

        if not isinstance(truth, Truth | Trajectory | None):
            raise InputError("truth", type(truth).__name__, "a Truth (gs.ground_truth) or a Trajectory")
        require_earlier(self.scene, earlier)
        if not isinstance(truth, Truth):
            return truth
        require_same_world(self.scene, self.agent, self.trajectory.time_s, truth)
        return truth.trajectory


def _stands(anchor: AnchorEstimate) -> dict[str, float]:
    """How an anchor stands, in the units of scenes."""
    return {
        "x_m": float(anchor.position_m[0]), "y_m": float(anchor.position_m[1]),
        "position_std_m": anchor.position_std_m,
        "orientation_deg": float(np.degrees(anchor.orientation_rad)),
        "orientation_std_deg": float(np.degrees(anchor.orientation_std_rad)),
    }  # fmt: skip
