"""What `map.h5` holds: its groups and datasets, with types, units, ranges and meanings."""

from __future__ import annotations

from dataclasses import replace

from gridslam.io.datasets import Dataset, Group, Layout
from gridslam.maps.map_cells import LEVELS

CELL, ROW, POINT = "ny, nx", "S", "S, 2"
PICTURE = "needed without `evidence`, else for other programs alone"
LINE_COV = "rad^2, rad m, m^2"
TOLD, HIT = "nothing was learned", "nothing was hit"

GRID = Group("grid", (
    Dataset("@origin_m", "m", "lower left corner of the lower left cell", shape="2"),
    Dataset("@cell_m", "m", "side of a cell", least=0, open=True),
    Dataset("@prior", "1", "prior probability that a crossed cell is occupied", least=0, most=1, open=True),
    Dataset("occupancy", "1", "probability that it is occupied", PICTURE, 0, 1,
            shape=CELL, kind="float32", nan="not observed"),
    Dataset("observed", "1", "whether messages of some step told of the cell: added up, more than 0.01",
            shape=CELL, kind="bool"),
    Dataset("reflection", "1", "mean of its reflection coefficient", PICTURE, 0, 1,
            shape=CELL, kind="float32", nan=HIT),
    Dataset("reflection_std", "1", "standard deviation of that", PICTURE, 0, 1,
            shape=CELL, kind="float32", nan=HIT),
    Dataset("evidence", "nat", "log-likelihood ratio of occupied to free; 0 where nothing was learned",
            "by `occupancy`", shape=CELL, kind="float32"),
    Dataset("coefficient_cell", "cell", "row and column of the cells that were hit",
            "needed with `evidence`", 0, shape="K, 2", kind="int32"),
    Dataset("coefficient", "nat",
            "log-likelihood of their reflection coefficients, over 20 values from 0.025 to 0.975",
            "needed with `evidence`", shape="K, 20", kind="float32"),
))  # fmt: skip

ESTIMATE = (
    Dataset("identity", "1", "number that it keeps from its birth on", "0 to S - 1", 0,
            shape=ROW, kind="int64"),
    Dataset("sfv_m", "m", "surface feature vector: the mirror image of the origin", shape=POINT),
    Dataset("sfv_cov_m2", "m^2", "covariance of that", shape="S, 2, 2"),
    Dataset("line", "rad, m", "angle a of the normal and offset o of the line q . (cos a, sin a) = o",
            "by `sfv_m`", shape=POINT),
    Dataset("line_cov", LINE_COV, "their covariance", "by `sfv_cov_m2`", shape="S, 2, 2"),
    Dataset("reflection", "1", "mean of its reflection coefficient", least=0, most=1, shape=ROW),
    Dataset("reflection_var", "1", "its variance", least=0, most=1, shape=ROW),
    Dataset("existence", "1", "probability that the surface exists", least=0, most=1, shape=ROW),
    Dataset("extent_m", "m",
            "from the first place that was hit to the last, across doors and gaps between, which cells or"
            " stretches tell; along the tangent (-sin a, cos a) from the foot point", shape=POINT, nan=HIT),
    Dataset("owner", "1", "the one anchor that it serves; -1 for all", "-1", -1, shape=ROW, kind="int64"),
)  # fmt: skip
"""As `gridslam.estimate_tables.SurfaceEstimate` has surfaces: those of a map, and of all steps of a run."""
SURFACES = Group("surfaces", (
    *ESTIMATE,
    Dataset("reflection_posterior", "1",
            "posterior of the coefficient, over the same 20 values; rows sum to 1",
            "by mean and variance", 0, 1, shape="S, 20"),
    Dataset("stretch_surface", "1",
            "of runs of methods that map no cells: row of the surface that each stretch is part of",
            "nobody knows better than `extent_m`", 0, shape="W", kind="int64"),
    Dataset("stretch_extent_m", "m",
            "the stretches, which paths were reflected by: from where to where as `extent_m` counts",
            "needed with `stretch_surface`", shape="W, 2"),
    Dataset("joint_covariance", LINE_COV,
            "covariance of all surfaces' lines together, in their order: what one agent found shares its"
            " errors", "surfaces are independent", shape="2 S, 2 S"),
), "no surfaces")  # fmt: skip

