"""`python -m gridslam`: the command line."""

from gridslam.cli.main import main

main()
