"""Builds everything in motions/: `python -m tools.virtual_subjects [SUBJECT ...]`."""

import os

if __name__ == "__main__":
    # before numpy is loaded: one thread always adds up in one order
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    from tools.virtual_subjects.make import main

    main()
