"""Builds models/leg_phantom: `python -m tools.leg_phantom`."""

from tools.leg_phantom.build import main

if __name__ == "__main__":
    main()
