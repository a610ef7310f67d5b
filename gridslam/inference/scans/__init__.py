"""Measurements of a step by anchor, and those of earlier steps that nothing explained."""
