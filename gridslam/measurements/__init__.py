"""Paths that were measured: the table and the formats it is read from and written to."""
