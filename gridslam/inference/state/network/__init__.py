"""The state of several agents and clocks."""
