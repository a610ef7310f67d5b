"""Figures of maps, below everything that runs: cells, walls, tracks."""
