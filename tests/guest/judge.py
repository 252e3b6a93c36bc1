#!/usr/bin/env python3
"""Judges packets that tests/packet_recorder.py has recorded.

Exit status 1: the packets are wrong.

  judge.py clip PACKETS.csv SHOWN.csv TRUTH.csv
                                            the packets show the face of the clip in the frames that show_clip.py has shown
  judge.py passes PACKETS.csv STEP...       the packets pass through these steps in this order, and none is missing
  judge.py line BYTES DROPPED STEP...       the same for the bytes that left a serial port: all frames are whole, and as
                                            many are missing as the service says it has DROPPED

A step is a state (live) or a state with its reason (neutral/no_face). Only the standard library is used.
"""

import csv
import sys

COEFFICIENTS = ("jawOpen", "eyeBlinkLeft", "eyeBlinkRight")
LEAST_CORRELATION = 0.85


def read(path):
    """Rows of a CSV as dictionaries."""
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def complaint_about_order(rows, dropped=0):
    """Returns a sentence about missing packets, or None. The service says how many it has dropped, and the loopback
    interface and the serial line lose none. A service that was started again begins with 0."""
    sequences = [int(row["sequence"]) for row in rows]
    missing = sum((later - earlier - 1) % 65536 for earlier, later in zip(sequences, sequences[1:]) if later)
    return f"{missing} packets are missing in the sequence, {dropped} were dropped" if missing != dropped else None


def pearson(xs, ys):
    """Pearson's coefficient of correlation; 0 where one of them does not move."""
    mean_x, mean_y = sum(xs) / len(xs), sum(ys) / len(ys)
    xs, ys = [x - mean_x for x in xs], [y - mean_y for y in ys]
    product = (sum(x * x for x in xs) * sum(y * y for y in ys)) ** 0.5
    return sum(x * y for x, y in zip(xs, ys)) / product if product else 0.0


def judge_clip(packets, shown_path, truth_path):
    """Checks that the coefficients follow those that the clip was rendered from. The last packet of each frame counts: by then,
    the output has caught up with the pose, even if the face was held before."""
    shown, truth = read(shown_path), read(truth_path)
    last = {row["capture_us"]: row for row in packets if row["state"] == "live"}
    correlations = {name: pearson([float(last[row["capture_us"]][name]) for row in shown],
                                  [float(truth[int(row["frame"])][name]) for row in shown])
                    for name in COEFFICIENTS}
    figures = ", ".join(f"{name} {correlation:.3f}" for name, correlation in correlations.items())
    print(f"{len(shown)} frames, correlation {figures}")
    if min(correlations.values()) <= LEAST_CORRELATION:
        return f"correlation is not above {LEAST_CORRELATION}"
    return complaint_about_order(packets)


def judge_line(packets, dropped, *steps):
    """Whether the packets pass through all steps, without those that the service says it has dropped."""
    return judge_passes(packets, *steps, dropped=int(dropped))


def judge_passes(packets, *steps, dropped=0):
    """Whether the packets pass through all steps."""
    left = list(steps)
    for row in packets:
        names = (row["state"], f"{row['state']}/{row['reason'].replace(' ', '_')}")
        if left and left[0] in names:
            left.pop(0)
    if left:
        return f"of {' '.join(steps)}, no packet showed {left[0]} in its turn"
    return complaint_about_order(packets, dropped)


def read_line(path):
    """The packets in the bytes of a serial line; ends the program at the first frame that is damaged."""
    # Here, for the other judges are asked again and again by cases that wait.
    from facewire_packet import cobs_decode, decode

    with open(path, "rb") as file:
        *frames, rest = file.read().split(b"\0")
    try:
        packets = [decode(cobs_decode(frame)) for frame in frames if frame]
    except ValueError as error:
        sys.exit(f"{path}: {error}")
    if rest:
        sys.exit(f"{path}: the last frame has no end")
    return packets


def main():
    judges = {"clip": judge_clip, "passes": judge_passes, "line": judge_line}
    if len(sys.argv) < 4 or sys.argv[1] not in judges:
        sys.exit(__doc__)
    packets = read_line(sys.argv[2]) if sys.argv[1] == "line" else read(sys.argv[2])
    complaint = judges[sys.argv[1]](packets, *sys.argv[3:]) if packets else "no packet came"
    if complaint:
        sys.exit(f"{sys.argv[2]}: {complaint}")


if __name__ == "__main__":
    main()
