#!/usr/bin/env python3
"""Judges packets that tests/packet_decoder.py has recorded.

Exit status 1: they are not as they should be; 3: too few poses to judge the clip by.

  judge.py clip PACKETS.csv TRUTH.csv FPS   the face of the clip, played at FPS frames a second
  judge.py passes PACKETS.csv STEP...       the packets pass through these steps, in this order
  judge.py line BYTES STEP...               the same of the frames that left a serial port, each of them whole

A step is a state (live) or a state with its reason (neutral/no_face). Only the standard library is used.
"""

import csv
import sys

LEAST_CORRELATION = 0.7
# Part of the clip's frames that must have given a pose, so that no coefficient is judged by a glimpse.
LEAST_SEEN = 0.7
TOO_FEW = 3
# The clip's frames that a search step moves the truth by.
STEP_FRAMES = 0.5


def read(path):
    """Rows of a CSV as dictionaries."""
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def complaint_about_order(rows):
    """A sentence about lost packets, or None. All went over the loopback interface, which loses none. A service that was
    started again begins with 0."""
    sequences = [int(row["sequence"]) for row in rows]
    lost = sum((later - earlier - 1) % 65536 for earlier, later in zip(sequences, sequences[1:]) if later)
    return f"{lost} packets are missing in the sequence" if lost else None


def poses(rows):
    """The first packet of each captured frame while live, with its time of capture in seconds."""
    found, last, wraps = [], None, 0
    for row in rows:
        capture_us = int(row["capture_us"])
        if row["state"] != "live" or capture_us == last:
            continue
        if last is not None and capture_us < last:
            wraps += 1
        last = capture_us
        found.append(((capture_us + (wraps << 32)) / 1e6, row))
    return found


def pearson(xs, ys):
    """Pearson's coefficient of correlation; 0 where one of them does not move."""
    mean_x, mean_y = sum(xs) / len(xs), sum(ys) / len(ys)
    xs, ys = [x - mean_x for x in xs], [y - mean_y for y in ys]
    product = (sum(x * x for x in xs) * sum(y * y for y in ys)) ** 0.5
    return sum(x * y for x, y in zip(xs, ys)) / product if product else 0.0


def at(curve, position):
    """The looped curve between two of its frames."""
    frame, part = int(position // 1), position % 1
    return curve[frame % len(curve)] * (1 - part) + curve[(frame + 1) % len(curve)] * part


def align(positions, shown, truth):
    """The one lag of all curves that correlates best in sum: (lag in frames, correlation of each)."""
    def correlations(lag):
        return {name: pearson(shown[name], [at(curve, position + lag) for position in positions])
                for name, curve in truth.items()}
    lags = [step * STEP_FRAMES for step in range(int(len(next(iter(truth.values()))) / STEP_FRAMES))]
    return max(((lag, correlations(lag)) for lag in lags), key=lambda found: sum(found[1].values()))


def judge_clip(packets, truth_path, fps):
    """Whether the coefficients follow those that the clip was rendered from."""
    truth_rows = read(truth_path)
    truth = {name: [float(row[name]) for row in truth_rows] for name in truth_rows[0] if name != "frame"}
    seen = poses(packets)
    if len(seen) < LEAST_SEEN * len(truth_rows):
        print(f"only {len(seen)} poses of the clip's {len(truth_rows)} frames came", file=sys.stderr)
        sys.exit(TOO_FEW)
    positions = [(time_s - seen[0][0]) * float(fps) for time_s, _ in seen]
    shown = {name: [float(row[name]) for _, row in seen] for name in truth}
    lag, correlations = align(positions, shown, truth)
    figures = ", ".join(f"{name} {r:.3f}" for name, r in correlations.items())
    print(f"{len(seen)} poses, lag {lag:g} frames, correlation {figures}")
    if min(correlations.values()) <= LEAST_CORRELATION:
        return f"correlation is not above {LEAST_CORRELATION}"
    return complaint_about_order(packets)


def judge_passes(packets, *steps):
    """Whether the packets pass through all steps."""
    left = list(steps)
    for row in packets:
        names = (row["state"], f"{row['state']}/{row['reason'].replace(' ', '_')}")
        if left and left[0] in names:
            left.pop(0)
    if left:
        return f"of {' '.join(steps)}, no packet showed {left[0]} in its turn"
    return complaint_about_order(packets)


def read_line(path):
    """The packets in the bytes of a serial line; ends the program at the first frame that is damaged."""
    # Here, for the other judges are asked again and again by cases that wait.
    from packet_decoder import cobs_decode, decode

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
    judges = {"clip": judge_clip, "passes": judge_passes, "line": judge_passes}
    if len(sys.argv) < 4 or sys.argv[1] not in judges:
        sys.exit(__doc__)
    packets = read_line(sys.argv[2]) if sys.argv[1] == "line" else read(sys.argv[2])
    complaint = judges[sys.argv[1]](packets, *sys.argv[3:]) if packets else "no packet came"
    if complaint:
        sys.exit(f"{sys.argv[2]}: {complaint}")


if __name__ == "__main__":
    main()
