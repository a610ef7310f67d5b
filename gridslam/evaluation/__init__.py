"""Scores, bounds and consistency: estimates against the truth."""
