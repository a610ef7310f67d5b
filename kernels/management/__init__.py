"""Births, merging and readout of surfaces."""
