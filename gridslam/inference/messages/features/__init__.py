"""Messages of hybrid SLAM: samples, learned features, and how they are learned."""
