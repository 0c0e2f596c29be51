#!/usr/bin/env python3
"""Maps a series of scans with odometry that is wrong at every step and does not say so.

usage: odometry_errors.py USAR SERIES [--seeds N]
USAR is the program; SERIES a folder with scan_*.pcd and their true poses in truth.tum. Each step errs by so
many metres in a drawn direction and so many degrees to a drawn side. Told are the farthest that any scan was
put off, and how many of the drawn series ended within 20 mm. Needs numpy."""
import glob
import os
import subprocess
import sys
import tempfile

import numpy as np

from scans_io import poses, turned, write_poses

ERRORS = [(0.1, 2), (0.2, 3), (0.3, 3), (0.3, 5), (0.5, 10)]
NEAR_M = 0.02


def main():
    words, seeds = sys.argv[1:], 8
    if "--seeds" in words:
        at = words.index("--seeds")
        seeds = int(words[at + 1])
        del words[at : at + 2]
    if len(words) != 2:
        sys.exit(__doc__)
    usar, series = words
    scans, truth = sorted(glob.glob(os.path.join(series, "scan_*.pcd"))), poses(os.path.join(series, "truth.tum"))
    print("| Error of a step | Farthest off, mm, by seed | Ends within 20 mm |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        odometry, out = os.path.join(folder, "odometry.tum"), os.path.join(folder, "out")
        for metres, degrees in ERRORS:
            farthest, ends = [], 0
            for seed in range(seeds):
                random = np.random.default_rng(100 + seed)
                told = [truth[0]]
                for before, after in zip(truth, truth[1:]):
                    bearing, side = random.uniform(0, 2 * np.pi), random.choice([-1, 1])
                    error = turned(metres * np.cos(bearing), metres * np.sin(bearing), side * degrees)
                    told.append(told[-1] @ np.linalg.inv(before) @ after @ error)
                write_poses(odometry, told)
                command = [usar, "map", *scans, "--odometry", odometry, "--out", out, "-q"]
                subprocess.run(command, check=True, capture_output=True)
                found = poses(os.path.join(out, "trajectory.tum"))
                off = [np.linalg.norm(a[:3, 3] - b[:3, 3]) for a, b in zip(found, truth)]
                farthest.append(f"{1e3 * max(off):.0f}")
                ends += off[-1] < NEAR_M
            print(f"| {metres} m, {degrees}° | {', '.join(farthest)} | {ends} of {seeds} |", flush=True)


if __name__ == "__main__":
    main()
