#!/usr/bin/env python3
"""Maps a series of scans with odometry that is right but for one slip that it does not tell of.

usage: slips.py USAR SERIES [METRES...]
USAR is the program; SERIES a folder with scan_*.pcd and their true poses in truth.tum; METRES how far the
wheels slip, 0.2, 0.3 and 0.6 where nothing is said. Every step slips once, in each of four directions. Told
are the series that end more than 50 mm off, the worst, and the worst NEES of a series, the mean over its
scans, where 6 is expected. Needs numpy."""
import glob
import json
import os
import subprocess
import sys
import tempfile

import numpy as np

from scans_io import poses, write_poses

NEAR_M = 0.05


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    usar, series = sys.argv[1:3]
    lengths = [float(word) for word in sys.argv[3:]] or [0.2, 0.3, 0.6]
    scans, truth = sorted(glob.glob(os.path.join(series, "scan_*.pcd"))), poses(os.path.join(series, "truth.tum"))
    print("| Slip | Series | End off | Worst, m | Worst NEES (6) |")
    print("|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for metres in lengths:
            ends = [end(usar, folder, series, scans, truth, at, metres * np.array(way))
                    for at in range(1, len(truth)) for way in [(1, 0), (-1, 0), (0, 1), (0, -1)]]
            off, nees = np.array(ends).T
            print(f"| {metres} m | {len(ends)} | {(off > NEAR_M).sum()} | {off.max():.3f} | {nees.max():.1f} |", flush=True)


def end(usar, folder, series, scans, truth, at, slip):
    """How far off the series ends in metres, and its NEES."""
    told = [truth[0]]
    for step in range(1, len(truth)):
        motion = np.linalg.inv(truth[step - 1]) @ truth[step]
        if step == at:
            motion[:2, 3] += slip
        told.append(told[-1] @ motion)
    odometry, out = os.path.join(folder, "odometry.tum"), os.path.join(folder, "out")
    write_poses(odometry, told)
    subprocess.run([usar, "map", *scans, "--odometry", odometry, "--truth", os.path.join(series, "truth.tum"),
                    "--out", out, "-q"], check=True, stdout=subprocess.DEVNULL)
    found = poses(os.path.join(out, "trajectory.tum"))[-1]
    nees = json.load(open(os.path.join(out, "report.json")))["pose_error"]["nees_mean"]
    return np.linalg.norm(found[:3, 3] - truth[-1][:3, 3]), nees


if __name__ == "__main__":
    main()
