"""Where things stand in a view of the joint belief, and in a table of particles drawn from it.

View of one agent: [x, y, vx, vy, heading | delta_1 .. delta_J | angle, offset of line 1 | ...]. Differences
of clocks, delta (m), are there if clocks are unknown; `head` is where the lines begin, 5 or 5 + J.

Rows of particles: x, y, heading; normal x, y and offset of every line; differences of clocks. Velocities
aren't drawn.
"""

import taichi as ti

HEADING, CLOCKS = 4, 5
"""Entries of a view: the heading; the first difference of clocks, if there are any."""
HEIGHT = 3
"""Column of `Anchors.places` and of nothing else: height above the agent."""
KNOWN = -1
"""Stands for the entry of a clock that is known."""


@ti.func
def line_entry(head, s):
    """Entry of a line's angle; its offset comes after it."""
    return head + 2 * s


@ti.func
def lines_in(head, size):
    """How many lines a view of this size has."""
    return (size - head) // 2


@ti.func
def clock_entry(head, anchor):
    """Entry of the difference between an anchor's clock and the agent's; `KNOWN` if there is none."""
    return ti.select(head > CLOCKS, CLOCKS + anchor, KNOWN)


@ti.func
def clock_row(head, anchor, rows):
    """Its row among `rows` rows of particles; `KNOWN` if there is none."""
    return ti.select(head > CLOCKS, rows - (head - CLOCKS) + anchor, KNOWN)


@ti.func
def anchor_of(places: ti.template(), mean: ti.template(), head, anchor):
    """Position and orientation of an anchor, by how much its clock lengthens distances (0 if known), and how
    high it stands above the agent."""
    clock = clock_entry(head, anchor)
    late = ti.cast(0.0, ti.f64)
    if clock >= 0:
        late = mean[clock]
    return ti.Vector(
        [places[anchor, 0], places[anchor, 1], places[anchor, 2], late, places[anchor, HEIGHT]], dt=ti.f64
    )
