#!/usr/bin/env python3
"""Where the missions that worlds.py flew would have ended by other means: odometry alone, the inertial unit
alone, 2D scan matching of the level lines, and point-cloud registration of the same scans by small_gicp (PyPI).

usage: worlds_peers.py USAR FOLDER [MISSION...]
FOLDER holds the run folders of worlds.py; MISSION is the name of one, as station-1; without it all. small_gicp
starts from the dead reckoning that the program had: scan to scan, and scan to all scans before thinned to
0.25 m; GICP and point-to-plane, the better one is told. The 2D baseline flies the mission once more (`usar
paper compare2d`), its end is compared in the plane. Needs numpy and small_gicp."""
import glob
import json
import os
import subprocess
import sys
import tempfile

import numpy as np
import small_gicp

from scans_io import matrix, points, poses


def truth_at(folder, times):
    """Poses of the robot in truth.tum, the nearest in time."""
    rows = [line.split() for line in open(f"{folder}/truth.tum") if line.strip() and line[0] != "#"]
    stamps = np.array([float(row[0]) for row in rows])
    all_poses = poses(f"{folder}/truth.tum")
    return [all_poses[int(np.argmin(np.abs(stamps - time)))] for time in times]


def apart(estimate, truth):
    gap = np.linalg.inv(truth) @ estimate
    turn = np.degrees(np.arccos(np.clip((np.trace(gap[:3, :3]) - 1) / 2, -1, 1)))
    return np.linalg.norm(gap[:3, 3]), turn


def thinned(cloud, cell_m=0.25):
    _, first = np.unique(np.floor(cloud / cell_m).astype(int), axis=0, return_index=True)
    return cloud[first]


def registered(clouds, told, kind, whole_map):
    """The poses that small_gicp gives the scans."""
    found = [told[0]]
    world = clouds[0] @ told[0][:3, :3].T + told[0][:3, 3]
    for k in range(1, len(clouds)):
        motion = np.linalg.inv(told[k - 1]) @ told[k]
        guess = found[-1] @ motion
        target = thinned(world) if whole_map else clouds[k - 1]
        start = guess if whole_map else motion
        aligned = small_gicp.align(
            target, clouds[k], init_T_target_source=start, registration_type=kind,
            downsampling_resolution=0.25, max_correspondence_distance=0.5, num_threads=1)
        pose = aligned.T_target_source if whole_map else found[-1] @ aligned.T_target_source
        found.append(pose)
        if whole_map:
            world = np.vstack([world, thinned(clouds[k]) @ pose[:3, :3].T + pose[:3, 3]])
    return found


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    usar, folder, names = sys.argv[1], sys.argv[2], sys.argv[3:]
    runs = [f"{folder}/{name}" for name in names] or sorted(
        run for run in glob.glob(f"{folder}/*-*") if os.path.exists(f"{run}/report.json"))
    print("| Mission | This program | 2D matching | GICP, scan to scan | GICP, to the map | Odometry | INS |")
    print("|---|---|---|---|---|---|---|")
    for run in runs:
        name, seed = os.path.basename(run).rsplit("-", 1)
        told = json.loads(subprocess.run(
            [usar, "eval", run, "--scenario", f"scenarios/{name}.toml", "--format", "json"],
            check=True, capture_output=True).stdout)
        report = json.load(open(f"{run}/report.json"))["pose_error"]
        with tempfile.TemporaryDirectory() as work:
            subprocess.run([usar, "export", run, "--to", "scans", "-o", f"{work}/scans"],
                           check=True, stdout=subprocess.DEVNULL)
            reckoned = poses(f"{work}/scans/odometry.tum")
            times = [float(line.split()[0]) for line in open(f"{work}/scans/odometry.tum")]
            clouds = [points(scan) for scan in sorted(glob.glob(f"{work}/scans/scan_*.pcd"))]
            subprocess.run([usar, "paper", "compare2d", "--scenario", f"scenarios/{name}.toml", "--seed", seed,
                            "--out", f"{work}/flat"], check=True, stdout=subprocess.DEVNULL)
            flat = json.load(open(f"{work}/flat/compare2d.json"))["error_2d"]
        # The robot's way since the first scan, by the sensor's.
        truth = truth_at(run, times)
        first = json.load(open(f"{run}/keyframes.json"))[0]["pose"]
        first = matrix(first["translation"], first["rotation"])
        robot_from_sensor = np.linalg.inv(first) @ reckoned[0]
        moved = np.linalg.inv(truth[0]) @ truth[-1]
        ends = []
        for whole_map in (False, True):
            tries = [registered(clouds, reckoned, kind, whole_map) for kind in ("GICP", "PLANE_ICP")]
            ways = [np.linalg.inv(found[0]) @ found[-1] for found in tries]
            ends.append(min(
                apart(robot_from_sensor @ way @ np.linalg.inv(robot_from_sensor), moved) for way in ways))
        show = lambda gap: f"{gap[0]:.3f} m, {gap[1]:.2f}°"
        alone = lambda which: "-" if report.get(which) is None else f"{report[which]:.2f} m"
        print(f"| {name}, seed {seed} | {show((told['ate']['final_m'], told['ate']['final_deg']))} | {show(flat)} | "
              f"{show(ends[0])} | {show(ends[1])} | {alone('odometry_final_m')} | {alone('ins_final_m')} |", flush=True)


if __name__ == "__main__":
    main()
