"""What columns of tables are called elsewhere, and how their numbers become ours."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

from gridslam.world.validation import plain_name

TIME, LENGTH = ("time", "timestamp", "t"), ("distance", "range", "dist", "length")
DELAY = ("delay", "toa", "tof")
RATIO, LEVEL = ("snr", "amplitude"), ("rssi", "rss", "rsrp", "power", "gain")
"""First words of names: of times, lengths, delays, levels over the noise and levels alone."""
SECOND = {"ms": "1000", "us": "1e6", "ns": "1e9"}
METRE = {"mm": "1000", "cm": "100", "km": "0.001", "ft": "3.28084", "feet": "3.28084"}
"""How many of a unit there are in ours."""
DEVICE = ("robot", "tag", "device", "node")
"""What agents are called, alone or followed by `_id`."""
STATION = ("station", "basestation", "base_station", "bs", "gnb", "ap", "tx", "transmitter", "beacon")
"""The same of anchors."""
ANGLE = ("azimuth", "az", "angle", "bearing", "direction", "doa", "dod", "phi", "theta")
"""First words of names of angles, which leave open at which end they were measured."""
ENDS = {
    "aoa": "where it comes from, counter-clockwise from the agent's heading",
    "aod": "where it leaves to, counter-clockwise from the anchor's orientation",
}
OURS, DECIBELS = ("time", "distance", "amplitude"), ("db", "dbm")


class Meant(NamedTuple):
    """Which of our columns a foreign one could be, and how: ``distance_m``, "in metres: range_cm / 100"."""

    column: str
    way: str


def meant_by(name: str) -> Meant | None:
    """What a column of another name than ours could be."""
    plain = plain_name(name)
    first, _, rest = plain.partition("_")
    unit = rest.rpartition("_")[2]
    if plain.removesuffix("_id").removesuffix("_name") in STATION:
        return Meant("anchor", "a name of the scene's [[anchors]] in each row")
    if first in OURS and rest not in (*SECOND, *METRE, *DECIBELS):
        return None  # one of ours misspelt, as distance_std is
    if first in TIME:
        return Meant("time_s", "in seconds" + (f": {name} / {SECOND[unit]}" if unit in SECOND else ""))
    if first in LENGTH:
        return Meant("distance_m", "in metres" + (f": {name} / {METRE[unit]}" if unit in METRE else ""))
    if first in DELAY:
        seconds = f"{name} / {SECOND[unit]}" if unit in SECOND else "delays"
        return Meant("distance_m", f"in metres: {seconds} times the speed of light, 299792458")
    if first in DEVICE and rest in ("", "id", "name"):
        return Meant("agent", "a name of the scene's [[agents]] in each row, where there are several")
    root, decibels = "the root of the SNR", unit in DECIBELS
    if first in RATIO and decibels:
        return Meant("amplitude", f"{root}: 10 ** ({name} / 20)")
    if first in LEVEL and decibels:
        return Meant("amplitude", f"{root}: 10 ** (({name} - level of the noise in {unit}) / 20)")
    if first == "snr":
        return Meant("amplitude", f"{root}: {name} ** 0.5")
    if first in LEVEL:
        return Meant("amplitude", f"{root}: ({name} / that of the noise) ** 0.5 of powers")
    return None


def angles_meant(name: str, header: Collection[str]) -> list[Meant]:
    """Which of our columns of angles that aren't there (of those in `header`) a foreign one could be."""
    first, _, unit = plain_name(name).partition("_")
    if first not in ANGLE:
        return []
    ours = "deg" if unit.startswith("deg") else "rad"
    left = {end: told for end, told in ENDS.items() if f"{end}_rad" not in header}
    return [Meant(f"{end}_{ours}", told) for end, told in left.items()]
