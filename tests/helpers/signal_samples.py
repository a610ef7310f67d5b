"""Small scenes that sample signals, and recordings made by hand."""

import numpy as np

import gridslam as gs
from gridslam.checks.signals.files import describe_signal

C = 299_792_458.0
STEP_HZ = 1e7
FREQUENCIES = STEP_HZ * (np.arange(41) - 20)


def sampled_scene(walls=(), radio=None, anchor_deg=90.0, **agent):
    """An anchor at (0, 0) facing `anchor_deg`, an agent at (3, 4) that faces 30 degrees and goes there."""
    own = {
        "name": "me", "start_m": [3.0, 4.0], "start_heading_deg": 30.0,
        "waypoints_m": [[3.0 + np.cos(np.pi / 6), 4.0 + np.sin(np.pi / 6)]], "steps": 3, **agent,
    }  # fmt: skip
    link = {
        "frequencies": 41,
        "frequency_step_hz": STEP_HZ,
        "array": {"rows": 1, "columns": 1},
        **(radio or {}),
    }
    return gs.Scene.checked(
        {
            "grid": {"x_m": [-7.0, 7.0], "y_m": [-7.0, 7.0], "cell_m": 0.5}, "radio": link,
            "anchors": [{"name": "A", "position_m": [0.0, 0.0], "orientation_deg": anchor_deg}],
            "walls": list(walls), "agents": [own], "filter": {"particles": 512},
        },
        "sampled",
    )  # fmt: skip


def samples_of(distances, steps=1, noise=0.0, seed=0):
    """Paths of unit norm at `distances` (m), one anchor, one antenna, (K, 1, 41)."""
    draw = np.random.default_rng(seed)
    tone = np.exp(-2j * np.pi * FREQUENCIES / C * np.reshape(distances, (-1, 1))).sum(0) / np.sqrt(41)
    return tone + noise * (draw.standard_normal((steps, 1, 41)) + 1j * draw.standard_normal((steps, 1, 41)))


def recording(samples=None, **changes):
    """A recording of one anchor "A"."""
    given = {"carrier_hz": 6e9, "frequency_hz": FREQUENCIES, "anchors": ["A"], **changes}
    return gs.Recording.from_arrays(samples_of([5.0], 3) if samples is None else samples, **given)


def suspects(path, *arguments):
    """What `check` suspects of a file of sampled signals."""
    return [line for line in describe_signal(path, *arguments) if line.startswith("suspect: ")]
