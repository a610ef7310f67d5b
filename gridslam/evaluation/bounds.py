"""Posterior Cramer-Rao bounds: what no filter can beat on average, [Tichavsky1998pcrb].

The joint state is [x, y, vx, vy, heading, angle_1, offset_1, ...]: the agent, then the lines of the true
surfaces. The recursion runs in information form, in which a surface that nothing has told of yet is a zero.
Paths are those that are truly visible, each weighted by its detection probability, or those that were
detected, with `detected`; which measurement is which path counts as known. So the bounds are those of
[Li2025adaptive], section VI-B, taken at the true track; docs/model.md, (M47). The amplitude's own
information about geometry is left out: it is below a thousandth of that of the distance. The motion and the
jitter of the surfaces are those that the filter assumes: of walls that stand still, a filter may know a
little more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.evaluation.path_slopes import (
    follow_hits,
    hit_surfaces,
    path_information,
    surface_lines,
    whitened_jacobian,
    with_elevations,
)
from gridslam.evaluation.surface_truth import middle_of_walls
from gridslam.inference.beliefs.layout import AGENT
from gridslam.simulation.image_source import TruePaths, true_paths
from gridslam.world.geometry import moved_lines, sfv_covariance
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory

JITTER_SHARE = 0.2
"""Share of ``filter.surface_m`` by which the filter lets a surface move along its normal per step."""
TURN_LEVER_M = 5.0
"""A surface that may shift by j at its wall may turn by j over this length."""
BLIND, REACHED = 1e-11, 1e-6
"""Relative information that counts as none; share of an unknown direction that makes a quantity unknown."""


@dataclass(frozen=True, eq=False)
class Bound:
    """Root mean square errors that can't be beaten.

    Attributes
    ----------
    position_m : (N,) m
    heading_rad : (N,) rad
    """

    position_m: Array
    heading_rad: Array


@dataclass(frozen=True, eq=False)
class MapBound(Bound):
    """Bound of an agent that finds the map as it goes.

    Attributes
    ----------
    surface : (S,) int
        Surfaces of ``scene.segments()`` that some visible path hit, by this agent or an earlier one.
    line : (S, 2) rad, m
        Their lines: normal angle and offset.
    surface_m : (N, S) m
        Mapping error bound: root mean square error of the surface feature vector (the mirror image of the
        scene's origin); infinite until the paths so far fix the surface.
    information : (2 S, 2 S)
        What is known of the lines at the end, for the agent that inherits the map.
    """

    surface: NDArray[np.intp]
    line: Array
    surface_m: Array
    information: Array


def known_map_bound(
    scene: Scene,
    agent: str,
    paths: TruePaths | None = None,
    track: Trajectory | None = None,
    detected: NDArray[np.intp] | None = None,
) -> Bound:
    """Bound of an agent that knows the walls.

    Parameters
    ----------
    scene : Scene
    agent : str
    paths : TruePaths, optional
        What ``true_paths(scene, agent)`` gives, if it is at hand.
    track : Trajectory, optional
        Another way than the scene's, to which `paths` belong.
    detected : (D,) int, optional
        As in `unknown_map_bound`.
    """
    track = scene.track(agent) if track is None else track
    paths = true_paths(scene, agent, track) if paths is None else paths
    paths, chance = _weighed(scene, agent, paths, detected)
    jacobian = whitened_jacobian(scene, agent, paths, hit_surfaces(scene, paths), track)
    jacobian = with_elevations(scene, agent, paths, jacobian[:, :, :AGENT])
    rows, rises = (
        path_information(paths, jacobian, len(track), chance),
        jacobian.shape[2] - AGENT,
    )
    information, bounds = _joined(agent_prior(scene, agent), _height_prior(scene, agent)), []
    for step in range(len(rows)):
        if step:
            motion = agent_motion(scene, track.time_s, step, 0)
            information = predict_information(information, *_widened(*motion, rises))
        information = information + rows[step]
        bounds.append(agent_bound(estimable_covariance(information)))
    position, heading = np.transpose(bounds)
    return Bound(position, heading)


def unknown_map_bound(
    scene: Scene,
    agent: str,
    paths: TruePaths | None = None,
    jitter_m: float | None = None,
    before: MapBound | None = None,
    detected: NDArray[np.intp] | None = None,
) -> MapBound:
    """Bound of an agent that finds the surfaces as it goes, with no prior on them.

    Parameters
    ----------
    scene : Scene
    agent : str
    paths : TruePaths, optional
        What ``true_paths(scene, agent)`` gives, if it is at hand.
    jitter_m : float, optional
        Standard deviation, per step, of a surface's shift along its normal where it was last hit, as the
        filter assumes it (and of its turn about that place, over 5 m). Default: 0.2 of ``filter.surface_m``.
    before : MapBound, optional
        Bound of the earlier agent whose map this one starts from.
    detected : (K,) int, optional
        Rows of `paths` that a run detected, -1 for clutter, as from `simulate_labelled`: the bound given what
        was heard, docs/model.md, (M371). Where little is heard, its mean square over many runs is well above
        the bound without it, which no filter reaches then, [Tong2012detection].

    Raises
    ------
    InputError
        No such agent, or `detected` isn't rows of `paths`.
    """
    paths = true_paths(scene, agent) if paths is None else paths
    paths, chance = _weighed(scene, agent, paths, detected)
    jitter = JITTER_SHARE * scene.filter.surface_m if jitter_m is None else jitter_m
    surface = hit_surfaces(scene, paths)
    if before is not None:
        surface = np.union1d(surface, before.surface)
    line, rows = surface_lines(scene)[surface], whitened_jacobian(scene, agent, paths, surface)
    times = scene.track(agent).time_s
    whole = with_elevations(scene, agent, paths, rows)
    gained, rises = (
        path_information(paths, whole, len(times), chance),
        whole.shape[2] - rows.shape[2],
    )
    information = np.zeros((AGENT + 2 * len(surface),) * 2)
    information[:AGENT, :AGENT] = agent_prior(scene, agent)
    information = _joined(information, _height_prior(scene, agent))  # heights come last
    if before is not None:
        own = AGENT + (2 * np.searchsorted(surface, before.surface)[:, None] + np.arange(2)).ravel()
        information[np.ix_(own, own)] = before.information

    feet, bounds, middle = np.zeros(len(surface)), [], middle_of_walls(scene.segments())
    surface_m = np.full((len(gained), len(surface)), np.inf)
    for step in range(len(gained)):
        if step:
            motion = agent_motion(scene, times, step, len(surface), jitter, feet)
            information = predict_information(information, *_widened(*motion, rises))
        information = information + gained[step]
        covariance = estimable_covariance(information)
        bounds.append(agent_bound(covariance))
        blocks = AGENT + 2 * np.arange(len(surface))[:, None] + np.arange(2)
        own_covariance = covariance[blocks[:, :, None], blocks[:, None, :]]
        known = np.isfinite(own_covariance).all((1, 2))
        near, slope = moved_lines(line[known], -middle)
        spread = sfv_covariance(near, slope @ own_covariance[known] @ slope.transpose(0, 2, 1))
        surface_m[step, known] = np.sqrt(np.trace(spread, axis1=1, axis2=2))
        follow_hits(feet, scene, paths.at(step), surface, line)
    lines = np.arange(AGENT, AGENT + 2 * len(surface))
    rest = np.setdiff1d(np.arange(len(information)), lines)  # what the next agent doesn't share
    corner, cross = information[np.ix_(rest, rest)], information[np.ix_(rest, lines)]
    left = information[np.ix_(lines, lines)] - cross.T @ np.linalg.solve(corner, cross)
    position, heading = np.transpose(bounds)
    return MapBound(position, heading, surface, line, surface_m, 0.5 * (left + left.T))


def _weighed(
    scene: Scene, agent: str, paths: TruePaths, detected: NDArray[np.intp] | None
) -> tuple[TruePaths, Array]:
    """Paths over walls that can tell of something, and how much of what each of them tells arrives."""
    if detected is None:
        chance = scene.signal_model(agent).detection_probability(paths.amplitude)
        there = paths.of_walls
    else:
        chance = np.zeros(len(paths))
        chance[_rows(detected, len(paths))] = 1.0
        there = paths.of_walls & (chance > 0)
    return paths.take(there), chance[there]


def _rows(detected: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """The rows of paths that were detected.

    Raises
    ------
    InputError
        They are none.
    """
    rows = np.asarray(detected)
    if rows.ndim != 1 or not np.issubdtype(rows.dtype, np.integer):
        raise InputError("detected", f"{rows.dtype} of shape {rows.shape}", "row numbers of paths (K,)")
    wrong = rows[(rows < -1) | (rows >= count)]
    if len(wrong):
        raise InputError("detected", str(wrong[0]), f"-1 for clutter, or 0 to {count - 1}")
    rows = rows[rows >= 0]
    if len(np.unique(rows)) < len(rows):
        raise InputError("detected", "a row twice", "each path at most once")
    return rows


def predict_information(information: Array, backward: Array, push: Array, variance: Array) -> Array:
    """Information about the next state: (Q + F J^-1 F^T)^-1, without inverting J or Q.

    Parameters
    ----------
    information : (N, N)
        J, positive semidefinite; directions of which nothing is known are zero.
    backward : (N, N)
        F^-1.
    push : (N, K)
        How K independent noises move the state, Q = push diag(variance) push^T.
    variance : (K,)
        Above 0.
    """
    carried = backward.T @ information @ backward
    pressed = carried @ push
    gain = np.linalg.solve(push.T @ pressed + np.diag(1 / variance), pressed.T).T
    rest = np.eye(len(carried)) - gain @ push.T
    predicted = rest @ carried @ rest.T + (gain / variance) @ gain.T  # Joseph's form stays positive
    return 0.5 * (predicted + predicted.T)


def estimable_covariance(information: Array) -> Array:
    """Inverse of an information matrix (N, N) that may be blind to some directions.

    Rows and columns of entries that a blind direction reaches are infinite; the others are the covariance
    that is left once those are marginalised out.
    """
    scale = np.zeros(len(information))
    informed = np.diag(information) > 0
    scale[informed] = 1 / np.sqrt(np.diag(information)[informed])
    value, vector = np.linalg.eigh(information * np.outer(scale, scale))
    blind = value < BLIND * len(value)
    inverse = np.divide(1, value, out=np.zeros_like(value), where=~blind)
    covariance = np.asarray((vector * inverse) @ vector.T * np.outer(scale, scale))
    lost = ~informed | ((vector[:, blind] ** 2).sum(1) > REACHED)
    covariance[lost] = covariance[:, lost] = np.inf
    return covariance


def agent_prior(scene: Scene, agent: str) -> Array:
    """Information about [x, y, vx, vy, heading] at the start, (5, 5), as the filter assumes it."""
    body = scene.agent(agent)
    half = [body.prior.position_m] * 2 + [body.prior.velocity_mps] * 2 + [np.radians(body.prior.heading_deg)]
    variance = np.maximum(half, 1e-4) ** 2 / 3
    variance[2:4] += (body.step_m / body.interval_s) ** 2  # the prior's centre is rest, the track's isn't
    return np.diag(1 / variance)


def _height_prior(scene: Scene, agent: str) -> Array:
    """Information about unknown rises before the start, (G, G)."""
    return np.asarray(np.linalg.inv(scene.verticals(agent).rise_variance), np.float64)


def _joined(information: Array, other: Array) -> Array:
    """Information about what is independent."""
    return np.asarray(block_diag(information, other)) if other.size else information


def _widened(backward: Array, push: Array, variance: Array, heights: int) -> tuple[Array, Array, Array]:
    """A motion, of so many heights more that nothing moves."""
    if not heights:
        return backward, push, variance
    still = np.zeros((heights, push.shape[1]))
    return np.asarray(block_diag(backward, np.eye(heights))), np.concatenate([push, still]), variance


def agent_motion(
    scene: Scene, times: Array, step: int, surfaces: int, jitter: float = 0.0, feet: Array | None = None
) -> tuple[Array, Array, Array]:
    """Inverse transition, noise inputs and their variances from the step before (see predict_information).

    Parameters
    ----------
    times : (K,) s
        Of all steps.
    step : int
        From 1 on.
    surfaces : int
        How many, S.
    jitter : float, m
        Deviation of a surface's shift over a step, along its normal where it is hit; 0: surfaces stay.
    feet : (S,) m, optional
        Tangential coordinates of where they are hit, needed unless they stay.

    Returns
    -------
    (backward, push, variance)
        (N, N), (N, Q), (Q,), of N = 5 + 2 S entries; Q = 3 + 2 S noises, or 3 if surfaces stay.
    """
    size = AGENT + 2 * surfaces
    dt = times[step] - times[step - 1]
    backward = np.eye(size)
    backward[0, 2] = backward[1, 3] = -dt
    push, variance = np.zeros((size, 3)), np.full(3, scene.filter.acceleration_mps2**2)
    push[[0, 1], [0, 1]], push[[2, 3], [0, 1]] = 0.5 * dt**2, dt
    push[4, 2], variance[2] = 1.0, np.radians(scene.filter.heading_deg) ** 2
    if jitter > 0 and feet is not None:
        turn, shift = np.zeros((2, size, surfaces))
        own, angle = np.arange(surfaces), AGENT + 2 * np.arange(surfaces)
        turn[angle, own], turn[angle + 1, own] = 1.0, feet  # a turn about the foot also moves the offset
        shift[angle + 1, own] = 1.0
        push = np.concatenate([push, turn, shift], axis=1)
        each = np.repeat([(jitter / TURN_LEVER_M) ** 2, jitter**2], surfaces)
        variance = np.concatenate([variance, each])
    return backward, push, variance


def agent_bound(covariance: Array) -> tuple[float, float]:
    """Root mean square errors of position (m) and heading (rad) by the covariance of the joint state."""
    return float(np.sqrt(covariance[0, 0] + covariance[1, 1])), float(np.sqrt(covariance[4, 4]))
