#!/usr/bin/env python3
"""Segmentation beside its peers: quality and median time in one table, runs interleaved.

    tests/campaign/segment_peers.py BENCH WORK [--rounds N] [--noise MM ...] [--big] [--usar PROGRAM]

BENCH is the folder with synthscan.py, segscore.py, pcl_peers.cpp, cgal_ransac.cpp and o3d_planes.py; WORK is a
folder for scans and programs. Needs numpy and Pillow; PCL (libpcl-dev), CGAL (libcgal-dev, libgmp-dev,
libmpfr-dev) and Open3D (PyPI) take part where they are installed. Scenes and scoring are those of the peers'
own table: regions of at least 40 pixels, 80 % overlap, labels split into 8-connected components. The oracle
knows the true surfaces and gives each pixel to the one of those within a pixel that explains its range best.
After the table of each noise come the stages' times, the paper's chain with and without its check by normals,
and how many coordinates each number that is kept of a surface stands for.
"""
import argparse, json, os, pathlib, shutil, statistics, subprocess, sys
import numpy as np
from PIL import Image

SCENES = ("room", "corridor", "hall")
KINDS = {"plane": 1, "cylinder": 2, "sphere": 3}
FLAGS = {
    "omps": "omps ne=1 nss=8 dds=1 mdc=0.02 ang=12 dist=0.01 curv=0.05 min=100 mirror=1 refine=1",
    "rn": "rn k=30 eps=0.03 nthr=0.75 min=60 ceps=0.4",
}


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bench", type=pathlib.Path)
    parser.add_argument("work", type=pathlib.Path)
    parser.add_argument("--rounds", type=int, default=5, help="interleaved rounds, 21 runs in each (CGAL, Open3D: 1)")
    parser.add_argument("--noise", type=float, nargs="+", default=[10.0, 5.0, 20.0, 30.0], help="standard deviations of the ranges in mm")
    parser.add_argument("--big", action="store_true", help="880 x 721 points instead of 220 x 131")
    parser.add_argument("--ours", action="store_true", help="without the peers")
    parser.add_argument("--usar", default="target/release/usar")
    return parser.parse_args()


def make_scenes(options, synthscan, noise):
    scenes = {}
    for k, name in enumerate(SCENES):
        world = synthscan.scene(name)
        pitch = dict(rows=880, cols=721, dtilt=0.0625) if options.big else {}
        scan = synthscan.scan(world, seed=100 + k, sigma=noise / 1000, **pitch)
        columns = slice(0, 721) if options.big else slice(25, 156)
        surf = scan["surf"][:, columns]
        path = options.work / f"{name}.pcd"
        synthscan.write_pcd(path, scan["xyz"][:, columns])
        scenes[name] = dict(
            path=path, surf=surf, truth=synthscan.components(surf), kinds=world.kinds(), world=world,
            range=scan["range"][:, columns], rays=synthscan.scan_dirs(**pitch)[:, columns], prm=scan["prm"],
        )
    return scenes


def oracle(scene):
    """Each pixel to the surface within one pixel whose exact range is nearest to the reading."""
    surf, reading, rays = scene["surf"], scene["range"], scene["rays"]
    ranges = {0: np.full(surf.shape, np.inf)}
    for i in np.unique(surf[surf > 0]):
        p, kind = scene["prm"][i], scene["kinds"][i]
        with np.errstate(all="ignore"):
            if kind == 1:
                t = p[3] / (rays @ p[:3])
            else:
                d = rays if kind == 3 else rays - (rays @ p[3:6])[..., None] * p[3:6]
                c = p[:3] if kind == 3 else p[:3] - (p[:3] @ p[3:6]) * p[3:6]
                a, b = (d**2).sum(-1), d @ c
                t = (b - np.sqrt(b * b - a * (c @ c - p[6] ** 2))) / a
        ranges[int(i)] = np.where(np.isfinite(t) & (t > 0), t, np.inf)
    best, error = surf.copy(), np.full(surf.shape, np.inf)
    padded = np.pad(surf, 1)
    for down in range(3):
        for right in range(3):
            near = padded[down : down + surf.shape[0], right : right + surf.shape[1]]
            for i in np.unique(near[near > 0]):
                e = np.where(near == i, np.abs(ranges[int(i)] - reading), np.inf)
                best, error = np.where(e < error, i, best), np.minimum(e, error)
    return np.where(surf > 0, best, 0)


