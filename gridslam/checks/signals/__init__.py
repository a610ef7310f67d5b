"""Files of sampled signals: delays, directions and elements against known places."""
