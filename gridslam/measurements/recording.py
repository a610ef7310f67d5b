"""What an agent received, as samples over frequency and antennas, handed out step by step."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError, located
from gridslam.measurements.matlab_signal import read_mat_signal
from gridslam.measurements.signal_hdf5 import read_signal, write_signal
from gridslam.measurements.simulated import Simulated
from gridslam.wording import counted
from gridslam.world.columns import MOST_STEPS
from gridslam.world.geometry import wrap
from gridslam.world.given import SECONDS, numbers, require_radians, unmasked
from gridslam.world.names import label_fault
from gridslam.world.signal_scan import SignalScan
from gridslam.world.trajectory import Trajectory
from gridslam.world.waveform import Waveform


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """All that one agent received, read-only; iterating yields one `SignalScan` per step.

    `from_arrays` and `from_h5` make one.

    Attributes
    ----------
    samples : (K, J, A, B, M) complex64
        By step, anchor, element of the anchor, element of the agent, frequency; any scale.
    time_s : (K,) float64
        Rises strictly.
    heard : (K, J) bool
        False where a snapshot is missing; its samples are 0.
    waveform : Waveform
    anchors : tuple of str, J names
    heading_rad : (K,) float64 or None
        As measured by an IMU; its deviation stands in the waveform.
    anchor_position_m : (J, 2) float64, m, or None
    anchor_orientation_rad : (J,) float64, rad, or None
    truth : Trajectory or None
        For scoring alone: no filter reads it.
    simulated : Simulated or None
        Which simulation it is of, if of any.

    Raises
    ------
    InputError
        Shapes that don't match, times that don't rise, NaN or zeros alone in a heard snapshot, no imaginary
        part in any of them, or nothing heard at all.
    """

    samples: NDArray[np.complex64]
    time_s: Array
    heard: NDArray[np.bool_]
    waveform: Waveform
    anchors: tuple[str, ...]
    heading_rad: Array | None = None
    anchor_position_m: Array | None = None
    anchor_orientation_rad: Array | None = None
    truth: Trajectory | None = None
    simulated: Simulated | None = None

    def __post_init__(self) -> None:
        names = _names(self.anchors)
        samples = _samples(self.samples)
        steps, shape = len(samples), samples.shape[1:]
        if not 1 <= steps <= MOST_STEPS:
            raise InputError("signal: samples", f"{steps} steps", f"1 to {MOST_STEPS}")
        if shape != self.waveform.shape or len(names) != shape[0]:
            found, allowed = f"{shape} of {len(names)} anchors", f"{self.waveform.shape}, as of the waveform"
            raise InputError("signal: samples", found, allowed)
        heard = np.ma.filled(self.heard, False)
        if heard.shape != (steps, len(names)) or not np.isin(heard, (0, 1)).all():
            raise InputError("signal: heard", f"shape {heard.shape}", f"({steps}, {len(names)}) truth values")
        heard = heard.astype(bool)
        _check_snapshots(samples, heard)
        arrays: dict[str, NDArray[Any]] = {"samples": samples, "heard": heard}
        shapes: dict[str, tuple[int, ...]] = {
            "time_s": (steps,), "heading_rad": (steps,), "anchor_position_m": (len(names), 2),
            "anchor_orientation_rad": (len(names),),
        }  # fmt: skip
        for name, wanted in shapes.items():
            if getattr(self, name) is not None:
                allowed = SECONDS if name == "time_s" else "numbers"
                arrays[name] = numbers(getattr(self, name), f"signal: {name}", allowed)
                if arrays[name].shape != wanted:
                    raise InputError(f"signal: {name}", f"shape {arrays[name].shape}", f"shape {wanted}")
                if not np.isfinite(arrays[name]).all():
                    raise InputError(f"signal: {name}", "NaN or infinity", "finite numbers")
        if (np.diff(arrays["time_s"]) <= 0).any():
            raise InputError("signal: time_s", "times that don't rise", "strictly rising times")
        if "heading_rad" in arrays:
            require_radians(arrays["heading_rad"], "signal")
            arrays["heading_rad"] = wrap(arrays["heading_rad"])
        for name, values in arrays.items():
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        object.__setattr__(self, "anchors", names)

    def __repr__(self) -> str:
        """One line."""
        size = " x ".join(str(n) for n in self.samples.shape[2:])
        known = "" if self.truth is None else ", true track known"
        steps, who = counted(len(self), "step"), ", ".join(self.anchors)
        return f"<Recording of {steps}, anchors {who}, samples {size}{known}>"

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def times_s(self) -> Array:
        """Times of all steps, as of `Measurements`, (K,) s."""
        return self.time_s

    @property
    def interval_s(self) -> float:
        """Median time between steps; 1 s of a single one."""
        return float(np.median(np.diff(self.time_s))) if len(self) > 1 else 1.0

    def __iter__(self) -> Iterator[SignalScan]:
        return map(self.scan, range(len(self)))

    def scan(self, step: int) -> SignalScan:
        """What was received at one step.

        Raises
        ------
        IndexError
            There is no such step.
        """
        if not 0 <= step < len(self):
            raise IndexError(f"step {step} of {len(self)}")
        heading = None if self.heading_rad is None else float(self.heading_rad[step])
        samples = self.samples[step].astype(np.complex128)
        return SignalScan(step, float(self.time_s[step]), samples, self.heard[step], heading)

    @classmethod
    def from_arrays(
        cls,
        samples: ArrayLike,
        carrier_hz: float,
        frequency_hz: ArrayLike,
        anchors: Sequence[str],
        *,
        time_s: ArrayLike | None = None,
        interval_s: float = 1.0,
        heard: ArrayLike | None = None,
        pulse: ArrayLike | None = None,
        anchor_element_m: ArrayLike | None = None,
        agent_element_m: ArrayLike | None = None,
        noise_std: ArrayLike | None = None,
        heading_std_rad: float = 0.0,
        **more: Any,
    ) -> Recording:
        """Make a recording of samples in memory.

        Phases turn as ``exp(-2j pi f d / c)`` over frequency and as ``exp(+2j pi / lambda u . q)`` over
        elements, u from the device towards where the wave comes from or goes to: an element nearer to it
        hears it earlier.

        Parameters
        ----------
        samples : (K, J, A, B, M) or (K, J, M) complex
            By step, anchor, element of the anchor, element of the agent, frequency; any scale. Who transmits
            doesn't matter.
        carrier_hz : float
        frequency_hz : (M,) Hz
            About the carrier, rising, evenly spaced.
        anchors : sequence of J names
        time_s : (K,) s, optional
            Otherwise every `interval_s` from 0.
        heard : (K, J) bool, optional
            False where a snapshot is missing. Default: none is.
        pulse : (M,) complex, optional
            Spectrum of the pulse; default: flat, or already divided out.
        anchor_element_m, agent_element_m : (J, A, 2) and (B, 2) m
            In the frames of anchors and agent, x forward. Needed where there are several elements.
        noise_std : (J,), optional
            Where the estimate of the noise's deviation starts, in units of `samples`.
        heading_std_rad : float
            Of `heading_rad`; 0: exact.
        **more
            `heading_rad`, `anchor_position_m`, `anchor_orientation_rad`, `truth`: as attributes.

        Raises
        ------
        InputError
            Uneven frequencies or fewer than 8, elements that are missing or can't be in metres, NaN or zeros
            alone in a heard snapshot, and whatever else can't be.

        Examples
        --------
        >>> import numpy as np, gridslam as gs
        >>> f = 1e7 * (np.arange(41) - 20)
        >>> z = np.exp(-2j * np.pi * f * 5.0 / 299792458.0)[None, None]  # one step, one anchor, a path of 5 m
        >>> recording = gs.Recording.from_arrays(z, 6e9, f, ["A"])
        >>> round(recording.waveform.folding_m, 2), recording.samples.shape
        (29.98, (1, 1, 1, 1, 41))
        """
        array = unmasked(samples)
        if array.ndim == 3:
            array = array[:, :, None, None]
        if array.ndim != 5 or array.dtype.kind not in "fiuc":
            raise InputError(
                "signal: samples", f"shape {array.shape} of {array.dtype}", "(K, J, A, B, M) or (K, J, M)"
            )
        steps, count, ends, carried, points = array.shape
        frequency = numbers(frequency_hz, "signal: frequency_hz", "(M,) numbers")
        flat = np.ones(points, np.complex128)
        if frequency.shape != (points,):
            raise InputError(
                "signal: frequency_hz", f"shape {frequency.shape}", f"({points},), as in samples"
            )
        waveform = Waveform(
            carrier_hz, frequency, flat if pulse is None else np.asarray(unmasked(pulse), np.complex128),
            _elements(anchor_element_m, (count, ends, 2), "anchor_element_m"),
            _elements(agent_element_m, (carried, 2), "agent_element_m"),
            None if noise_std is None else numbers(noise_std, "signal: noise_std"), heading_std_rad,
        )  # fmt: skip
        even = np.asarray(interval_s * np.arange(steps), np.float64)
        time = even if time_s is None else numbers(time_s, "signal: time_s", SECONDS)
        there: Any = np.ones((steps, count), dtype=bool) if heard is None else heard
        return cls(samples=array, time_s=time, heard=there, waveform=waveform, anchors=tuple(anchors), **more)

    def to_h5(self, path: str | os.PathLike[str]) -> None:
        """Write everything, the truth included, as HDF5 (``h5read`` of MATLAB reads it).

        Raises
        ------
        InputError
            The file can't be written.
        """
        form = self.waveform
        content = {
            "samples": self.samples, "carrier_hz": form.carrier_hz, "frequency_hz": form.offset_hz,
            "time_s": self.time_s, "heard": self.heard, "pulse": form.pulse, "noise_std": form.noise_std,
            "anchors": self.anchors, "anchor_position_m": self.anchor_position_m,
            "anchor_orientation_rad": self.anchor_orientation_rad, "anchor_element_m": form.anchor_element_m,
            "agent_element_m": form.agent_element_m, "heading_rad": self.heading_rad,
            "heading_std_rad": form.heading_std_rad, "truth": self.truth,
            "simulated": self.simulated,
        }  # fmt: skip
        write_signal(path, content)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Recording:
        """Read a file of any known kind: ``.mat``, and HDF5 under any other name.

        Raises
        ------
        InputError
            A CSV file, or as the reader of its kind.
        """
        kind = os.path.splitext(os.fspath(path))[1].lower()
        if kind == ".csv":
            allowed = "sampled signals (.h5, .mat); a method on paths takes it as --measurements"
            raise InputError(str(path), "a CSV file, which holds measured paths", allowed)
        return cls.from_matlab(path) if kind == ".mat" else cls.from_h5(path)

    @classmethod
    def from_matlab(cls, path: str | os.PathLike[str]) -> Recording:
        """Read a MATLAB file, version 5 to 7.3; see `gridslam.measurements.matlab_signal` for what it holds.

        Raises
        ------
        InputError
            Not such a file, cut short, or any fault in its content.
        """
        with located(path):
            return cls.from_arrays(**read_mat_signal(path))

    @classmethod
    def from_h5(cls, path: str | os.PathLike[str]) -> Recording:
        """Read an HDF5 file.

        Raises
        ------
        InputError
            Not such a file, cut short, or any fault in its content.
        """
        with located(path):
            content = read_signal(path)
            simulated = content.pop("simulated")
            return replace(cls.from_arrays(**content), simulated=simulated)


def _names(anchors: Sequence[str]) -> tuple[str, ...]:
    names = tuple(anchors)
    if not names or len(set(names)) < len(names):
        raise InputError("signal: anchors", ", ".join(map(str, names)) or "none", "names, each once")
    for name in names:
        allowed = label_fault(name) if isinstance(name, str) else "text"
        if allowed is not None:
            raise InputError("signal: anchors", repr(name), allowed)
    return names


def _samples(values: NDArray[Any]) -> NDArray[np.complex64]:
    """In single precision; what is larger than that holds is scaled by nobody but its owner."""
    with np.errstate(over="ignore", invalid="ignore"):
        samples = np.array(unmasked(values), dtype=np.complex64)
    if samples.ndim != 5:
        raise InputError("signal: samples", f"shape {samples.shape}", "shape (K, J, A, B, M)")
    return samples


def _check_snapshots(samples: NDArray[np.complex64], received: NDArray[np.bool_]) -> None:
    """Whatever a heard snapshot can't be; the others become 0."""
    if not received.any():
        raise InputError("signal: heard", "nothing", "at least one snapshot")
    samples[~received] = 0
    flat = samples.reshape(*received.shape, -1)
    for fault, bad in (
        ("NaN or infinity", ~np.isfinite(flat).all(-1)), ("zeros alone", received & ~flat.any(-1))
    ):  # fmt: skip
        if bad.any():
            step, anchor = np.argwhere(bad)[0]
            allowed = "what was received, or heard = false"
            raise InputError(f"signal: samples[{step}, {anchor}]", fault, allowed)
    if not samples.imag.any():
        raise InputError("signal: samples", "real numbers alone", "complex samples, with their phases")


def _elements(given: ArrayLike | None, shape: tuple[int, ...], name: str) -> Array:
    """Antenna elements (..., N, 2); a lone antenna is where its device is."""
    if given is None:
        if shape[-2] > 1:
            raise InputError(f"signal: {name}", f"none of {shape[-2]} elements", f"shape {shape}, m")
        return np.zeros(shape)
    try:
        array = np.asarray(given, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"signal: {name}", str(error), f"shape {shape}, m") from None
    if array.shape != shape:
        raise InputError(f"signal: {name}", f"shape {array.shape}", f"shape {shape}, m")
    return array
