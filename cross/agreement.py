#!/usr/bin/env python3
"""Compares two CSV files of `facewire track` and prints how much coefficients and head angles differ.

agreement.py PC.csv BOARD.csv FIRST MOST LARGEST: three limits, for the coefficients of the first frame with a face, for
99 of 100 values, and for every value. Exit status 1 if a limit is exceeded, if frames or states differ, or if no frame
has a face.
"""

import csv
import sys

BEFORE_COEFFICIENTS = ("frame", "time_s", "state")
ANGLES = ("head_yaw_deg", "head_pitch_deg", "head_roll_deg")


def rows_of(path):
    """Returns the rows as dictionaries, in order."""
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def differences(pairs, names):
    """Returns all differences in the columns `names`, smallest first, as (difference, column, frame)."""
    found = [
        (abs(float(ours[name]) - float(theirs[name])), name, ours["frame"])
        for ours, theirs in pairs
        for name in names
    ]
    return sorted(found)


def main():
    """Compares the files that the command line names."""
    pc, board = rows_of(sys.argv[1]), rows_of(sys.argv[2])
    limits = [float(limit) for limit in sys.argv[3:6]]
    if [(row["frame"], row["state"]) for row in pc] != [(row["frame"], row["state"]) for row in board]:
        print(f"frames or states differ ({len(pc)} and {len(board)} frames)")
        return 1
    live = [(ours, theirs) for ours, theirs in zip(pc, board) if ours["state"] == "live"]
    if not live:
        print(f"none of {len(pc)} frames has a face")
        return 1
    names = [name for name in pc[0] if name not in BEFORE_COEFFICIENTS and not name.startswith("head_")]
    every = differences(live, names)
    first, most, largest = differences(live[:1], names)[-1], every[int(0.99 * len(every))], every[-1]
    angle = differences(live, ANGLES)[-1]
    print(f"  {len(names)} coefficients in {len(live)} frames with a face; largest differences:")
    print(f"  first frame {first[0]:.6f}, 99 of 100 values {most[0]:.6f}, "
          f"all {largest[0]:.6f} ({largest[1]}, frame {largest[2]}); angles {angle[0]:.3f} degrees ({angle[1]})")
    # A difference that is not a number is not below any limit, and fails.
    return 0 if all(found[0] <= limit for found, limit in zip((first, most, largest), limits)) else 1


if __name__ == "__main__":
    sys.exit(main())
