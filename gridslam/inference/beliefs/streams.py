"""Numbers that part the streams of random numbers, so that no two messages of a system share one.

A stream is seeded by the filter's seed, the step, and one of these: a step that is taken again, from a
checkpoint or by another thread, draws the same.
"""

POSE_RECOVERY, START_SEARCH, CHALLENGE, LEAD = 2, 3, 4, 5
NETWORK_LOOK = ARRAY_START = 6  # of two systems: no filter takes both
ARRAY_LEAD, ARRAY_CHALLENGE, CLOCK_CANDIDATES, CLOCK_SIGHTS = 7, 8, 9, 10
POINTS, ARRAY_BIRTHS = 0x9A, 0xB1