FEATURES = Group("features", (
    Dataset("identity", "1", "number that a feature keeps", "0 to F - 1", 0, shape="F", kind="int64"),
    Dataset("anchor", "1", "index of the anchor in the scene where it was learned", least=0,
            shape="F", kind="int64"),
    Dataset("anchor_m", "m", "where that anchor stands, by which it is known elsewhere",
            "by `anchors` of the provenance", shape="F, 2"),
    Dataset("position_m", "m", "place of the feature", shape="F, 2"),
    Dataset("bias_m", "m", "length of the path beyond the distance to it", shape="F"),
    Dataset("variance", "sample^2", "mean power at 1 m, in units of the samples squared", least=0, shape="F"),
    Dataset("noise", "sample^2", "noise power of the anchor's samples where it was learned", "not known", 0,
            shape="F", nan="not known"),
    Dataset("covariance", "m^2, m sample^2, sample^4", "of x, y, bias and variance", shape="F, 4, 4"),
    Dataset("kind", "1", "0 free, 1 mirror (an image of the anchor), 2 scatterer", least=0, most=2,
            shape="F", kind="int64"),
    Dataset("steps_seen", "1", "steps at which it was heard", least=0, shape="F", kind="int64"),
    Dataset("last_step", "1", "the latest of them; -1 if there is none", least=-1, shape="F", kind="int64"),
    Dataset("joint_covariance", "m^2", "of x, y and bias of all features together",
            "features are independent", shape="3 F, 3 F"),
), "nothing was learned")  # fmt: skip

ANCHORS = Group("anchors", (
    Dataset("@names", "1", "what they are called", shape="J", kind="text"),
    Dataset("position_m", "m", "where they stand", shape="J, 2"),
    Dataset("orientation_rad", "rad", "where their arrays point", shape="J"),
    Dataset("covariance", "m^2, m rad, rad^2", "of x, y and orientation of all anchors together",
            shape="3 J, 3 J"),
    Dataset("cross", "m rad, m^2, rad^2, rad m", "of these with all surfaces' lines, in their order",
            shape="3 J, 2 S"),
), "anchors stand as the scene says, or it wasn't learned")  # fmt: skip

LEVEL_BELIEFS = Group("levels", tuple(
    Dataset(name, "1", f"belief about the coefficient of the {name}, over values from 0.01 to 0.99",
            "not learned", 0, 1, shape="50")
    for name in LEVELS
), "coefficients of floor and ceiling weren't learned")  # fmt: skip


def _about_a_run(name: str, kind: str, meaning: str, unit: str = "1") -> Dataset:
    return Dataset(f"@{name}", unit, meaning, "not known", shape="A", kind=kind, free=True)


PROVENANCE = Group("provenance", (
    _about_a_run("agents", "text", "who made the map, in order"),
    _about_a_run("seeds", "int64", "seed of each run"),
    _about_a_run("steps", "int64", "steps of each run"),
    _about_a_run("runs", "text",
                 "checksum of each agent's measurements: who has heard them can't begin with the map, and a"
                 " map that holds a run twice is neither handed over nor fused"),
    _about_a_run("kinds", "text", "what was heard in each run: paths, or a sampled signal"),
    _about_a_run("told", "text", "what of the truth a reference was told"),
    _about_a_run("lost", "text", "who noticed in the end that it was lost: nobody goes on from that"),
    replace(_about_a_run("anchors", "text", "names of the anchors, by which frames are compared"), shape="J"),
    replace(_about_a_run("anchor_x_m", "float64", "where they are", "m"), shape="J"),
    replace(_about_a_run("anchor_y_m", "float64", "the same, y", "m"), shape="J"),
), "nobody knows who made it")  # fmt: skip

MAP = Layout("map.h5", "gridslam-map", (1,), (GRID, SURFACES, FEATURES, ANCHORS, LEVEL_BELIEFS, PROVENANCE))
