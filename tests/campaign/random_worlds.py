#!/usr/bin/env python3
"""Draws worlds that nobody has tuned anything to and flies each once.

usage: random_worlds.py USAR FOLDER [FIRST LAST [board|no-ins]]
USAR is the program, FOLDER takes worlds/N.toml, scenarios/N.toml and runs/N; FIRST and LAST are numbers of worlds, 1
and 40 where nothing is said. A world is a walled hall of 7 to 18 m with pits in its floor, inner walls with
doorways, crates, planks, tables, beams, columns, balls, kerbs, ramps, platforms, leaning boards and slabs, begun at
any heading; odd ones are on a UDK server, half of the even ones have noisier ranges and wheels that slip. Told are
coverage, way, the end's error, NEES (6 expected), pairs right and wrong, falls, collisions and times that the robot
stood wedged. With `board` one wheel of the robot is set down on a board of 2 to 5 cm, with `no-ins` its inertial unit
never tells anything. Ten to fifteen seconds a flight of 500 s on one free core."""
import json
import math
import os
import random
import subprocess
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
SECONDS = 500.0


class Draw:
    """One world in the making."""

    def __init__(self, number):
        self.r = random.Random(number)
        self.lines = []
        self.half = [self.r.randint(8, 18) / 2, self.r.randint(7, 14) / 2]
        self.start = [self.r.uniform(1.5 - half, half - 1.5) for half in self.half]
        self.height = self.r.uniform(2.3, 4.0)
        self.count = 0

    def solid(self, kind, centre, rpy_deg=(0.0, 0.0, 0.0), **shape):
        self.count += 1
        values = {"name": f'"{kind}{self.count}"', "center": [round(x, 3) for x in centre]}
        values |= {key: [round(x, 3) for x in value] if isinstance(value, tuple) else round(value, 3)
                   for key, value in shape.items()}
        if any(rpy_deg):
            values["rpy_deg"] = [round(x, 2) for x in rpy_deg]
        self.lines.append(f"[[{kind}]]\n" + "\n".join(f"{key} = {value}" for key, value in values.items()))

    def far_from_start(self, x, y, metres):
        return math.hypot(x - self.start[0], y - self.start[1]) > metres

    def floor(self):
        """Slabs of one metre's width, with pits of 12 cm to 1 m."""
        (half_x, half_y), pits = self.half, {}
        columns, rows = int(2 * half_x), int(2 * half_y)
        for _ in range(self.r.choice([0, 1, 1, 2, 3])):
            x, y, depth = self.r.randrange(columns), self.r.randrange(rows), self.r.choice([0.12, 0.25, 0.5, 1.0])
            cells = [(i, j) for i in range(x, min(columns, x + self.r.randint(1, 4)))
                     for j in range(y, min(rows, y + self.r.randint(1, 3)))]
            if all(self.far_from_start(i + 0.5 - half_x, j + 0.5 - half_y, 1.6) for i, j in cells):
                pits |= {cell: depth for cell in cells}
        for j in range(rows):
            i = 0
            while i < columns:
                depth, end = pits.get((i, j), 0.0), i
                while end < columns and pits.get((end, j), 0.0) == depth:
                    end += 1
                middle = ((i + end) / 2 - half_x, j + 0.5 - half_y, -depth - 0.75)
                self.solid("box", middle, size=(float(end - i), 1.0, 1.5))
                i = end

    def walls(self):
        (x, y), height = self.half, self.height
        for side in (-1, 1):
            middle_m = height / 2 - 0.75
            self.solid("box", (side * (x + 0.1), 0.0, middle_m), size=(0.2, 2 * y + 0.4, height + 1.5))
            self.solid("box", (0.0, side * (y + 0.1), middle_m), size=(2 * x, 0.2, height + 1.5))
        if self.r.random() < 0.5:
            self.solid("box", (0.0, 0.0, height + 0.1), size=(2 * x, 2 * y, 0.2))
        for _ in range(self.r.choice([0, 1, 2, 3])):
            self.inner_wall(self.r.randrange(2), self.r.choice([0.04, 0.1, 0.2]))

    def inner_wall(self, across, thick_m):
        """From wall to wall, with one doorway; `across` is the axis that it stands across."""
        at = self.r.uniform(2 - self.half[across], self.half[across] - 2)
        if abs(at - self.start[across]) < 0.7:
            return
        half = self.half[1 - across]
        door, wide = self.r.uniform(0.8 - half, half - 2.0), self.r.uniform(0.9, 1.6)
        for low, high in ((-half, door), (door + wide, half)):
            if high - low < 0.1:
                continue
            centre, size = [0.0, 0.0, self.height / 2], [0.0, 0.0, self.height]
            centre[across], size[across] = at, thick_m
            centre[1 - across], size[1 - across] = (low + high) / 2, high - low
            self.solid("box", centre, size=tuple(size))

    def place(self, metres):
        """Somewhere so far from the start, or nowhere."""
        for _ in range(50):
            x, y = (self.r.uniform(0.3 - half, half - 0.3) for half in self.half)
            if self.far_from_start(x, y, metres + 0.7):
                return x, y
        return None

    def thing(self):
        r, yaw = self.r, self.r.uniform(0.0, 360.0)
        kinds = ["crate", "crate", "plank", "table", "beam", "column", "ball", "kerb", "ramp", "platform", "board", "slab"]
        kind = r.choice(kinds)
        at = self.place(2.2 if kind in ("ramp", "platform") else 1.5)
        if at is None:
            return
        x, y = at
        turned = (0.0, 0.0, yaw)
        cos, sin = math.cos(math.radians(yaw)), math.sin(math.radians(yaw))
        if kind in ("crate", "plank", "kerb"):
            size = {"crate": (r.uniform(0.2, 1.2), r.uniform(0.2, 1.2), r.uniform(0.1, 1.6)),
                    "plank": (r.uniform(0.6, 2.0), r.uniform(0.1, 0.4), r.uniform(0.015, 0.06)),
                    "kerb": (r.uniform(1.0, 3.0), 0.15, r.uniform(0.03, 0.15))}[kind]
            self.solid("box", (x, y, size[2] / 2), turned, size=size)
        elif kind == "table":
            length, width, top = r.uniform(0.6, 1.6), r.uniform(0.6, 1.0), r.uniform(0.25, 0.8)
            self.solid("box", (x, y, top), turned, size=(length, width, 0.04))
            for u, v in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
                dx, dy = u * (length / 2 - 0.04), v * (width / 2 - 0.04)
                leg = (x + dx * cos - dy * sin, y + dx * sin + dy * cos, top / 2)
                self.solid("box", leg, turned, size=(0.05, 0.05, top))
        elif kind == "beam":
            z = r.uniform(0.3, 0.9)
            self.solid("box", (x, y, z), turned, size=(r.uniform(1.0, 2.5), 0.1, 0.1))
            self.solid("box", (x, y, z / 2), size=(0.08, 0.08, z))
        elif kind == "column":
            self.solid("cylinder", (x, y, 0.6), radius=r.uniform(0.05, 0.5), height=1.2)
        elif kind == "ball":
            radius = r.uniform(0.15, 0.5)
            self.solid("sphere", (x, y, 0.8 * radius), radius=radius)
        elif kind in ("ramp", "platform"):
            high, wide = r.uniform(0.1, 0.35), r.uniform(0.9, 1.6)
            length = high / math.tan(math.radians(r.uniform(7.0, 16.0)))
            self.solid("wedge", (x, y, high / 2), turned, size=(length, wide, high))
            if kind == "platform":
                deep = r.uniform(1.0, 1.6)
                off = (length + deep) / 2
                self.solid("box", (x + off * cos, y + off * sin, high / 2), turned, size=(deep, wide, high))
        elif kind == "board":
            self.solid("box", (x, y, 0.6), (r.uniform(15.0, 45.0), 0.0, yaw), size=(r.uniform(0.6, 1.5), 0.05, 1.4))
        else:
            lean = (r.uniform(-10.0, 10.0), r.uniform(-10.0, 10.0), yaw)
            self.solid("box", (x, y, 0.08), lean, size=(r.uniform(0.6, 1.4), r.uniform(0.5, 1.0), 0.08))

    def board(self, number, yaw_deg):
        """A board under one wheel of a robot that begins so headed."""
        r = random.Random(-number)
        towards, high_m = math.radians(yaw_deg + r.choice([52, -52, 132, -132])), r.uniform(0.02, 0.05)
        x, y = (at + 0.33 * part for at, part in zip(self.start, (math.cos(towards), math.sin(towards))))
        self.solid("box", (x, y, high_m / 2), (0.0, 0.0, r.uniform(0.0, 90.0)), size=(0.35, 0.35, high_m))

    def world(self, number, trouble):
        self.floor()
        self.walls()
        for _ in range(self.r.randint(4, 14)):
            self.thing()
        x, y = self.half
        yaw_deg = self.r.uniform(0, 360)
        if trouble == "board":
            self.board(number, yaw_deg)
        start = f"position = [{self.start[0]:.3f}, {self.start[1]:.3f}, 0.2]\nyaw_deg = {yaw_deg:.1f}"
        head = f'name = "random {number}"\nbounds = [{-x}, {-y}, {x}, {y}]\n'
        return "\n".join([head, *self.lines, f'[[start]]\nname = "StartA"\n{start}\n'])


