"""What a filter must know of sampled signals besides the samples: frequencies, pulse, antenna elements.

docs/model.md, section 11; all responses have unit norm, so that path loss and SNR multiply outside.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.world.radio import SPEED_OF_LIGHT

Complex = NDArray[np.complex128]
LEAST_FREQUENCIES = 8
EVEN = 1e-6
"""Of the spacing, by which frequencies may be off an even grid; of a wavelength, elements off symmetry."""
WIDEST_WAVELENGTHS = 1.5
"""An array whose elements are all farther apart than this isn't believed to be in metres."""


@dataclass(frozen=True, eq=False)
class Waveform:
    """Frequencies, pulse and antenna elements of a recording of J anchors, read-only.

    Attributes
    ----------
    carrier_hz : float
    offset_hz : (M,) float64
        Frequencies about the carrier, rising evenly. They are centred on 0 (the carrier takes up the rest).
    pulse : (M,) complex128
        Spectrum of the pulse, scaled to a sum of squares of 1: the response has unit norm.
    anchor_element_m : (J, A, 2) float64
        Antenna elements of every anchor in its own frame, x forward.
    agent_element_m : (B, 2) float64
    noise_std : (J,) float64 or None
        Where the estimate of the noise's deviation starts, in units of the samples.
    heading_std_rad : float
        Of the heading that is measured, if one is; 0: exact.

    Raises
    ------
    InputError
        Fewer than 8 frequencies or uneven ones, a pulse that is 0, shapes that don't match, numbers that
        aren't finite, or elements that can't be in metres.
    """

    carrier_hz: float
    offset_hz: Array
    pulse: Complex
    anchor_element_m: Array
    agent_element_m: Array
    noise_std: Array | None = None
    heading_std_rad: float = 0.0

    def __repr__(self) -> str:
        """One line."""
        width = 1e-6 * float(np.ptp(self.offset_hz))
        return f"<Waveform of {len(self.offset_hz)} frequencies over {width:g} MHz at {self.carrier_hz:g} Hz>"

    def __post_init__(self) -> None:
        carrier = float(self.carrier_hz)
        offset = _numbers(self.offset_hz, "frequency_hz", (None,))
        pulse = np.asarray(self.pulse, np.complex128)
        anchor = _numbers(self.anchor_element_m, "anchor element_m", (None, None, 2))
        agent = _numbers(self.agent_element_m, "agent element_m", (None, 2))
        _check_frequencies(carrier, offset)
        if pulse.shape != offset.shape or not np.isfinite(pulse).all():
            raise InputError("signal: pulse", f"shape {pulse.shape}", f"finite, shape {offset.shape}")
        norm = np.linalg.norm(pulse)
        if not norm > 0:
            raise InputError("signal: pulse", "zeros", "the spectrum of a pulse")
        middle = 0.5 * (offset[0] + offset[-1])
        steps = np.arange(len(offset)) - 0.5 * (len(offset) - 1)
        for name, elements in (("anchor", anchor), ("agent", agent[None])):
            check_elements(elements, SPEED_OF_LIGHT / (carrier + middle), f"signal: {name} element_m")
        noise = None if self.noise_std is None else _numbers(self.noise_std, "noise_std", (len(anchor),))
        if noise is not None and not (noise > 0).all():
            raise InputError("signal: noise_std", str(noise.min()), "numbers above 0")
        if not 0 <= float(self.heading_std_rad) < np.inf:
            raise InputError("signal: heading std_rad", str(self.heading_std_rad), "0 or more")
        values = {
            "carrier_hz": carrier + middle,
            "offset_hz": steps * (offset[-1] - offset[0]) / (len(offset) - 1),
            # read from a file, it has this norm but for rounding, and stays as it is
            "pulse": pulse if abs(norm - 1) < 1e-12 else pulse / norm,
            "anchor_element_m": anchor,
            "agent_element_m": agent,
            "noise_std": noise,
            "heading_std_rad": float(self.heading_std_rad),
        }
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def step_hz(self) -> float:
        """Spacing of the frequencies, Hz."""
        return float((self.offset_hz[-1] - self.offset_hz[0]) / (len(self.offset_hz) - 1))

    @property
    def bandwidth_hz(self) -> float:
        """From the first to the last frequency, (M - 1) step_hz, Hz."""
        return float(self.offset_hz[-1] - self.offset_hz[0])

    @property
    def folding_m(self) -> float:
        """Length from which on paths fold back, c / step_hz, m."""
        return SPEED_OF_LIGHT / self.step_hz

    @property
    def wavelength_m(self) -> float:
        """At the carrier, m."""
        return SPEED_OF_LIGHT / self.carrier_hz

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape of the samples of one step: anchors, anchor's elements, agent's elements, frequencies."""
        anchors, elements = self.anchor_element_m.shape[:2]
        return anchors, elements, len(self.agent_element_m), len(self.offset_hz)

    @cached_property
    def phases_beyond_planes(self) -> int:
        """Of the phases of all elements, how many combinations aren't planes over their arrays; (M567)."""
        arrays = [*self.anchor_element_m, self.agent_element_m]
        return sum(len(array) - int(np.linalg.matrix_rank(plane_of(array))) for array in arrays)

    def delay_response(self, distance_m: Array | float) -> Complex:
        """Response over frequency to paths of lengths (...), (..., M), unit norm; (M49)."""
        turn = np.asarray(distance_m, np.float64)[..., None] * self.offset_hz
        return self.pulse * np.exp(-2j * np.pi / SPEED_OF_LIGHT * turn)

    def anchor_response(self, anchor: int, aod_rad: Array | float) -> Complex:
        """Response of an anchor's elements to departures (...) from its orientation, (..., A); (M50)."""
        return steering(self.anchor_element_m[anchor], aod_rad, self.wavelength_m)

    def agent_response(self, aoa_rad: Array | float) -> Complex:
        """Response of the agent's elements to arrivals (...) relative to its heading, (..., B); (M50)."""
        return steering(self.agent_element_m, aoa_rad, self.wavelength_m)


