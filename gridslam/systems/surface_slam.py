"""What systems that map by surfaces share: agent and surfaces in one belief, heard anchor by anchor."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.errors import InputError
from gridslam.estimates import Estimate, SurfaceEstimate
from gridslam.inference.management import ghosts, pose_recovery
from gridslam.inference.management.readout import estimates, surface_estimate
from gridslam.inference.messages.birth_proposals import propose
from gridslam.inference.messages.births import Births, bear
from gridslam.inference.messages.cells import Cells
from gridslam.inference.messages.likelihood import AmplitudeBelief, DetectionTable
from gridslam.inference.messages.likelihood_ratios import Evaluation, evaluate
from gridslam.inference.messages.prediction import Prediction, paths_now
from gridslam.inference.messages.updates import update
from gridslam.inference.state import surface_bank
from gridslam.inference.state.anchor_measurements import Heard, hear
from gridslam.inference.state.belief import AGENT, Belief, append, predict, separated
from gridslam.inference.state.calibration import ENOUGH, Watch
from gridslam.inference.state.particles import Particles, Recipe
from gridslam.inference.state.path_messages import Notes
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.surface_bank import Bank
from gridslam.maps.frames import fitted, stamped
from gridslam.maps.map import Map
from gridslam.maps.run_identity import Identity
from gridslam.measurements.table import Scan
from gridslam.world.geometry import unit, wrap
from gridslam.world.radio import REFLECTION_BINS
from gridslam.world.scene import Scene

Array = NDArray[np.float64]
MOST_DOUBTFUL_M = 2.0
"""A birth whose offset is less certain than this is put off until the agent knows better where it is."""

JITTER = 0.2
"""Share of the papers' surface jitter that is used: it keeps particles apart, a Gaussian needs less."""


