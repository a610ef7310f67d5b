"""Sampled signals: vague starts, other places, merging of images, estimates for users."""
