#!/usr/bin/env python3
"""What a mission's map takes beside the point cloud and an octree of the same mission: elements and bytes.

usage: map_size.py USAR RUN...
RUN is a run folder. Counted are: planes, cylinders and spheres of surfaces.json with the vertices of their hulls,
at four bytes a number (a plane: normal, offset and vertices in the plane; a cylinder 7 numbers, a sphere 4), and the
rectangles of their masks, two bytes for each of their four edges, in cells; the
points of the sweeps, twelve bytes each, and those of all lines that are in the map thinned to 5 cm; an octree of the thinned points
with leaves of 5 cm, written as OctoMap writes its binary files, two bits for each child of an inner node. Needs
numpy."""
import json
import os
import subprocess
import sys
import tempfile

import numpy as np

from scans_io import points


def octree(cloud, leaf_m=0.05):
    """Leaves and inner nodes of the tree over the cells that hold points."""
    cells = np.unique(np.floor(cloud / leaf_m).astype(np.int64), axis=0)
    leaves, inner = len(cells), 0
    # Up to the root of a tree of 16 levels, as OctoMap's.
    for _ in range(16):
        cells = np.unique(cells >> 1, axis=0)
        inner += len(cells)
    return leaves, inner


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    usar = sys.argv[1]
    print("| Mission | Map: surfaces, vertices, kB | With masks: rectangles, kB | Points of the sweeps, MB | Thinned to 5 cm, kB | Octree: leaves, kB |")
    print("|---|---|---|---|---|---|")
    for run in sys.argv[2:]:
        surfaces = json.load(open(f"{run}/surfaces.json"))["surfaces"]
        planes = [surface for surface in surfaces if surface["kind"] == "plane"]
        vertices = sum(len(plane["hull"]) for plane in planes)
        numbers = 4 * len(planes) + 2 * vertices + sum(
            {"cylinder": 7, "sphere": 4}.get(surface["kind"], 0) for surface in surfaces)
        rectangles = sum(len(plane["mask"]) for plane in planes)
        with tempfile.TemporaryDirectory() as work:
            subprocess.run([usar, "export", run, "--to", "scans", "-o", f"{work}/scans"],
                           check=True, stdout=subprocess.DEVNULL)
            subprocess.run([usar, "export", run, "--to", "pcd", "-o", f"{work}/all.pcd"],
                           check=True, stdout=subprocess.DEVNULL)
            raw = sum(len(points(f"{work}/scans/{name}")) for name in os.listdir(f"{work}/scans")
                      if name.endswith(".pcd"))
            thinned = points(f"{work}/all.pcd")
        leaves, inner = octree(thinned)
        print(f"| {os.path.basename(os.path.normpath(run))} | {len(surfaces)}, {vertices}, {4 * numbers / 1e3:.1f} "
              f"| {rectangles}, {(4 * numbers + 8 * rectangles) / 1e3:.1f} "
              f"| {12 * raw / 1e6:.2f} | {12 * len(thinned) / 1e3:.0f} | {leaves}, {2 * inner / 1e3:.0f} |", flush=True)


if __name__ == "__main__":
    main()
