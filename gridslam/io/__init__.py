"""Files written whole or not at all, and HDF5 of others read in a guarded process."""
