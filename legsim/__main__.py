"""`python -m legsim`: the command line, where the folder of scripts is not on the path."""

from legsim.cli.main import main

main()
