"""Files and folders that tests of the command line have in common."""

from pathlib import Path

HEADER = "step,time_s,anchor,distance_m,aod_rad,aoa_rad,amplitude\n"
ROWS = HEADER + "0,0.0,A,3.1,0.1,0.2,9.0\n1,1.0,B,3.2,0.1,0.2,9.0\n"


def listing(folder):
    """All that is in a folder, by relative paths."""
    return sorted(str(path.relative_to(folder)) for path in Path(folder).rglob("*"))
