"""Poses and clouds as the campaigns read them: TUM lines read and written, and binary PCD that begins with x y z. Needs numpy."""
import numpy as np


def matrix(translation, rotation):
    """4 x 4 from metres and a quaternion (x, y, z, w)."""
    (x, y, z, w), out = rotation, np.eye(4)
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, 3] = translation
    return out


def poses(path):
    """The poses of a TUM file, in order."""
    lines = (line for line in open(path) if line.strip() and not line.startswith("#"))
    numbers = ([float(word) for word in line.split()] for line in lines)
    return [matrix(row[1:4], row[4:8]) for row in numbers]


def quaternion(rotation):
    """x, y, z, w; the greatest of them is found first."""
    values, vectors = np.linalg.eigh(
        np.array([
            [rotation[0, 0] - rotation[1, 1] - rotation[2, 2], 0, 0, 0],
            [rotation[1, 0] + rotation[0, 1], rotation[1, 1] - rotation[0, 0] - rotation[2, 2], 0, 0],
            [rotation[2, 0] + rotation[0, 2], rotation[2, 1] + rotation[1, 2],
             rotation[2, 2] - rotation[0, 0] - rotation[1, 1], 0],
            [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0],
             rotation[1, 0] - rotation[0, 1], np.trace(rotation)],
        ])
    )
    return vectors[:, np.argmax(values)]


def write_poses(path, series):
    """Poses as a TUM file, one a second."""
    with open(path, "w") as out:
        for k, pose in enumerate(series):
            numbers = [*pose[:3, 3], *quaternion(pose[:3, :3])]
            out.write(" ".join([str(k), *(f"{number:.9f}" for number in numbers)]) + "\n")


def turned(x, y, yaw_deg):
    """A pose on the ground, in metres and degrees."""
    sin, cos = np.sin(np.radians(yaw_deg)), np.cos(np.radians(yaw_deg))
    pose = np.eye(4)
    pose[:2, :2], pose[:2, 3] = [[cos, -sin], [sin, cos]], (x, y)
    return pose


def points(path):
    """The finite points of an organised cloud."""
    raw = open(path, "rb").read()
    head, body = raw.split(b"DATA binary\n", 1)
    fields = dict(line.split(" ", 1) for line in head.decode().splitlines() if line[:1] not in "#")
    count = int(fields["POINTS"])
    cloud = np.frombuffer(body, "<f4", 3 * count).reshape(count, 3).astype(float)
    return cloud[np.isfinite(cloud[:, 0])]
