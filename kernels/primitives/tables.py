"""Rows of the tables that evaluation, association and updates share: by path, by pair, by measurement."""

EXISTENCE, SURFACES, OPEN, DETECTED, POSSIBLE, CHANCE, THERE, MISSED, WORTH = range(9)
SURE, ORDER, TOTAL = range(9, 12)
"""By path, `odds`: existence of the ray and of its surfaces, V, and p_d, before; V where the path is
possible; chance that it is there, if its surfaces are; chance that it is there; message for "caused none";
``sum_m nu_m g_m + 1 - p_d``; chance that it was detected; paths, surest first; normaliser of the path's
association where it was corrected by."""
ODDS = 12
"""Rows of `odds`."""

RATIO, BETA, CLAIM, NU, RESPONSIBLE = range(5)
"""By path and measurement, `message`: ``p_d f(z | path) / (mu_fa f_fa(z))`` where the path is possible; from
the path into the association, for "caused measurement m"; between path and measurement, there and back; and
the probability that one caused the other."""

EXPLAINED, UNEXPLAINED, NEW, CLAIMED = range(4)
"""By measurement, `measured`: sum of the paths' beta; amount of quiet clutter it stands for, if no path can
have caused it; message into the association for "caused by no legacy path"; sum of what paths claim."""
