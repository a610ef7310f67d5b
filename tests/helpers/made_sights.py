"""What `check` would have followed, made by hand."""

import numpy as np

from gridslam.checks.sights.line_of_sight_filter import Sight


def made_sight(row, **known):
    """Lines of sight in some rows (R,) of a table, all certain; `known`: fields that a test looks at."""
    rows = np.array(row)
    usual = {
        "evidence": 0.0,
        "scans": len(rows),
        "explained": 1.0,
        "row": rows,
        "distance_m": np.ones(len(rows)),
        "probability": np.ones(len(rows)),
        "position_m": np.zeros((len(rows), 2)),
        "shares": np.ones(1),
        "size_m": 0.0,
        "start": np.zeros(3),
    }
    return Sight(**(usual | known))
