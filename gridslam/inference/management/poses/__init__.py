"""Poses found afresh: without a map, at a vague start, or after silence."""
