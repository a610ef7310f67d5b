"""Sampled signals: vague starts, merging of images, estimates for users."""
