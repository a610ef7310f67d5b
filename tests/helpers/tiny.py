"""A scene that runs in a moment: two agents, five steps."""

TINY = """
name = "tiny"
grid = { x_m = [-4.8, 4.8], y_m = [-3.8, 3.8], cell_m = 0.2 }
filter = { particles = 200 }
[[anchors]]
name = "A"
position_m = [-3.1, 2.2]
[[anchors]]
name = "B"
position_m = [2.9, -2.3]
[[walls]]
material = "concrete"
points_m = [[-4.0, -3.0], [4.0, -3.0], [4.0, 3.0], [-4.0, 3.0]]
closed = true
[[agents]]
name = "agent1"
start_m = [-2.0, -1.4]
waypoints_m = [[0.7, -1.4]]
steps = 3
[[agents]]
name = "agent2"
start_m = [-1.0, 1.4]
waypoints_m = [[0.7, 1.4]]
steps = 2
[materials]
concrete = 0.7
"""
