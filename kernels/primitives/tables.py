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

COVARIANCE, LENGTH = 3, 12
"""By path, columns of `predicted`: value, `DISTANCE` to `AOA`; from `COVARIANCE` on that of the three (9);
the path's length, m. The distance that is measured is longer by the difference of two clocks."""
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
SCAN_COLUMNS = 10
"""Columns of `scan`."""

LEFT_ANCHOR, LEFT_VALUE, LEFT_STD, LEFT_AMPLITUDE = 0, 1, 4, 7
"""By measurement that was left over, columns of `rows`: anchor; where value and deviations begin, three each;
amplitude."""

PATH_ROW, SCAN_ROW = range(2)
"""By pair, columns of `index`: rows of its path and its measurement."""
VARIANCE, DENSITY, DETERMINANT = 3, 6, 7
"""By pair, columns of `pair`: measured value, `DISTANCE` to `AOA`; from `VARIANCE` on variances of the three;
density of what isn't geometry; determinant of the covariance of a particle."""
INVERSE, NEAREST, FARTHEST = 3, 9, 10
"""By pair, columns of `table`, in single precision: the value; from `INVERSE` on that of the same covariance,
its diagonal first, then entries 01, 02 and 12; between which distances particles matter."""

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

MESSAGE, SENDS = range(2)
"""By path, columns of `factor`: A, the message to its rays; 1 if it sends to cells, else 0."""
MEAN_VALIDITY, SHARE_POSSIBLE, MEAN_CORNERS = range(3)
"""By path, columns of `seen`: mean of V where the path is possible; at which share of states it is; from
`MEAN_CORNERS` on means of its first and second corner, x and y of each."""

BORN_OF, BORN_LAST, BORN_FIRST, BORN_ANCHOR = range(4)
"""By birth, from row 1 on, columns of `born`: measurement; known surfaces hit last and first, -1 for the new
one; anchor. Row 0 begins with how many there are."""
LINE_ANGLE, LINE_OFFSET, OVER_CLUTTER = range(3)
"""By birth, columns of `proposal`: the new line; how many births there would be for one of clutter."""

LINE, LINE_COVARIANCE, SFV, SFV_COVARIANCE = 0, 2, 6, 8
MEAN_COEFFICIENT, COEFFICIENT_VARIANCE, STRETCH = 12, 13, 14
"""By surface, columns of a description's `table`: angle and offset, and their covariance (4); surface feature
vector, and its covariance (4); reflection coefficient and its variance; lowest and highest hit."""
BY_COEFFICIENTS, EXISTS, CORNERS = 3, 4, 5
"""By path, columns of a description's `quantity`: value, `DISTANCE` to `AOA`; amplitude by coefficients;
existence of ray and surfaces; from `CORNERS` on x and y of four corners."""
FROM_ANCHOR, OVER_LAST, OVER_FIRST = range(3)
"""By path, columns of a description's `number`: anchor; identities of the surfaces hit, -1 for none."""
