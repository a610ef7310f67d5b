"""What lines of sight to an agent are followed by: a block of tables, and their columns."""

from typing import NamedTuple

from gridslam.kernels.primitives.blocks import Doubles, Square, Wholes

AFTER, SCANS, DRAWS, COUNT = range(4)
"""By step, and once more after the last: steps since the one before; its first scan; its first draw; how many
particles there are."""
ANCHOR, ROWS = range(2)
"""By scan, and once more after the last: its anchor and its first row."""
VALUES, SURE, PEAK = 0, 3, 6
"""By row: distance (m), AoD and AoA (rad), 0 where not measured; one over their deviations, 0 there; ratio to
the density of any path where all are as expected."""
X, Y, FACING, HEIGHT, TILT, ADDED = range(6)
"""By anchor: place (m) and orientation (rad); height above the agent (m); what a particle's size adds to the
height, and to the distance, in times."""
LASTING, TURN, WIDEST, SHARE, WORLD, THOROUGH, IN_SIGHT, BEHIND, SHRINKAGE = range(9)
"""Of `Sights.choice`: correlation of velocities from step to step; deviations of turns (rad), and of those of
one particle in `SHARE`; whether arrivals are directions in the world, and whether it is judged from each
particle which anchors are hidden; chance of a line of sight in sight and behind walls; of a size's deviation
from the mean, at each redrawing, or 0 without sizes."""
PLACE, HEADING, PACE, GOING, SIZE, BEGUN, PARTICLE = 0, 2, 3, 4, 6, 7, 10
"""By particle: x, y (m); heading (rad); deviation of a step (m); the latest step, in paces (2); size of the
error in distances (m); where it began and how it faced (3); and how many columns there are."""
WEIGHT, LENGTH, AHEAD, ARRIVAL, LINES = range(5)
"""Lines of scratch behind those of rows and scans: weights of particles; length (m), departure and arrival
(rad) of the line of sight that each expects; and how many these are."""


class Sights(NamedTuple):
    """Choices [9], steps [S + 1, 4], scans [Q + 1, 2], rows [R, 7], anchors [A, 6], walls from end to end
    [W, 4] (m), and standard normal numbers and one in [0, 1) for each step [M], in the order of their use:
    two and one for each particle, that one, and one for each that is left, if it has a size."""

    choice: Doubles
    step: Wholes
    scan: Wholes
    row: Square
    anchor: Square
    wall: Square
    draw: Doubles
