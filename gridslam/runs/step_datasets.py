"""What `steps.h5` holds: its groups and datasets, with types, units, ranges and meanings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from gridslam.io.datasets import Dataset, Group, Layout
from gridslam.maps.map_datasets import ESTIMATE

COVARIANCE = "m^2, m^2/s, m rad, (m/s)^2, rad m/s, rad^2"
HEIGHTS = ("agent", "floor", "ceiling")

STEPS = Group("steps", (
    Dataset("step", "1", "number of the step", least=0, shape="N", kind="int64"),
    Dataset("time_s", "s", "its time", shape="N"),
    Dataset("position_m", "m", "agent's position", shape="N, 2"),
    Dataset("velocity_mps", "m/s", "agent's velocity", shape="N, 2"),
    Dataset("heading_rad", "rad", "agent's heading, wrapped to (-pi, pi]", shape="N"),
    Dataset("covariance", COVARIANCE, "of x, y, vx, vy, heading", shape="N, 5, 5"),
    Dataset("effective_sample_size", "1",
            "particles that carry the agent's weight; infinite where they don't count", least=0,
            shape="N", nan="a method without particles", endless=True),
))  # fmt: skip


def _rows(name: str, datasets: Iterable[Dataset], absent: str = "") -> Group:
    """Rows of all steps below one another, and where those of each step begin."""
    first = Dataset("offset", "1", "first row of each step, and how many there are in all", least=0,
                    shape="N + 1", kind="int64")  # fmt: skip
    return Group(name, (first, *datasets), absent)


DETECTED = Dataset("detected", "1", "whether it counts as found", shape="S", kind="bool")
SURFACES = _rows("surfaces", (DETECTED, *ESTIMATE))
PATHS = _rows("paths", (
    Dataset("anchor", "1", "anchor of the path", least=0, shape="L", kind="int64"),
    Dataset("surfaces", "1",
            "identities of the surfaces hit, last one first: (-1, -1) line of sight, (s, s) single bounce",
            least=-1, shape="L, 2", kind="int64"),
    Dataset("distance_m", "m", "predicted length, offsets of clocks included", shape="L"),
    Dataset("aod_rad", "rad", "predicted angle of departure, relative as measured", shape="L"),
    Dataset("aoa_rad", "rad", "predicted angle of arrival, relative as measured", shape="L"),
    Dataset("amplitude", "1", "predicted amplitude", least=0, shape="L"),
    Dataset("existence", "1", "probability that it exists", least=0, most=1, shape="L"),
    Dataset("points", "m", "anchor, first and last interaction point, agent", shape="L, 4, 2",
            nan="a bounce that isn't there"),
))  # fmt: skip
HYPOTHESES = _rows("hypotheses", (
    Dataset("weight", "1", "probability of each hypothesis, the likeliest first", least=0, most=1, shape="H"),
    Dataset("position_m", "m", "where the agent is by it", shape="H, 2"),
    Dataset("heading_rad", "rad", "its heading", shape="H"),
    Dataset("position_cov_m2", "m^2", "covariance of that place", shape="H, 2, 2"),
    Dataset("surface_count", "1", "surfaces that it has found", least=0, shape="H", kind="int64"),
), "not kept")  # fmt: skip
RINGS = _rows("rings", (
    Dataset("ring", "1", "number of the image within the step", least=0, shape="R", kind="int64"),
    Dataset("anchor", "1", "anchor that it is an image of", least=0, shape="R", kind="int64"),
    Dataset("existence", "1", "probability that there is such an image", least=0, most=1, shape="R"),
    Dataset("weight", "1", "probability of the place, if there is one; those below 0.001 are left out",
            least=0, most=1, shape="R"),
    Dataset("position_m", "m", "the place", shape="R, 2"),
), "no images whose place isn't known (direct SLAM has them)")  # fmt: skip


def _pairs(name: str, of: tuple[str, ...], unit: str, least: float = -np.inf, most: float = np.inf) -> Group:
    """A number and its deviation at every step, by what they are of."""
    pair = Dataset("", unit, "", "it is known", least, most, shape="N, 2")
    meaning = f"{name.removesuffix('s')} of the {{}} as believed, and its deviation"
    datasets = (replace(pair, name=one, meaning=meaning.format(one)) for one in of)
    return Group(name, tuple(datasets), f"the scene gives no deviations of {name}")


PAIRS = (_pairs("heights", HEIGHTS, "m"), _pairs("coefficients", HEIGHTS[1:], "1", 0, 1))
ALL_STEPS = Layout("steps.h5", "gridslam-steps", (1,), (STEPS, SURFACES, PATHS, HYPOTHESES, RINGS, *PAIRS))
