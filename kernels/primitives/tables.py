"""Rows and columns of the tables that kernels share, by name."""

BOUNCES, LAST, FIRST, ANCHOR = range(4)
"""By path, columns of `path`: number of bounces, surfaces hit last and first (-1 for none), anchor."""

LENGTH = 12
"""By path, column of `predicted` after value (3) and spread (9): the path's length, m. The distance that is
measured is longer by the difference of two clocks."""
UNCLEAR, LEARNT = 13, 14
"""By path, columns of `predicted`: variance of the length, m^2, and its covariance with the distance that is
measured, which is that variance where clocks are known."""
PREDICTED = 15
"""Columns of `predicted`."""

LABEL = 9
"""By measurement, column of `scan`: the anchor that sent it, -1 if that isn't known; others: see
`AnchorScan.table`."""
SCAN = 10
"""Columns of `scan`."""

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
