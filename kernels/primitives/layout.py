"""Where things stand in a view of the joint belief, and in a table of particles drawn from it.

View of one agent: [x, y, vx, vy, heading | delta_1 .. delta_J | angle, offset of line 1 | ...]. Differences
of clocks, delta (m), are there if clocks are unknown. Where heights are unknown instead, G rises stand there
(m), by which anchors are higher above the agent than is told: one for all anchors that it is the same of.
`head` is where the lines begin: 5, 5 + J or 5 + G.

Rows of particles: x, y, heading; normal x, y and offset of every line; differences of clocks, or rises.
Velocities aren't drawn.
"""

import taichi as ti

from gridslam.kernels import GIVEN_HEIGHT, HEIGHT, RISE

HEADING, CLOCKS = 4, 5
"""Entries of a view: the heading; the first difference of clocks, if there are any."""
FACING, LATE, ABOVE, OPEN_HEIGHT = 2, 3, 4, 5
"""Entries of an anchor's place after x and y, see `anchor_of`: orientation, rad; by how much its clock
lengthens distances, m; how high it stands above the agent, m; whether that is unknown."""
KNOWN, FIXED = -1, -2
"""Stand for what is known: an anchor's clock or height; its height where others have rises."""


@ti.func
def line_entry(head, s):
    """Entry of a line's angle; its offset comes after it."""
    return head + 2 * s


@ti.func
def line_row(s):
    """First of a line's three rows of particles: normal x, y and offset."""
    return 3 + 3 * s


@ti.func
def lines_in(head, size):
    """How many lines a view of this size has."""
    return (size - head) // 2


@ti.func
def rise_of(places: ti.template(), anchor):
    """Which rise an anchor has; `KNOWN` or `FIXED` if its height is known."""
    return ti.cast(places[anchor, RISE], ti.i32)


@ti.func
def unknown_entry(places: ti.template(), head, anchor):
    """Entry of what is unknown of an anchor: its rise, or how its clock differs from the agent's; `KNOWN` if
    there is none."""
    rise = rise_of(places, anchor)
    entry = ti.select(head > CLOCKS, CLOCKS + ti.select(rise >= 0, rise, anchor), KNOWN)
    return ti.select(rise == FIXED, KNOWN, entry)


@ti.func
def unknown_row(places: ti.template(), head, anchor, rows):
    """Its row among `rows` rows of particles; `KNOWN` if there is none."""
    entry = unknown_entry(places, head, anchor)
    return ti.select(entry >= 0, rows - head + entry, KNOWN)


@ti.func
def anchor_of(places: ti.template(), mean: ti.template(), head, anchor):
    """Where an anchor stands and faces, by how much its clock lengthens distances (0 if known), how high it
    stands above the agent, and whether that is unknown: see `FACING`."""
    unknown, rises = unknown_entry(places, head, anchor), rise_of(places, anchor) >= 0
    late, height, open = ti.f64(0.0), places[anchor, HEIGHT], ti.f64(0.0)
    if unknown >= 0:
        if rises:
            height, open = places[anchor, GIVEN_HEIGHT] + mean[unknown], 1.0
        else:
            late = mean[unknown]
    return ti.Vector([places[anchor, 0], places[anchor, 1], places[anchor, 2], late, height, open], dt=ti.f64)


@ti.func
def steepness_of(place, length):
    """Slope of an anchor's distances by its rise; `place` is that of `anchor_of`."""
    return place[ABOVE] / ti.max(length, 1e-9)
