"""Owners of the kernels on sampled signals: particles' likelihoods, slopes by features, back-projection."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.inference.messages.features.matched_outputs import (
    COARSE_ROWS,
    coarse_outputs,
    matched_outputs,
    pulse_correlation,
    rows_per_m,
)
from gridslam.kernels.primitives.blocks import Ascent
from gridslam.world.signal_model import SignalModel
from gridslam.world.waveform import EVEN, Waveform

Complex = NDArray[np.complex128]
Tables = NDArray[np.float32]
PLACES, STEPS = 2048, 13
"""Places, and steps of Adam, launched together: while a launch runs, no other thread of Python does."""
MARGIN_M = 1.0
"""Features are heard up to so much less than the length from which on paths fold back."""


@dataclass(frozen=True, eq=False)
class Front:
    """What kernels take of a waveform.

    Attributes
    ----------
    waveform : Waveform
    """

    waveform: Waveform

    @cached_property
    def element(self) -> Array:
        """The agent's antennas, times 2 pi / wavelength, (N, 2)."""
        wave = self.waveform
        return np.ascontiguousarray(2 * np.pi / wave.wavelength_m * wave.agent_element_m)

    @cached_property
    def pulse(self) -> Array:
        """Correlation of the pulse over lengths, and its slope."""
        return pulse_correlation(self.waveform.offset_hz, self.waveform.pulse)

    @cached_property
    def reach(self) -> Array:
        """Rows of the tables per metre, and `longest_m`."""
        return np.array([rows_per_m(self.waveform.offset_hz), self.longest_m])

    @property
    def longest_m(self) -> float:
        """Longest path of a feature."""
        return self.waveform.folding_m - MARGIN_M

    def tables(self, samples: Complex) -> Tables:
        """Matched outputs of steps (K, N, M), (K, N, T, 4)."""
        wave = self.waveform
        return matched_outputs(samples, wave.offset_hz, wave.pulse)

    def coarse(self, samples: Complex) -> Tables:
        """Matched outputs of steps (K, N, M) for `gains`, (K, T, N, 2)."""
        wave = self.waveform
        return coarse_outputs(samples, wave.offset_hz, wave.pulse)

    def ratios(self, points: Array, features: Array, anchor_m: Array, table: Tables) -> Array:
        """A of (M123), |h_lo^H z|^2 and |h_lo|^2 (P, 3) at points (P, 4): x, y, heading, noise power.

        Parameters
        ----------
        features : (D, 4)
            x, y, extra length (m), power.
        table : (1, N, T, 4) float32
            See `tables`.
        """
        runtime.start()
        from gridslam.kernels.messages.feature_likelihood import evaluate_features

        out = np.empty((len(points), 3))
        evaluate_features(
            np.ascontiguousarray(points), np.zeros(len(points), np.int32), np.ascontiguousarray(features),
            np.ascontiguousarray(anchor_m), self.element, table, self.pulse, self.reach,
            *self._scratch(len(features), 1), out,
        )  # fmt: skip
        return out

    def slopes(
        self, points: Array, steps: NDArray[np.int32], features: Array, anchor_m: Array, tables: Tables,
        first: int = 0,
    ) -> tuple[Array, float]:  # fmt: skip
        """Slopes (D, 4) of the sum of A over points (Q, 4) by the features, and the sum itself; (M124).

        Parameters
        ----------
        first : int
            Of the features: by those before it there is none (0).
        """
        runtime.start()
        from gridslam.kernels.messages.feature_likelihood import differentiate_features
        from gridslam.kernels.messages.feature_responses import BLOCKS

        out = np.zeros((len(points), len(features) + 1, 4))
        differentiate_features(
            np.ascontiguousarray(points), steps, np.ascontiguousarray(features),
            np.ascontiguousarray(anchor_m), self.element, tables, self.pulse, self.reach,
            first, *self._scratch(len(features), BLOCKS), out,
        )  # fmt: skip
        return out[:, :-1].sum(0), float(out[:, -1, 0].sum())

    def climb(
        self, points: Array, steps: NDArray[np.int32], features: Array, anchor_m: Array, tables: Tables,
        kind: NDArray[np.int64], plan: Array, iterations: int,
    ) -> tuple[Array, float]:  # fmt: skip
        """The best features (D, 4) on the way of so many steps of Adam, and the sum of A there; (M401).

        Parameters
        ----------
        kind : (n,)
            Of the last features; those before them stay.
        plan : (7,)
            See `kernels.messages.feature_ascent`.
        """
        runtime.start()
        from gridslam.kernels.messages.feature_ascent import DONE, climb_features
        from gridslam.kernels.messages.feature_responses import BLOCKS

        features, plan = features.copy(), plan.copy()
        scratch, slopes = self._scratch(len(features), BLOCKS, 1), np.zeros((3, len(kind), 4))
        best, highest, kinds = features.copy(), np.full(1, -np.inf), kind.astype(np.int32)
        for done in range(0, iterations + 1, STEPS):
            plan[DONE] = done
            climb_features(
                np.ascontiguousarray(points), steps, features, np.ascontiguousarray(anchor_m), self.element,
                tables, self.pulse, self.reach, kinds, *scratch,
                Ascent(plan, slopes, best, highest, np.empty(min(STEPS, iterations + 1 - done))),
            )  # fmt: skip
        return best, float(highest[0])

    def gains(self, candidates: Array, points: Array, tables: Tables, powers: Array) -> Array:
        """Gain of a feature at each of the candidates (Q, 3), and its power, (Q, 2); (M132).

        Parameters
        ----------
        tables : (K, T, N, 2) float32
            See `coarse`; of what nothing explains.
        """
        from gridslam.kernels.messages.back_projection import back_project

        parts = []
        per_m = rows_per_m(self.waveform.offset_hz, COARSE_ROWS)
        for first in range(0, len(candidates), PLACES):
            some = np.ascontiguousarray(candidates[first : first + PLACES])
            out = np.empty((len(some), 2))
            back_project(
                some, np.ascontiguousarray(points), self.element, np.ascontiguousarray(tables), per_m,
                self.longest_m, powers, out,
            )  # fmt: skip
            parts.append(out)
        return np.concatenate(parts) if parts else np.empty((0, 2))

    def _scratch(self, features: int, blocks: int, lanes: int | None = None) -> tuple[Array, Array]:
        """Scratch of a launch, by how many blocks of rows gram has."""
        from gridslam.kernels.messages.feature_responses import ARRAY, LANES, SIDE

        entries = ARRAY + 3 * len(self.waveform.agent_element_m)
        lanes = LANES if lanes is None else lanes
        return (
            np.empty((lanes, features + 1, entries, SIDE)),
            np.empty((lanes, blocks * features, features, SIDE)),
        )


