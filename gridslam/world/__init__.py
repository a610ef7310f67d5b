"""What a scene is made of: geometry, radio, anchors, walls, tracks, and one step's measurements."""