def scenario(number, world, draw):
    if number % 2:
        text = open(os.path.join(HERE, "../../scenarios/station_udk.toml")).read()
        text = text.replace("../maps/station.toml", world).replace("seed = 1", f"seed = {number}")
        return text.replace("1200.0", str(SECONDS))
    noise = ""
    if draw.random() < 0.5:
        sigma_m, slip = draw.choice([0.0, 0.005, 0.01, 0.02]), draw.uniform(0.0, 0.2)
        noise = f"\n[noise]\nrange_sigma_m = {sigma_m}\nwheel_slip = {slip:.2f}\n"
    return (f'map = "{world}"\ntime_limit_s = {SECONDS}\nseed = {number}\ndialect = "ut2004"\n{noise}\n'
            f'[[phase]]\nname = "autonomous"\nuntil_s = {SECONDS}\n\n'
            '[[robot]]\nname = "R1"\nclass = "USARBot.P3AT"\nstart = "StartA"\n')


SILENT_UNIT = '\n[[fault]]\nat_s = 0.0\nfor_s = 9000.0\nrobot = "R1"\nkind = "sensor_loss"\nwhat = "INS"\n'


def fly(usar, folder, number, trouble):
    draw = Draw(number)
    paths = [os.path.join(folder, kind, f"{number}.toml") for kind in ("worlds", "scenarios")]
    world = draw.world(number, trouble)
    fault = SILENT_UNIT if trouble == "no-ins" else ""
    for path, text in zip(paths, (world, scenario(number, f"../worlds/{number}.toml", draw.r) + fault)):
        os.makedirs(os.path.dirname(path), exist_ok=True)
        with open(path, "w") as file:
            file.write(text)
    run = os.path.join(folder, "runs", str(number))
    subprocess.run([usar, "mission", paths[1], "--out", run, "--force", "-q"], check=True, stdout=subprocess.DEVNULL)
    told = [usar, "eval", run, "--scenario", paths[1], "--format", "json"]
    score = json.loads(subprocess.run(told, check=True, capture_output=True).stdout)
    report = json.load(open(os.path.join(run, "report.json")))
    with open(os.path.join(run, "log.txt")) as log:
        return score, report, log.read().count("could not get free")


