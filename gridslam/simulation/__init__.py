"""Measurements drawn from a scene's true walls, and disturbances that a filter has to survive."""
