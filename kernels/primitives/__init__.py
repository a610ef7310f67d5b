"""Functions that kernels share: special functions, Gaussians, the radio, launches, tables."""
