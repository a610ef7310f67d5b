"""What single columns may have been meant as, by lines of sight: deviations, amplitudes, times."""
