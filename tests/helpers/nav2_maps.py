"""Exported maps, read as nav2 reads them."""

import re

import numpy as np
import yaml

FREE, OCCUPIED, UNKNOWN = 0, 100, -1  # values of a ROS occupancy grid


def nav2_load(folder, name):
    """Read a map by the rules of nav2's map server (map_io.cpp): grid [iy, ix], row 0 at the lowest y."""
    meta = yaml.safe_load((folder / f"{name}.yaml").read_text())
    content = (folder / meta["image"]).read_bytes()
    header = re.match(rb"P5\s(\d+)\s(\d+)\s255\s", content)  # one whitespace: the next byte is a pixel
    width, height, pixels = *header.groups(), content[header.end() :]
    shade = np.frombuffer(pixels, np.uint8).reshape(int(height), int(width))[::-1] / 255.0
    if meta["mode"] == "raw":
        percent = np.round(shade * 255)
        return meta, np.where(percent <= 100, percent, UNKNOWN)
    occupancy = shade if meta["negate"] else 1.0 - shade
    known = np.where(occupancy < meta["free_thresh"], FREE, UNKNOWN)
    return meta, np.where(meta["occupied_thresh"] < occupancy, OCCUPIED, known)
