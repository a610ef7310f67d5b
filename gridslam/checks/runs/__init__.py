"""What is said after a run, of what it heard and of where it puts its agent."""
