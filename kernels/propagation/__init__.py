"""Rays through cells: paths, visibility, cells, coefficients, amplitudes."""