class SurfaceSlam:
    """Agent, surfaces and rays; a system adds what it knows of amplitudes and of the space between.

    Parameters
    ----------
    scene : Scene
        Radio, anchors, grid and filter settings; its walls are never read.
    agent : str, optional
        Which of the scene's agents (default: the first): start, prior and array.
    seed : int
    """

    shared = True
    """Whether a surface serves all anchors."""
    reflects = True
    """Whether a ray's amplitude follows from the coefficients of its surfaces (paper 003, eq. (2))."""

    def __init__(self, scene: Scene, agent: str | None = None, seed: int = 0) -> None:
        self.scene, self.seed = scene, seed
        if not scene.agents:
            raise InputError(f"{scene.name}: agents", "none", "at least one, to say where it starts")
        body = scene.agent(agent) if agent else scene.agents[0]
        self.agent, self.settings = body.name, scene.filter
        self.signal = self.told = scene.signal_model(body.name)
        self.watch = Watch.start(len(scene.anchors))
        self.places, self.facings = scene.anchor_positions, scene.anchor_orientations
        self.anchors = np.column_stack([self.places, self.facings])
        self.told_facings, self.faced = self.facings, b""
        half = np.array(
            [body.prior.position_m] * 2 + [body.prior.velocity_mps] * 2 + [np.radians(body.prior.heading_deg)]
        )
        variance = np.maximum(half, 1e-4) ** 2 / 3
        # the agent moves at an unknown speed from the first step on
        variance[2:4] += (body.step_m / body.interval_s) ** 2
        mean = np.array([*body.start_m, 0.0, 0.0, np.radians(body.start_heading_deg)])
        self.belief = Belief(mean, np.diag(variance))
        self.bank = Bank.empty(len(self.places))
        self.sight = np.full(len(self.places), 0.9)
        side = np.array(scene.grid.shape[::-1]) * scene.grid.cell_m
        self.middle = np.asarray(scene.grid.origin_m) + 0.5 * side
        self.radius_m = float(0.5 * np.hypot(*side))
        self.birth_rate = self.settings.births / (4 * np.pi * self.radius_m)
        self.particles = Particles(self.settings.particles, seed, self.settings.adapt_particles)
        self.most_bounces = scene.radio.max_bounces
        self.detected = DetectionTable(self.signal)
        self.notes = Notes(kept=False)
        self.last_time: float | None = None
        self.elapsed, self.start_velocity = 0.0, float(variance[2])
        self.next_identity, self.steps, self.crowd = 0, 0, 0
        self.provenance: dict[str, list] = {"agents": [], "seeds": [], "steps": [], "runs": []}
        self.identity = Identity(self.places)

    def start_at(self, position_m: Array, heading_rad: float) -> None:
        """Believe in another start (m, rad) than the scene's, as surely as its prior says.

        Raises
        ------
        InputError
            Something was heard already, or the start isn't finite.
        """
        if self.steps or self.last_time is not None:
            raise InputError("start", f"told after {self.steps} steps", "before the first")
        pose = np.array([*np.reshape(position_m, 2), heading_rad], dtype=np.float64)
        if not np.isfinite(pose).all():
            raise InputError("start", str(pose.tolist()), "finite numbers")
        self.belief.mean[[0, 1, 4]] = pose

    def step(self, scan: Scan) -> Estimate:
        """Take in what was heard at one step and return what is believed now.

        Raises
        ------
        InputError
            The scan makes no sense, see `Scan.checked`; the filter stays as it was.
        """
        began = time.perf_counter()
        scan = scan.checked(len(self.places), self.last_time)  # before anything is changed
        self._move(scan.time_s)
        self.watch.begin(len(scan))
        self._face(self.watch.taken)
        scans = hear(scan, self.places, self.facings, self.told.threshold)
        self._find_again(scans)
        for heard in scans:
            self.signal = self.watch.tuned(self.told, heard.anchor)
            self._take_in(heard)
            if not self.settings.correlated:
                self.belief = separated(self.belief)
        self.watch.judge()
        self._tidy()
        self.identity.hear(scan)
        return self._estimate(scan, time.perf_counter() - began)

    def _take_in(self, heard: Heard) -> None:
        """Messages of one anchor."""
        raise NotImplementedError

    def map(self) -> Map:
        """The map as it stands: detected surfaces, and a grid of which nothing was observed."""
        table = surface_estimate(self.belief, self.bank)
        found = table.existence > self.settings.detect_above
        grid, bins = self.scene.grid, len(REFLECTION_BINS)
        provenance: dict[str, Any] = {
            "agents": [*self.provenance["agents"], self.agent],
            "seeds": [*self.provenance["seeds"], self.seed],
            "steps": [*self.provenance["steps"], self.steps],
            "runs": [*self.provenance["runs"], self.identity.text],
        }
        sheet = Map(
            np.array(grid.origin_m), grid.cell_m, np.zeros(grid.shape, np.float32),
            np.zeros((*grid.shape, bins), np.float32), np.zeros(grid.shape, dtype=bool),
            float(1 - np.exp(-grid.cell_m / self.settings.mean_free_path_m)), table.take(found),
            self.bank.reflection[found].copy(), provenance,
        )  # fmt: skip
        return stamped(sheet, self.scene)

    def _start_from(self, prior: Map) -> Map:
        """Start from the surfaces that another agent left; return the map on the scene's grid.

        Raises
        ------
        InputError
            The map is of another frame.
        """
        prior, _ = fitted(prior, self.scene)
        for key in self.provenance:
            earlier = prior.provenance.get(key)
            self.provenance[key] = list(earlier) if isinstance(earlier, list) else []
        unknown = len(self.provenance["agents"]) - len(self.provenance["runs"])
        self.provenance["runs"] = [""] * unknown + self.provenance["runs"]  # of earlier versions
        known = prior.surfaces if prior.surfaces is not None else SurfaceEstimate.empty()
        self._inherit(known, prior.surface_reflection)
        return prior

    def _move(self, now: float) -> None:
        """Motion of the agent, jitter of the surfaces, survival (paper 003, section III-C)."""
        if self.last_time is not None:
            self.elapsed = now - self.last_time
            predict(
                self.belief,
                self.elapsed,
                self.settings.acceleration_mps2,
                np.radians(self.settings.heading_deg),
                JITTER * self.settings.surface_m,
                self.bank.foot,
            )
            surface_bank.evolve(self.bank, self.settings.survival, self.settings.reflection)
        self.last_time = now

    def _face(self, turned: Array) -> None:
        """Turn the anchors by (J,) rad from what the scene says."""
        if turned.tobytes() != self.faced:
            facings = wrap(self.told_facings + turned)
            anchors = np.column_stack([self.places, facings])
            self.facings, self.anchors, self.faced = facings, anchors, turned.tobytes()

    def _find_again(self, scans: list[Heard]) -> None:
        """Where the belief can't be followed from the last step on, find the agent by the map."""
        count, self.crowd = sum(int(np.count_nonzero(heard.loud)) for heard in scans), 0
        vague = pose_recovery.is_vague(self.belief)
        if count < ENOUGH and not vague:
            return
        near = pose_recovery.near_paths(scans, self.bank, self.belief, self.anchors, self.told)
        lost = self.watch.lost(count, near)
        if not (lost or vague):
            return
        rays = paths_now(self.bank, self.sight, self.belief, self.anchors, 1, self.particles)
        sources = pose_recovery.sources(
            rays, self.belief, self.places, self.bank.reflection @ REFLECTION_BINS
        )
        belief = self.belief
        if lost:
            belief = pose_recovery.freed(belief, self.elapsed, self.settings.acceleration_mps2)
        self.crowd = pose_recovery.crowd(scans)
        with runtime.one_blas_thread():
            fix = pose_recovery.find_pose(
                belief, self.belief, sources, scans, self.detected, self.watch.tuned(self.told, 0),
                self._stream(len(scans), 2),
            )  # fmt: skip
        if fix is not None and fix.clear and (fix.better or not lost):
            self.belief = pose_recovery.moved(belief, fix, self.start_velocity)
            self.watch.found(lost)

    def _stream(self, anchor: int, purpose: int) -> list[int]:
        """Random stream of this step: a function of seed, step, anchor and what for."""
        return [self.seed, self.steps, anchor, purpose]

    def _space(self) -> Cells | None:
        """What is known of the space between, if anything is."""
        return None

    def _associate(self, heard: Heard, said: Evaluation) -> tuple[Array, Array] | None:
        """Messages (nu, claimed) of a data association of a system's own; None for that of the papers."""
        return None

    def _exchange(
        self, heard: Heard, rays: Rays, predicted: Prediction, amplitudes: AmplitudeBelief, validity: Array,
        recipe: Recipe,
    ) -> tuple[Evaluation, Births]:  # fmt: skip
        """Evaluate and associate measurements; update agent, surfaces and the existence of rays.

        Parameters
        ----------
        validity : (L,)
            V: probability that the path is open.
        recipe : Recipe
            Of the particles.

        Returns
        -------
        (said, births)
            What the measurements said, with the messages of the association, and the births they propose.
        """
        # measurement evaluation
        signal, anchor = self.signal, heard.anchor
        radio = signal.radio(anchor)
        cloud, said = evaluate(
            rays, predicted, validity, heard, amplitudes, self.detected, radio, recipe, self.anchors
        )
        # clutter level, by what no path can have caused
        level = self.watch.listen(anchor, said.clutter, self.told)
        if level != signal.false_alarms:
            said.against(level / signal.false_alarms)
            radio = replace(signal, false_alarms=level).radio(anchor)
        # births
        births = propose(
            heard, self.belief, self.bank, cloud, said, self._space(), radio, self.anchors,
            self.birth_rate, self.most_bounces,
        )  # fmt: skip
        given = self._associate(heard, said)
        # association, updates
        update(
            self.belief, self.bank, self.sight, rays, predicted, heard, said, given, self.watch,
            self.told.radio(anchor), self.anchors, self.notes,
        )  # fmt: skip
        return said, births

    def _bear(self, heard: Heard, births: Births, claimed: Array) -> list[tuple[int, int, int]]:
        """Add the new surfaces that are likely enough.

        Returns
        -------
        list of (measurement, last, first)
            What bore each, and the identities of the surfaces along the ray that did.
        """
        bearers, radio = [], self.signal.radio(heard.anchor)
        for one, existence in births.chosen(claimed, 0.5 * self.settings.prune_below):
            fresh, reflection = bear(births, one, heard, self.belief, radio, self.anchors)
            if fresh.covariance[-1, -1] > MOST_DOUBTFUL_M**2 or not np.isfinite(fresh.mean).all():
                continue
            ends = tuple(births.hit[one].tolist())
            bank = self.bank.add(
                self.next_identity,
                existence,
                reflection,
                float(fresh.mean[:2] @ unit(fresh.lines[-1, 0] + 0.5 * np.pi)),
                (heard.anchor, *ends),
                -1 if self.shared else heard.anchor,
            )
            self.belief, self.bank = fresh, bank  # both or, should anything interrupt, none
            self.next_identity += 1
            last, first = (int(self.bank.identity[s]) for s in ends)  # -1 is the last, which is the new one
            bearers.append((int(births.measurement[one]), last, first))
        return bearers

    def _tidy(self) -> None:
        """Merge duplicates, drop ghosts and the unlikely."""
        self.bank, self.belief = surface_bank.merge(self.bank, self.belief)
        if self.most_bounces > 1:
            self.bank, self.belief = ghosts.lay(self.bank, self.belief, self.places)
        self.bank, self.belief = surface_bank.prune(self.bank, self.belief, self.settings.prune_below)
        self.steps += 1

    def _inherit(self, known: SurfaceEstimate, reflection: Array | None) -> None:
        """Start with surfaces that another agent left, as independent of this agent."""
        for row in range(len(known)):
            self.belief = append(self.belief, known.line[row], known.line_cov[row])
            bins = np.full(len(REFLECTION_BINS), 1 / len(REFLECTION_BINS))
            foot = float(np.nan_to_num(known.extent_m[row].mean()))
            self.bank = self.bank.add(
                self.next_identity,
                float(known.existence[row]),
                bins if reflection is None else np.asarray(reflection[row], np.float64),
                foot,
                (0, -1, -1),
            )
            self.bank.extent[-1] = known.extent_m[row]
            self.bank.seen[-1] = self.bank.age[-1] = surface_bank.SETTLED
            self.next_identity += 1
        self.bank.single[:] = surface_bank.FRESH_SINGLE

    def _strength(self, rays: Rays, distance: Array) -> Array:
        """Amplitudes (L,) of rays of given distances (L,), where they don't follow from coefficients."""
        raise NotImplementedError

    def _estimate(self, scan: Scan, seconds: float) -> Estimate:
        """MMSE estimates of agent and surfaces, and the paths believed in."""
        mean = self.belief.mean
        variance = float(self.belief.covariance[0, 0] + self.belief.covariance[1, 1])
        names = self.scene.anchor_names
        health = self.watch.health(self.told, np.sqrt(variance), self.particles.drawn, names)
        if self.crowd:
            why = f"{self.crowd} loud paths of one anchor: {pose_recovery.MOST_LOUD} of them propose poses"
            health = replace(health, ok=False, why="; ".join(filter(None, (health.why, why))))
        table, paths = estimates(
            self.belief, self.bank, self.sight, self.anchors, self.most_bounces, self.signal.amplitude_at_1m,
            None if self.reflects else self._strength,
        )  # fmt: skip
        return Estimate(
            scan.step, scan.time_s, mean[:2].copy(), mean[2:4].copy(), float(wrap(mean[4])),
            self.belief.covariance[:AGENT, :AGENT].copy(), table, paths,
            table.existence > self.settings.detect_above, health.effective_sample_size, seconds, health,
        )  # fmt: skip