def plane_of(element_m: Array) -> Array:
    """Columns (n, 3) of which planes over an array's places (n, 2) are made."""
    return np.column_stack([np.ones(len(element_m)), element_m])


def steering(element_m: Array, angle_rad: Array | float, wavelength_m: float) -> Complex:
    """Response of elements (A, 2) to waves from or to directions (...), (..., A), unit norm; (M50).

    An element nearer to where the wave comes from hears it earlier, which is a + where delay has a -.
    """
    angle = np.asarray(angle_rad, np.float64)[..., None]
    ahead = np.cos(angle) * element_m[:, 0] + np.sin(angle) * element_m[:, 1]
    return np.exp(2j * np.pi / wavelength_m * ahead) / np.sqrt(len(element_m))


def check_elements(elements: Array, wavelength_m: float, where: str) -> None:
    """Refuse arrays (N, A, 2) m that are too wide to be in metres.

    Raises
    ------
    InputError
        All of an array's elements are farther apart than `WIDEST_WAVELENGTHS`, or all at one place.
    """
    if elements.shape[1] < 2:
        return
    for array in elements:
        gaps = np.linalg.norm(array[:, None] - array[None], axis=-1)
        if not gaps.any():
            raise InputError(where, f"{len(array)} elements at one place", "where each element is, m")
        nearest = gaps[~np.eye(len(array), dtype=bool)].min()
        if nearest > WIDEST_WAVELENGTHS * wavelength_m:
            found = f"elements {nearest:g} m apart, {nearest / wavelength_m:.3g} wavelengths"
            allowed = (
                f"metres, at most {WIDEST_WAVELENGTHS:g} wavelengths to the next (not wavelengths or mm)"
            )
            raise InputError(where, found, allowed)


def _check_frequencies(carrier: float, offset: Array) -> None:
    if len(offset) < LEAST_FREQUENCIES:
        raise InputError("signal: frequency_hz", f"{len(offset)}", f"at least {LEAST_FREQUENCIES}")
    gaps = np.diff(offset)
    if (gaps <= 0).any():
        raise InputError("signal: frequency_hz", "frequencies that don't rise", "rising ones, evenly spaced")
    step = gaps.mean()
    off = np.abs(gaps - step).max() / step
    if off > max(EVEN, 4 * np.spacing(np.abs(offset).max()) / step):
        raise InputError(
            "signal: frequency_hz", f"spacing uneven by {off:.2g} of a step", "evenly spaced ones"
        )
    if abs(offset[0] + offset[-1]) > 2 * (offset[-1] - offset[0]):
        found = f"{offset[0]:g} to {offset[-1]:g} Hz"
        raise InputError("signal: frequency_hz", found, "frequencies about the carrier, less the carrier's")
    if not (np.isfinite(carrier) and carrier + offset[0] > 0):
        found = f"{carrier:g} Hz with frequencies from {offset[0]:g} Hz on"
        raise InputError("signal: carrier_hz", found, "a carrier above half the bandwidth")


def _numbers(values: object, name: str, shape: tuple[int | None, ...]) -> Array:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"signal: {name}", str(error), "numbers") from None
    fits = array.ndim == len(shape) and all(w in (None, n) for w, n in zip(shape, array.shape, strict=True))
    if not fits or array.size == 0:
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise InputError(f"signal: {name}", f"shape {array.shape}", f"shape ({wanted})")
    if not np.isfinite(array).all():
        raise InputError(f"signal: {name}", "NaN or infinity", "finite numbers")
    return array
