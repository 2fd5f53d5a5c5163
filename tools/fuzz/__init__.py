"""Damaged files for every reader: each must be read, or refused by a LegsimError, and nothing else.

Valid files are damaged at random, seeded. What a reader raises instead of a LegsimError of one
line, a warning other than a note, a number that is not finite in what it gives, what takes longer
than ten seconds or asks for more than 2 GiB, and what ends the process is counted by place, with
the first input that shows it.

    python -m tools.fuzz trc --inputs 1e5
    python -m tools.fuzz all --inputs 1e4 --seconds 60 --keep found
"""
