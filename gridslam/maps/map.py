"""The map as a thing of its own: what one agent hands to the next, to a robot or to a planner."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Self

from gridslam.errors import InputError
from gridslam.io.files import write_bytes
from gridslam.maps import map_files
from gridslam.maps.map_cells import MapCells
from gridslam.maps.nav2 import nav2_files, refuse_foreign_maps
from gridslam.maps.run_identity import repeated_run
from gridslam.maps.walls import WallSegments, wall_segments
from gridslam.wording import counted
from gridslam.world.scene import Scene


@dataclass(frozen=True, eq=False)
class Map(MapCells):
    """Occupancy and reflection of the cells of a grid, and the surfaces found in it.

    Attributes
    ----------
    origin_m : (2,) float64, m
        Lower-left corner of the lower-left cell.
    cell_m : float, m
        Side of a cell.
    evidence : (ny, nx) float32
        Log-likelihood ratio of occupied to free, 0 where nothing was learnt.
    coefficient : (ny, nx, BINS) float32
        Log-likelihood of the reflection coefficient over `world.radio.REFLECTION_BINS`, 0 without hits.
    observed : (ny, nx) bool
        Cells of which some step told anything: its messages added up to more than 0.01.
    prior : float
        Prior occupancy of a crossed cell, ``1 - exp(-cell_m / mean_free_path_m)``.
    surfaces : SurfaceEstimate or None
        Detected surfaces.
    surface_reflection : (S, BINS) float64 or None
        Posterior of each surface's reflection coefficient; rows sum to 1.
    provenance : dict
        Where the map comes from. Parallel lists, one entry per run that went into it: ``agents``, ``seeds``,
        ``steps``, ``runs`` (checksums of what was heard; "" where a file of an earlier version has none).
        Lists of other lengths, where there is something to say: ``told`` (what of the truth references were
        given), ``lost`` (agents that noticed in the end that they were lost). Of the frame, one entry per
        anchor: ``anchors`` (names), ``anchor_x_m``, ``anchor_y_m`` (m); and ``frame``, its name, if any.
    features : FeatureEstimate or None
        Learned features (hybrid SLAM).
    feature_covariance : (3 F, 3 F) float64 or None
        Of all features' x, y and bias together; without it they are taken as independent.
    surface_covariance : (2 S, 2 S) float64 or None
        Of all surfaces' angles and offsets together, in the order of their lines; without it they are
        taken as independent. Surfaces found by one agent share its errors.
    levels : dict of (50,) float64
        Of "floor" and "ceiling", if coefficients were learned: beliefs over `world.levels.COEFFICIENTS`.
    stretches : SurfaceStretches or None
        Where along the surfaces paths were reflected, of runs of methods that map no cells; None: not known.
    anchors : MapAnchors or None
        Where anchors stand, if the scene gave deviations of that and the method learned it.

    Raises
    ------
    InputError
        Arrays disagree in shape, `cell_m` or `prior` is out of range, or a joint covariance can't be one.
    """

    @classmethod
    def of_scene(cls, scene: Scene) -> Self:
        """A blank map on a scene's grid, in which nothing was observed yet."""
        grid, free_path_m = scene.grid, scene.filter.mean_free_path_m
        return cls.blank(grid.origin_m, grid.cell_m, grid.shape, -math.expm1(-grid.cell_m / free_path_m))

    def __repr__(self) -> str:
        """One line."""
        return f"<Map {self.in_words()}>"

    @property
    def was_heard(self) -> bool:
        """Whether agents made it, by radio: floor plans that were read from elsewhere name none."""
        return bool(self.provenance.get("agents"))

    def in_words(self) -> str:
        """Who made it, and what is in it, in a line."""
        (height, width), who = self.shape, self.provenance.get("agents")
        names = ", ".join(map(str, who)) if isinstance(who, list) and who else "unknown agents"
        surfaces = len(self.surfaces) if self.surfaces is not None else 0
        points = 0 if self.features is None else len(self.features)
        learned = f", {counted(points, 'feature')} (points that paths seem to come from)" if points else ""
        learned += f"; told the {self.truth_given}" if self.truth_given else ""
        learned += f"; {self.lost} noticed that it was lost" if self.lost else ""
        twice = repeated_run(self)
        learned += f"; holds {twice} twice: nobody goes on from it" if twice else ""
        return (
            f"by {names}: {width} x {height} cells of {self.cell_m:g} m, {self.observed.mean():.0%} "
            f"observed, {self.occupied.sum()} occupied, {counted(surfaces, 'surface')}{learned}"
        )

    def _repr_html_(self) -> str:
        from gridslam.drawing.map_figure import draw_map, inlined

        return inlined(draw_map(self), f"Map {self.in_words()}")

    def wall_segments(self) -> WallSegments:
        """Stretches of the surfaces where there is a wall, see `gridslam.maps.walls.wall_segments`."""
        return self._walls

    @cached_property
    def _walls(self) -> WallSegments:
        return wall_segments(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map as HDF5, see `gridslam.maps.map_files.write_map`."""
        map_files.write_map(self, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a map written by `save`, or that of a run by the run's folder.

        Raises
        ------
        InputError
            No such file, another format or version, or damaged.
        """
        path = map_files.file_of(path)
        fields = map_files.read_map(path)
        try:
            return cls(**fields)
        except InputError as error:
            raise InputError(f"{path}: {error.where}", error.found, error.allowed) from error

    def to_nav2(self, directory: str | os.PathLike[str], raw: bool = False) -> None:
        """Write ``map.yaml`` and ``map.pgm`` for ROS nav2, ``reflection.*`` likewise.

        Parameters
        ----------
        directory : path
            Is made if it isn't there.
        raw : bool
            The cells alone. Default: walls that were found are drawn in, and bands and specks of free cells
            behind them are unknown.

        Raises
        ------
        InputError
            The folder can't be written to, or has files of these names that this didn't write.
        """
        folder = map_files.folder_of(directory)
        refuse_foreign_maps(folder)
        for name, content in self.nav2_files(raw).items():
            write_bytes(folder / name, content())

    def nav2_files(self, raw: bool = False) -> dict[str, Callable[[], bytes]]:
        """Functions that give the content of the files that `to_nav2` writes, by name."""
        return nav2_files(self, lambda: None if raw else self._walls)

    def to_csv(self, directory: str | os.PathLike[str]) -> None:
        """Write ``cells.csv`` (observed cells) and ``surfaces.csv``; docs/file-formats.md has their columns.

        Raises
        ------
        InputError
            The folder can't be written to.
        """
        map_files.write_csv(self, directory, self._walls)
