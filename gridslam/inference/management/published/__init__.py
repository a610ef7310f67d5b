"""Estimates out of published representations."""
