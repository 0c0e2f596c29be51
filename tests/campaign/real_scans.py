#!/usr/bin/env python3
"""Moves real scans by known transforms and associates each with itself: errors, NEES, pairs.

usage: real_scans.py USAR SCAN...
USAR is the program, SCAN an organised binary PCD whose first fields are x y z as 32-bit floats. Each scan is
taken whole, and with every second column. It is moved by poses up to 0.6 m and 15 degrees away, drawn with a
fixed seed, with odometry 20 mm and 0.3 degrees off and without any, and by the poses of the table. The points
stay those that the sensor saw from where it was, and the program finds out where that was: the errors are
those of rounding, and of surfaces that fall into other regions for it. NEES is over 6 degrees of freedom.
Needs numpy."""
import json
import os
import subprocess
import sys
import tempfile

import numpy as np

from scans_io import poses, turned, write_poses

SEED, DRAWN = 5, 16
NAMED = [(0.1, 0, 0), (0.2, 0, 0), (0.3, 0.1, 5), (0.5, 0, 10), (0.3, -0.4, -15), (1, 0, 0), (1, 0.2, 20)]


def load(path):
    raw = open(path, "rb").read()
    head, body = raw.split(b"DATA binary\n", 1)
    fields = dict(line.split(" ", 1) for line in head.decode().splitlines() if line[:1] not in "#")
    width, height = int(fields["WIDTH"]), int(fields["HEIGHT"])
    sizes = [int(a) * int(b) for a, b in zip(fields["SIZE"].split(), fields["COUNT"].split())]
    rows = np.frombuffer(body, np.uint8, width * height * sum(sizes)).reshape(-1, sum(sizes))
    return rows[:, :12].copy().view("<f4").reshape(height, width, 3).astype(float)


def save(path, points):
    height, width = points.shape[:2]
    head = ("VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
            f"WIDTH {width}\nHEIGHT {height}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {width * height}\nDATA binary\n")
    open(path, "wb").write(head.encode() + points.astype("<f4").tobytes())


def trial(usar, folder, points, truth, told):
    inverse = np.linalg.inv(truth)
    scans = [os.path.join(folder, name) for name in ("a.pcd", "b.pcd")]
    save(scans[0], points)
    save(scans[1], points @ inverse[:3, :3].T + inverse[:3, 3])
    odometry, out = os.path.join(folder, "odometry.tum"), os.path.join(folder, "out")
    line = [usar, "map", *scans, "--out", out, "-q"]
    if told is not None:
        write_poses(odometry, [np.eye(4), told])
        line += ["--odometry", odometry]
    subprocess.run(line, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    scan = json.load(open(os.path.join(out, "report.json")))["scans"][1]
    found = poses(os.path.join(out, "trajectory.tum"))[-1]
    turn = truth[:3, :3] @ found[:3, :3].T
    spin = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    error = np.concatenate([truth[:3, 3] - found[:3, 3], spin])
    nees = error @ np.linalg.solve(np.array(scan["covariance"]), error)
    return 1e3 * np.linalg.norm(error[:3]), np.degrees(np.linalg.norm(spin)), nees, scan["associations"], scan["planes"]


def main():
    usar, paths = sys.argv[1], sys.argv[2:]
    if not paths:
        sys.exit(__doc__)
    print("| Scan | Seen from (m, m, deg) | Error, mm | deg | NEES (6) | Paired of planes |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for path in paths:
            whole = load(path)
            for every in (1, 2):
                points, name = whole[:, ::every], f"{os.path.basename(path)}, every {every}"
                for named in NAMED:
                    truth = turned(*named)
                    mm, deg, nees, pairs, planes = trial(usar, folder, points, truth, truth)
                    print(f"| {name} | {named} | {mm:.1f} | {deg:.2f} | {nees:.1f} | {pairs} of {planes} |", flush=True)
                for odometry in (True, False):
                    rng = np.random.default_rng(SEED)
                    drawn = []
                    for _ in range(DRAWN):
                        truth = turned(*rng.uniform(-0.6, 0.6, 2), rng.uniform(-15, 15))
                        told = truth @ turned(*(0.02 * rng.standard_normal(2)), 0.3 * rng.standard_normal())
                        drawn.append(trial(usar, folder, points, truth, told if odometry else None))
                    mm, deg, nees, pairs, planes = np.array(drawn).T
                    what = f"{DRAWN} drawn{'' if odometry else ', no odometry'}: median (worst)"
                    print(f"| {name} | {what} | {np.median(mm):.2f} ({mm.max():.1f}) | {np.median(deg):.3f} "
                          f"({deg.max():.2f}) | {np.median(nees):.1f} ({nees.max():.0f}) | {pairs.sum() / planes.sum():.0%} |",
                          flush=True)


main()