def score(scene, labels, kinds, segscore):
    """planes, planes in truth, all, all in truth, typed right, over, under, noise"""
    truth, surf = scene["truth"], scene["surf"]
    found = segscore.split(labels, 40)
    every = segscore.score(truth, found, min_ms=40)
    planes = segscore.score(truth, found, min_ms=40, ignore=scene["kinds"][surf] > 1)
    typed = 0
    for t, f, _, _ in every["pairs"]:
        ids, counts = np.unique(labels[(truth == t) & (found == f)], return_counts=True)
        typed += kinds.get(int(ids[counts.argmax()]), 0) == scene["kinds"][surf[truth == t][0]]
    return np.array([planes["correct"], planes["n_gt"], every["correct"], every["n_gt"], typed,
                     every["over"], every["under"], every["noise"]])


def run(command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    if done.returncode:
        sys.exit(f"{command[0]}: {done.stderr}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def usar(options, scene, method, *flags):
    png = options.work / f"{method}.png"
    command = [options.usar, "segment", scene["path"], "--method", method, "--labels", png, "--format", "json", "--repeat", 21]
    surfaces = run([*command, *flags])
    labels = np.array(Image.open(png)).astype(np.int64)
    scene["surfaces"] = surfaces["surfaces"]
    return labels, {s["id"]: KINDS.get(s["kind"], 0) for s in surfaces["surfaces"]}, surfaces["timing_ms"]


def compactness(surfaces):
    """Coordinates of the points for each number kept: planes 3 and 2 for each corner, spheres 4, cylinders 7."""
    kept = {"plane": lambda s: 3 + 2 * len(s["hull"]), "sphere": lambda s: 4, "cylinder": lambda s: 7}
    known = [s for s in surfaces if s["kind"] in kept]
    return 3 * sum(s["points"] for s in known) / max(1, sum(kept[s["kind"]](s) for s in known))


def peer(options, scene, program, flags, runs):
    out = options.work / "peer"
    if program.name == "pcl_peers":
        told = run([program, scene["path"], out, *flags.split(), f"runs={runs}"])
        file = options.work / "peer.i32"
    else:
        told = run([program, scene["path"], options.work / "peer.i32", *flags.split(), f"runs={runs}"])
        file = options.work / "peer.i32"
    labels = np.fromfile(file, np.int32).reshape(scene["surf"].shape).astype(np.int64)
    total = next(told[k] for k in ("total_ms", "ms", "median_ms") if k in told)
    shapes = told.get("kinds") or "p" * int(labels.max())
    return labels, {i + 1: {"p": 1, "c": 2, "s": 3}.get(shape.lower(), 0) for i, shape in enumerate(shapes)}, {"total": total}


def build(options, source, libraries):
    program = options.work / source.stem
    if not program.exists() and shutil.which("g++"):
        line = ["g++", "-O3", "-DNDEBUG", "-std=c++17", "-fopenmp", "-I/usr/include/eigen3", "-I/usr/include/pcl-1.13", source, "-o", program]
        subprocess.run([str(c) for c in line + libraries], capture_output=True)
    return program if program.exists() else None


def open3d_patches(scene):
    import time
    import open3d
    cloud = open3d.geometry.PointCloud()
    surf = scene["surf"]
    points = (scene["rays"] * scene["range"][..., None])[surf > 0]
    cloud.points = open3d.utility.Vector3dVector(points)
    start = time.perf_counter()
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(50))
    patches = cloud.detect_planar_patches(
        normal_variance_threshold_deg=60, coplanarity_deg=75, outlier_ratio=0.75, min_plane_edge_length=0,
        min_num_points=40, search_param=open3d.geometry.KDTreeSearchParamKNN(50))
    spent = 1e3 * (time.perf_counter() - start)
    flat = np.zeros(len(points), np.int64)
    best = np.full(len(points), np.inf)
    for k, box in enumerate(patches):
        inside = np.array(box.get_point_indices_within_bounding_box(cloud.points), dtype=int)
        gap = np.abs((points[inside] - box.center) @ np.asarray(box.R)[:, 2])
        nearer = gap < best[inside]
        flat[inside[nearer]], best[inside[nearer]] = k + 1, gap[nearer]
    labels = np.zeros(surf.shape, np.int64)
    labels[surf > 0] = flat
    return labels, {k + 1: 1 for k in range(len(patches))}, {"total": spent}


def main():
    options = arguments()
    sys.path.insert(0, str(options.bench))
    import segscore, synthscan
    options.work.mkdir(parents=True, exist_ok=True)
    pcl = cgal = None
    if not options.ours:
        pcl = build(options, options.bench / "pcl_peers.cpp", [f"-lpcl_{l}" for l in (
            "segmentation", "features", "search", "kdtree", "sample_consensus", "filters", "common")])
        cgal = build(options, options.bench / "cgal_ransac.cpp", ["-lgmp", "-lmpfr"])
    ways = {
        "usar": lambda s: usar(options, s, "sticks"),
        "usar, paper's chain": lambda s: usar(options, s, "paper"),
        " the same, no normal check": lambda s: usar(options, s, "paper", "--without-normal-check"),
    }
    if pcl:
        ways["PCL organised multi-plane"] = lambda s: peer(options, s, pcl, FLAGS["omps"], 21)
    once = {}
    if cgal:
        once["CGAL efficient RANSAC"] = lambda s: peer(options, s, cgal, FLAGS["rn"], 1)
    try:
        if not options.ours:
            import open3d  # noqa: F401
            once["Open3D planar patches"] = open3d_patches
    except ImportError:
        pass
    for noise in options.noise:
        table(options, ways, once, make_scenes(options, synthscan, noise), noise, segscore)


def table(options, ways, once, scenes, noise, segscore):
    every = {**ways, **once}
    times = {way: {name: [] for name in SCENES} for way in every}
    stages, scores, kept = {}, {}, {}
    for round_ in range(options.rounds):
        for way, segment in every.items():
            # What takes a second need not run as often as what takes a millisecond.
            if round_ > 2 and way in once:
                continue
            total = np.zeros(8, int)
            for name, scene in scenes.items():
                labels, kinds, spent = segment(scene)
                times[way][name].append(spent["total"])
                if len(spent) > 1:
                    stages.setdefault(way, []).append(spent)
                    kept.setdefault(way, []).append(compactness(scene["surfaces"]))
                if round_ == 0:
                    total += score(scene, labels, kinds, segscore)
            if round_ == 0:
                scores[way] = total
    best = sum(score(s, oracle(s), {i: int(k) for i, k in enumerate(s["kinds"])}, segscore) for s in scenes.values())
    print(f"noise {noise:g} mm, {next(iter(scenes.values()))['surf'].shape}, {options.rounds} interleaved rounds, one thread")
    print(f"{'':<28}{'planes':>8}{'all':>8}{'typed':>7}{'over':>6}{'under':>6}{'noise':>6}   " + "".join(f"{n + ' ms':>13}" for n in SCENES))
    for way, total in [("oracle", best), *scores.items()]:
        row = f"{way:<28}{f'{total[0]}/{total[1]}':>8}{f'{total[2]}/{total[3]}':>8}{total[4]:>7}{total[5]:>6}{total[6]:>6}{total[7]:>6}   "
        print(row + "".join(f"{statistics.median(times[way][n]):>13.2f}" for n in SCENES if way in times))
    for way, spent in stages.items():
        print(f"stages of {way.strip()}: " + ", ".join(f"{k} {statistics.median(s[k] for s in spent):.3f}" for k in spent[0])
              + f" ms; {statistics.mean(kept[way]):.0f} coordinates for each number kept")
    checked, unchecked = "usar, paper's chain", " the same, no normal check"
    pairs = [(a, b) for n in SCENES for a, b in zip(times[checked][n], times[unchecked][n])]
    print(f"the check by normals takes {100 * statistics.median(a / b - 1 for a, b in pairs):+.1f} % of the chain's time without it; "
          f"under-segmented regions {scores[unchecked][6]} without, {scores[checked][6]} with", flush=True)


if __name__ == "__main__":
    main()
