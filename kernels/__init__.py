"""Taichi kernels: arrays in, arrays out; they know nothing of scenes."""
