#!/usr/bin/env python3
"""Pair by pair: `usar map` beside point-cloud registration of the same scans by small_gicp (PyPI).

usage: registration.py USAR FOLDER
FOLDER holds organised scans scan_*.pcd with odometry.tum and truth.tum (poses of the sensor at each
scan). Every pair of successive scans is registered by small_gicp from the odometry between them, one
thread, preprocessing included; `usar map` takes the scans in order. Needs numpy and small_gicp."""
import glob
import json
import subprocess
import sys
import tempfile
import time

import numpy as np
import small_gicp

from scans_io import points, poses


def error(estimate, truth):
    gap = np.linalg.inv(truth) @ estimate
    turn = np.degrees(np.arccos(np.clip((np.trace(gap[:3, :3]) - 1) / 2, -1, 1)))
    return 1e3 * np.linalg.norm(gap[:3, 3]), turn


def row(name, errors, milliseconds):
    errors = np.array(errors)
    print(f"{name:28s} median {np.median(errors[:, 0]):7.2f} mm {np.median(errors[:, 1]):.4f} deg,  "
          f"worst {errors[:, 0].max():7.2f} mm {errors[:, 1].max():.4f} deg,  "
          f"{np.median(milliseconds):7.2f} ms a scan")


def main():
    usar, folder = sys.argv[1:]
    scans = sorted(glob.glob(f"{folder}/scan_*.pcd"))
    told, truth = poses(f"{folder}/odometry.tum"), poses(f"{folder}/truth.tum")
    motions = [np.linalg.inv(truth[k]) @ truth[k + 1] for k in range(len(scans) - 1)]
    guesses = [np.linalg.inv(told[k]) @ told[k + 1] for k in range(len(scans) - 1)]
    row("odometry", [error(g, m) for g, m in zip(guesses, motions)], [0.0])
    clouds = [points(scan) for scan in scans]
    for kind in ("GICP", "VGICP", "PLANE_ICP", "ICP"):
        for warm in (True, False):
            errors, times = [], []
            for k, motion in enumerate(motions):
                began = time.perf_counter()
                found = small_gicp.align(
                    clouds[k], clouds[k + 1], init_T_target_source=guesses[k], registration_type=kind,
                    downsampling_resolution=0.25, max_correspondence_distance=0.5,
                    voxel_resolution=0.5, num_threads=1)
                times.append(1e3 * (time.perf_counter() - began))
                errors.append(error(found.T_target_source, motion))
            if not warm:
                row(f"small_gicp {kind}, 0.25 m", errors, times)
    for mode in ("full", "mip"):
        with tempfile.TemporaryDirectory() as out:
            command = [usar, "map", *scans, "--odometry", f"{folder}/odometry.tum", "--mode", mode,
                       "--out", out, "--format", "json"]
            report = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
            mapped = poses(f"{out}/trajectory.tum")
        errors = [error(np.linalg.inv(mapped[k]) @ mapped[k + 1], m) for k, m in enumerate(motions)]
        row(f"usar map --mode {mode}", errors, [report["segment_ms"] + report["map_ms"]])


if __name__ == "__main__":
    main()
