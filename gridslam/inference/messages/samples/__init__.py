"""Messages of sampled signals: images heard by one antenna, surfaces heard by arrays."""