def main():
    trouble = sys.argv[5] if len(sys.argv) == 6 else None
    if len(sys.argv) not in (3, 5, 6) or trouble not in (None, "board", "no-ins"):
        sys.exit(__doc__)
    first, last = (int(word) for word in sys.argv[3:5]) if len(sys.argv) >= 5 else (1, 40)
    print("| World | Coverage | Way, m | End, m | End, ° | NEES (6) | Right, wrong | Falls, collisions | Wedged |")
    print("|---|---|---|---|---|---|---|---|---|")
    right = wrong = 0
    for number in range(first, last + 1):
        score, report, wedged = fly(sys.argv[1], sys.argv[2], number, trouble)
        ate, pairs = score["ate"], score["associations"] or {"right": 0, "wrong": 0}
        nees = f"{score['nees']['mean']:.1f}" if score["nees"] else "-"
        right, wrong = right + pairs["right"], wrong + pairs["wrong"]
        print(
            f"| {number} | {score['coverage'] or 0:.2f} | {score['true_path_m']:.0f} | {ate['final_m']:.3f} "
            f"| {ate['final_deg']:.2f} | {nees} | {pairs['right']}, {pairs['wrong']} "
            f"| {report['falls']}, {report['collisions']} | {wedged} |",
            flush=True,
        )
    print(f"\n{wrong} of {right + wrong} pairs wrong")


if __name__ == "__main__":
    main()
