"""Learned features as tables, and as surfaces."""
