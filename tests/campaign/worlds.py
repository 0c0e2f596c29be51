#!/usr/bin/env python3
"""Flies scenarios with several seeds and prints how far off each mission ended, beside odometry and the
inertial unit alone.

usage: worlds.py USAR FOLDER [SCENARIO...] [--seeds 1,2,3,4,5]
USAR is the program, FOLDER takes the run folders. Without a scenario: all of scenarios/. An end is within
bounds when it is at most 0.1 % of the distance driven or 0.03 m off, whichever is larger, and 0.3 deg.
One to two minutes a flight of 20 minutes on one free core."""
import glob
import json
import os
import subprocess
import sys

HEAD = "| Mission | Coverage | Path, m | End, m | End, ° | RMS, m | NEES (6) | Right, wrong | Odometry, m | INS, m |"


def fly(usar, scenario, seed, folder):
    subprocess.run(
        [usar, "mission", scenario, "--seed", str(seed), "--out", folder, "--force", "-q"],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    told = subprocess.run(
        [usar, "eval", folder, "--scenario", scenario, "--format", "json"],
        check=True,
        capture_output=True,
    ).stdout
    return json.loads(told), json.load(open(os.path.join(folder, "report.json")))


def number(value, digits):
    return "-" if value is None else f"{value:.{digits}f}"


def main():
    words, seeds = sys.argv[1:], range(1, 6)
    if "--seeds" in words:
        at = words.index("--seeds")
        seeds = [int(seed) for seed in words[at + 1].split(",")]
        del words[at : at + 2]
    if len(words) < 2:
        sys.exit(__doc__)
    usar, folder, scenarios = words[0], words[1], words[2:]
    if not scenarios:
        here = os.path.dirname(os.path.abspath(__file__))
        scenarios = sorted(glob.glob(os.path.join(here, "../../scenarios/*.toml")))
    print(HEAD)
    print("|" + "---|" * (HEAD.count("|") - 1))
    within = flights = 0
    for scenario in scenarios:
        name = os.path.basename(scenario).removesuffix(".toml")
        for seed in seeds:
            told, report = fly(usar, scenario, seed, os.path.join(folder, f"{name}-{seed}"))
            ate, path_m = told["ate"], told["true_path_m"]
            nees, pairs, pose = told["nees"], told["associations"], report["pose_error"]
            flights += 1
            within += ate["final_m"] <= max(0.03, 0.001 * path_m) and ate["final_deg"] <= 0.3
            print(
                f"| {name}, seed {seed} | {number(told['coverage'], 2)} | {path_m:.0f} | {ate['final_m']:.3f} "
                f"| {ate['final_deg']:.2f} | {ate['rmse_m']:.3f} | {number(nees and nees['mean'], 1)} "
                f"| {pairs['right']}, {pairs['wrong']} | {number(pose['odometry_final_m'], 2)} "
                f"| {number(pose['ins_final_m'], 2)} |"
                + ("" if told["falls"] == 0 else f" {told['falls']} FALLS")
                + ("" if told["collisions"] == 0 else f" {told['collisions']} collisions"),
                flush=True,
            )
    print(f"\n{within} of {flights} ends within bounds")


if __name__ == "__main__":
    main()
