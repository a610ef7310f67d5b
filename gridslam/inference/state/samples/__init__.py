"""The state of direct SLAM: images, and whether samples fit."""
