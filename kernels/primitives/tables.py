"""Rows and columns of the tables that kernels share, by name."""

BOUNCES, LAST, FIRST, ANCHOR = range(4)
"""By path, columns of `path`: number of bounces, surfaces hit last and first (-1 for none), anchor."""

NORMAL, RAY_POSSIBLE, VALIDITY = 8, 12, 13
"""By ray, columns of `drawn`: from 0 on its four corners, the anchor's first, x and y of each; from `NORMAL`
on the normals where it is hit first and last; whether the path is possible there; its V."""

ORIGIN_X, ORIGIN_Y, SIDE, OUTSIDE, CLIP, LEAST, OTHER, SPARED = range(8)
"""Entries of the grid's `frame`: its corner, m; side of a cell, m; chance that what is hit outside reflects;
how far apart log-likelihoods may be; at which share of its states a path must be possible; how likely a wall
is of another material where it is hit next; depth in which a wall is spared by rays that it reflects, m."""

LENGTH = 12
"""By path, column of `predicted` after value (3) and spread (9): the path's length, m. The distance that is
measured is longer by the difference of two clocks."""
UNCLEAR, LEARNT = 13, 14
"""By path, columns of `predicted`: variance of the length, m^2, and its covariance with the distance that is
measured, which is that variance where clocks are known."""
PREDICTED = 15
"""Columns of `predicted`."""

DISTANCE, AOD, AOA, OWN_STD = range(4)
AMPLITUDE, LOUD, AS_CLUTTER, LABEL = range(6, 10)
"""By measurement, columns of `scan`: value, 0 for none; from `OWN_STD` on deviations of the three, 0 for what
follows from the amplitude, -1 where there is no value; amplitude, -1 for none; whether it is loud; if it is
as quiet as clutter is, how much of that it stands for; the anchor that sent it, -1 if that isn't known."""

EXISTENCE, SURFACES, OPEN, DETECTED, POSSIBLE, CHANCE, THERE, MISSED, WORTH = range(9)
SURE, ORDER, TOTAL = range(9, 12)
"""By path, `odds`: existence of the ray and of its surfaces, V, and p_d, before; V times the share of states
where the path is possible; chance that it is there, if its surfaces are; chance that it is there; message for
"caused none";
``sum_m nu_m g_m + 1 - p_d``; chance that it was detected; paths, surest first; normaliser of the path's
association where it was corrected by."""
ODDS = 12
"""Rows of `odds`."""

RATIO, BETA, CLAIM, NU, RESPONSIBLE = range(5)
"""By path and measurement, `message`: ``p_d f(z | path) / (mu_fa f_fa(z))`` where the path is possible; from
the path into the association, for "caused measurement m"; between path and measurement, there and back; and
the probability that one caused the other."""

EXPLAINED, QUIET, NEW, CLAIMED, TAKEN = range(5)
"""By measurement, `measured`: sum of the paths' beta, each times its share of all that the path might have
caused; amount of clutter it stands for, if it is quiet and clutter; message into the association for
"caused by no legacy path"; sum of what paths claim; probability with which paths were corrected by it."""
MEASURED_ROWS = 5
"""Rows of `measured`."""
