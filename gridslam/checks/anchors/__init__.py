"""What may be wrong with anchors: distances, heights, names, turns and places."""
