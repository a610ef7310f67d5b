"""What a scene holds, leaves in sight and allows for, and how distances may be off from it."""
