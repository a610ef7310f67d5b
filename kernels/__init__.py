"""Taichi kernels: arrays in, arrays out. They know nothing of scenes."""

CELL_SLABS = 4
"""Fixed sets of paths that are cast side by side."""

PATH_BLOCK = 64
"""Particles that the evaluation kernel takes at a time; kept here so that owners needn't start Taichi."""

SPREAD = 512
"""Loop items that Taichi gives to one thread at least: a task that fills a thread is one item of so many."""
