"""Which rooms may import from which."""

FLOORS = (
    "cli",
    "studies viewers bench importers checks reference",
    "runs",
    "systems evaluation extraction",
    "inference/management",
    "inference/messages",
    "inference/workspace",
    "inference/state simulation",
    "inference/health",
    "inference/beliefs inference/scans",
    "maps measurements",
    "estimates estimate_tables drawing",
    "world",
    "io runtime",
    "kernels/management kernels/messages",
    "kernels/propagation",
    "kernels/primitives",
    "errors arrays quantity wording",
)
"""The highest first; rooms may import from lower floors and from their own."""
