"""Columns of the tables of `blocks.Clues`: what of a scan doesn't depend on the pose that it is to tell."""

DISTANCE, AOD, AOA, AMPLITUDE = range(4)
"""By measurement: distance (m), AoD in the world and AoA (rad), 0 where not measured; amplitude, -1 there."""
STRAIGHT, PEAK = 4, 8
"""Lines of sight: inverse variances of distance, AoD and AoA, 0 where not measured, and the log of the
density at the mean, over clutter's, but for the amplitude's; what that one's log is at most."""
BORN, TOWARD, TURNED, FIT, SURE, NEAR, ANY = 9, 10, 12, 14, 15, 16, 17
"""New single bounces: their ratio to clutter, but for AoD and geometry; vector to the image if the agent
faces along x (m); cosine and sine of AoD + AoA; density of an AoD that fits, its inverse variance, and the
cosine of the misfit up to which it is worked out; density of any AoD."""
OVER = 18
"""Known single bounces: as for lines of sight, beside a map's errors."""
MEASURED = 22
"""Columns by measurement."""

IMAGE, NORMAL, OFFSET, SIDE, TURN, CHANCE, COEFFICIENT = 0, 2, 4, 5, 6, 7, 8
"""By known single bounce: the anchor's image x, y (m); the line's normal and offset (m), and the anchor's
distance from it, with its sign; twice the normal's angle; chance that it is there; coefficient."""
KNOWN = 9
"""Columns by known single bounce."""
X, Y, HEIGHT, AT_1M, SAMPLES = range(5)
"""By anchor: place (m) and height above the agent (m), u at 1 m, number of samples."""
SCAN_FROM, SCAN_TO, KNOWN_FROM, KNOWN_TO = range(4)
"""By anchor: its measurements and known single bounces, from the first to before the last."""
