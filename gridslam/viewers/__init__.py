"""Figures, moving pictures, reports and the three-dimensional viewer."""
