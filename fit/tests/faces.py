#!/usr/bin/env python3
"""Packs a dataset of `synth` for the tests of `fit/`: landmarks in 1/32 pixel and coefficients in 1/1000, 16 bits each.

    facewire-fit synth faces.npz --pictures 320 --per-subject 10 --seed 11 --set judge \\
        --mix single=40,recorded=40,combined=20
    fit/tests/faces.py faces.npz fit/tests/faces.npz        (needs numpy)
"""

import sys

import numpy as np

faces = np.load(sys.argv[1])
np.savez_compressed(
    sys.argv[2],
    landmarks=np.round(faces["landmarks"] * 32).astype(np.int16),
    weights=np.round(faces["weights"] * 1000).astype(np.int16),
    pose=np.round(faces["pose"] * 64).astype(np.int16),
    subject=faces["subject"].astype(np.int16),
    neutral=faces["meta"][:, 4].astype(np.int16),
)