def require_hybrid(model: SignalModel) -> None:
    """Refuse radios that hybrid SLAM has no model of.

    Raises
    ------
    InputError
        Anchors of several elements, an array without a centre of symmetry, or a pulse that isn't even in f.
    """
    wave = model.waveform
    if wave.anchor_element_m.shape[1] != 1:
        raise InputError(
            "signal: anchor element_m", f"{wave.anchor_element_m.shape[1]} elements", "1 for hybrid SLAM"
        )
    element = wave.agent_element_m - wave.agent_element_m.mean(0)
    gap = np.linalg.norm(element[:, None] + element, axis=-1).min(1)
    if gap.max() > EVEN * wave.wavelength_m:
        allowed = "elements that are symmetric about a centre for hybrid SLAM"
        raise InputError("signal: agent element_m", "an array without a centre of symmetry", allowed)
    if np.abs(element - wave.agent_element_m).max() > EVEN * wave.wavelength_m:
        raise InputError("signal: agent element_m", "elements that aren't about 0", "their centre at 0")
    power = np.abs(wave.pulse) ** 2
    if np.abs(power - power[::-1]).max() > 1e-3 * power.max():
        raise InputError(
            "signal: pulse", "a spectrum that isn't even about the carrier", "an even one for hybrid SLAM"
        )
