"""The state of hybrid SLAM: learned features, and the agent among them."""
