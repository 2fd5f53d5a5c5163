"""The command line: what `legsim ...` does."""
