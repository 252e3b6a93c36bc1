#!/usr/bin/env python3
"""Prints the instructions of a frame that cross/count has counted.

Usage: count.py table|json|check FOLDER ALLOWED. FOLDER contains the files ARCHITECTURE-ENGINE.FRAMES that
cross/instructions.c has written. ALLOWED is the file that says how many instructions a frame may take. The instructions
of a frame are those of 10 frames minus those of 2, divided by 8.
"""

import json
import os
import re
import sys

import cycles

COUNTERS = (
    "all", "multiply_adds", "other_vector", "words_loaded", "loads", "stores", "branches", "other", "l1_misses",
    "l2_misses",
)
FEW, MANY = 2, 10
ENGINES = (("aarch64", "native"), ("aarch64", "onnxruntime"), ("armv7", "native"))
# Functions with a smaller share of a frame are printed as one sum.
SHOWN = 0.005
# Factor by which a count may exceed the allowed one, because another version of the compiler gives slightly other code.
SLACK = 1.02


def plain(symbol):
    """Returns the readable path of a mangled Rust symbol, without its hash. Returns other symbols unchanged."""
    if not symbol.startswith("_ZN"):
        return symbol
    parts, rest = [], symbol[3:]
    while match := re.match(r"\d+", rest):
        end = match.end() + int(match[0])
        parts.append(rest[match.end():end])
        rest = rest[end:]
    if re.fullmatch(r"h[0-9a-f]{16}", parts[-1]):
        parts.pop()
    text = "::".join(parts)
    for code, mark in {"$LT$": "<", "$GT$": ">", "$u20$": " ", "$RF$": "&", "$C$": ",", "$BP$": "*", "..": "::"}.items():
        text = text.replace(code, mark)
    return re.sub(r"\$u[0-9a-f]+\$", "?", text).replace("_<", "<")


def counted(path):
    """Returns the counters of each function of one run. Functions with the same path are added up."""
    functions = {}
    with open(path, encoding="utf-8") as file:
        for line in file:
            *values, symbol = line.rstrip("\n").split("\t")
            counts = functions.setdefault(plain(symbol), dict.fromkeys(COUNTERS, 0))
            for counter, value in zip(COUNTERS, values):
                counts[counter] += int(value)
    return functions


def frame(folder, architecture, name):
    """Returns the counters of each function for one frame, or `None` if they were not counted."""
    path = os.path.join(folder, f"{architecture}-{name}")
    if not os.path.exists(f"{path}.{MANY}"):
        return None
    few, many = (counted(f"{path}.{frames}") for frames in (FEW, MANY))
    nothing = dict.fromkeys(COUNTERS, 0)
    return {
        function: {key: (counts[key] - few.get(function, nothing)[key]) / (MANY - FEW) for key in COUNTERS}
        for function, counts in many.items()
    }


def total(functions, counter="all"):
    """Returns the sum of a counter over all functions."""
    return sum(counts[counter] for counts in functions.values())


def print_functions(architecture, engine, functions, has_caches=False):
    """Prints the functions that take the most instructions. All columns are in millions."""
    all_of_frame = total(functions)
    print(f"\n{architecture}, {engine}: {all_of_frame / 1e6:.2f} M instructions a frame"
          + (", cache misses as on a Cortex-A53" if has_caches else ""))
    columns = COUNTERS[:10 if has_caches else 8] if architecture == "aarch64" else COUNTERS[:1]
    print("".join(f"{name.replace('_', ' '):>14}" for name in columns) + "  function")
    ordered = sorted(functions.items(), key=lambda item: -item[1]["all"])
    large = [(name, counts) for name, counts in ordered if counts["all"] >= SHOWN * all_of_frame]
    rest = [counts for name, counts in ordered if counts["all"] < SHOWN * all_of_frame]
    large.append((f"{len(rest)} others", {key: sum(counts[key] for counts in rest) for key in COUNTERS}))
    for name, counts in large:
        print("".join(f"{counts[key] / 1e6:14.3f}" for key in columns) + f"  {name[:80]}")


def print_cycles(folder):
    """Prints the estimate of cycles for each core."""
    print("\nestimate for the native engine, not confirmed on any board (cross/cycles.py says how it is made):")
    print(f"{'core':<12}{'board':<14}{'GHz':>5}{'L1 misses':>11}{'L2 misses':>11}{'M cycles':>18}{'ms a frame':>18}")
    for core in cycles.CORES:
        functions = frame(folder, "aarch64", core.name)
        bounds = cycles.estimate(core, functions)
        millions, ms = ([cycles_ / scale for cycles_ in bounds] for scale in (1e6, core.clock_ghz * 1e6))
        print(f"{core.name:<12}{core.board:<14}{core.clock_ghz:5.1f}{total(functions, 'l1_misses'):11,.0f}"
              f"{total(functions, 'l2_misses'):11,.0f}"
              + "".join(f"{f'{low:.1f} to {high:.1f}':>18}" for low, high in (millions, ms)))


def print_table(folder, frames):
    """Prints totals, functions and estimates."""
    print(f"{'instructions a frame':<24}{'M':>8}")
    for (architecture, engine), functions in frames.items():
        print(f"{architecture + ', ' + engine:<24}{total(functions) / 1e6:8.2f}")
    half = frame(folder, "aarch64", "half")
    if half:
        print(f"{'aarch64, native':<24}{total(half) / 1e6:8.2f}  (with half precision, as on a Cortex-A76)")
    tflite = frame(folder, "aarch64", "tflite")
    if tflite:
        print(f"{'aarch64, TFLite':<24}{total(tflite) / 1e6:8.2f}  (XNNPACK, the plain mesh without lips and eyes)")
    for (architecture, engine), functions in frames.items():
        # The run with simulated caches executes the same instructions.
        simulated = frame(folder, architecture, cycles.CORES[0].name) if engine == "native" else None
        print_functions(architecture, engine, simulated or functions, bool(simulated))
    print_cycles(folder)


def check(found, path):
    """Returns 0 unless a frame takes more instructions than the file allows."""
    with open(path, encoding="utf-8") as file:
        allowed = int(file.read().split()[0])
    print(f"cross/count: {found / 1e6:.3f} M instructions a frame on aarch64, {allowed / 1e6:.3f} M allowed")
    if found > SLACK * allowed:
        print("cross/count: that is too many: run cross/count to see which functions take them", file=sys.stderr)
        return 1
    if found * SLACK < allowed:
        print(f"cross/count: write {found:.0f} to cross/instructions-allowed, so that this gain cannot be lost unnoticed")
    return 0


def main():
    """Prints what the command line asks for."""
    form, folder, allowed = sys.argv[1:4]
    if form == "check":
        return check(total(frame(folder, "aarch64", "native")), allowed)
    frames = {key: functions for key in ENGINES if (functions := frame(folder, *key))}
    if form == "table":
        print_table(folder, frames)
        return 0
    table = {}
    for (architecture, engine), functions in frames.items():
        table.setdefault(architecture, {})[engine] = round(total(functions))
    print(json.dumps(table))
    return 0


if __name__ == "__main__":
    sys.exit(main())
