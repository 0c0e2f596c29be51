//! A robot that moves as it is told, in a world of solids, exploring until nothing is left.

use super::world::{Laser, SENSOR_HEIGHT, World, pose, robot_from_scan, scan_from_sensor};
use nalgebra::Isometry3;
use usar_agent::exploration::{Decision, ExploreConfig, Explorer};
use usar_agent::navigation::{
    Blocked, CostMap, FollowConfig, FollowStatus, Follower, Guard, GuardConfig, PlanConfig,
    PlanError, Planner, Pose2, Trail,
};
use usar_agent::terrain::{CellClass, Grid, RobotShape, Terrain, TerrainConfig};
use usar_agent::time::Arrival;

/// How far ahead of the sensor the parked line meets level ground.
const GUARD_AHEAD: f64 = 1.15;

pub struct Robot {
    pub world: World,
    pub laser: Laser,
    pub shape: RobotShape,
    pub terrain: Terrain,
    pub explorer: Explorer,
    pub planner: Planner,
    pub follower: Follower,
    pub trail: Trail,
    pub guard: Guard,
    pub pose: Pose2,
    pub began: Pose2,
    pub grid: Grid,
    pub pans: Vec<f64>,
    pub tilts: Vec<f64>,
    pub seconds: f64,
    last_stop: Option<nalgebra::Point2<f64>>,
    pub sweeps: usize,
    pub driven: f64,
    pub events: Vec<String>,
    /// Least distance of the hull's support from falling, watched by the test.
    pub violations: Vec<String>,
    /// How often the hull was over a drop, and how often in something.
    pub falls: usize,
    pub touches: usize,
}

impl Robot {
    pub fn new(world: World, start: Pose2, pans: Vec<f64>, tilts: Vec<f64>, laser: Laser) -> Self {
        let shape = RobotShape::default();
        let config = TerrainConfig::default();
        let explore = ExploreConfig {
            field_of_view_rad: std::f64::consts::TAU.min(std::f64::consts::PI * pans.len() as f64),
            blind_m: SENSOR_HEIGHT / tilts[0].tan(),
            ..ExploreConfig::default()
        };
        Self {
            follower: Follower::new(FollowConfig::default(), &shape, config.edge_margin_m),
            guard: Guard::new(GuardConfig::default(), &shape),
            terrain: Terrain::new(config, shape.clone()),
            explorer: Explorer::new(explore),
            planner: Planner::default(),
            trail: Trail::default(),
            grid: Grid::default(),
            world,
            laser,
            shape,
            pose: start,
            began: start,
            pans,
            tilts,
            seconds: 0.0,
            last_stop: None,
            sweeps: 0,
            driven: 0.0,
            events: Vec::new(),
            violations: Vec::new(),
            falls: 0,
            touches: 0,
        }
    }

    fn now(&self) -> Arrival {
        Arrival::from_seconds(self.seconds)
    }

    /// The body's pose on the world's ground: height and slope under the wheels.
    pub fn body(&self) -> Isometry3<f64> {
        let at = |ahead: f64, aside: f64| {
            let (sin, cos) = self.pose.yaw_rad.sin_cos();
            let (x, y) = (
                self.pose.x_m + cos * ahead - sin * aside,
                self.pose.y_m + sin * ahead + cos * aside,
            );
            self.world.floor_below(x, y, 0.9).unwrap_or(-9.0)
        };
        let (front, back) = (at(0.2, 0.0), at(-0.2, 0.0));
        let (left, right) = (at(0.0, 0.2), at(0.0, -0.2));
        let pitch = -((front - back) / 0.4).atan();
        let roll = ((left - right) / 0.4).atan();
        let height = 0.25 * (front + back + left + right);
        super::world::tilted_pose(
            self.pose.x_m,
            self.pose.y_m,
            height,
            self.pose.yaw_rad,
            pitch,
            roll,
        )
    }

    pub fn sweep(&mut self) {
        let body = self.body();
        let image = self.laser.sweep(&self.world, &body, &self.pans, &self.tilts);
        self.terrain.integrate(&image, &body);
        self.grid = self.terrain.project(&body);
        self.sweeps += 1;
        self.seconds += 0.5 * (self.pans.len() * self.tilts.len()) as f64;
        let field = self.explorer.config().field_of_view_rad;
        self.explorer.swept(&self.grid, &self.pose, field, 0.8);
    }

    pub fn start(&mut self, assumed: f64) {
        let body = self.body();
        self.terrain.assume(&body, assumed);
        self.sweep();
    }

    /// Seconds that the next goal is thought to take with so much time left; `None` for no goal.
    pub fn next_goal_s(&mut self, time_left_s: Option<f64>) -> Option<f64> {
        let now = self.now();
        let costs = CostMap::new(&self.grid, &self.shape, &PlanConfig::default());
        self.explorer.limit_time(time_left_s);
        let (grid, shape, planner) = (&self.grid, &self.shape, &mut self.planner);
        match self.explorer.choose(grid, &costs, shape, planner, &self.pose, now) {
            Decision::Go(choice) => Some(choice.seconds),
            Decision::NothingLeft { .. } => None,
        }
    }

    /// Chooses, drives there, sweeps. False when nothing is left.
    pub fn explore_once(&mut self) -> bool {
        let now = self.now();
        let costs = CostMap::new(&self.grid, &self.shape, &PlanConfig::default());
        let decision = self.explorer.choose(
            &self.grid,
            &costs,
            &self.shape,
            &mut self.planner,
            &self.pose,
            now,
        );
        let choice = match decision {
            Decision::Go(choice) => choice,
            Decision::NothingLeft { frontiers_left, retry_at } => {
                match retry_at {
                    Some(at) if at.seconds() < self.seconds + 120.0 => {
                        self.seconds = at.seconds();
                        return true;
                    }
                    _ => {}
                }
                for left in frontiers_left {
                    self.events
                        .push(format!("left ({:.1}, {:.1}): {}", left.x, left.y, left.reason));
                }
                return false;
            }
        };
        self.events.push(format!(
            "go ({:.2}, {:.2}, {:.2}) from ({:.2}, {:.2}, {:.2}) gain {:.2} {}s",
            choice.goal.x_m,
            choice.goal.y_m,
            choice.goal.yaw_rad,
            self.pose.x_m,
            self.pose.y_m,
            self.pose.yaw_rad,
            choice.gain_m2,
            choice.seconds as i32
        ));
        let path = self.planner.plan(&self.grid, &costs, &self.pose, choice.cell);
        match path {
            Ok(path) => self.drive(path.with_goal_yaw(choice.goal.yaw_rad)),
            Err(error) => {
                self.events.push(format!("plan: {error}"));
                self.explorer.give_up(&error.to_string(), now);
                if matches!(error, PlanError::StartBlocked { .. }) {
                    self.back_out();
                }
                return true;
            }
        }
        self.sweep();
        true
    }

    fn drive(&mut self, path: usar_agent::navigation::Path) {
        self.follower.set_path(path);
        for _ in 0..2000 {
            let (mut command, status) = self.follower.step(&self.pose, &self.grid);
            match status {
                FollowStatus::Reached => {
                    self.explorer.reached();
                    return;
                }
                FollowStatus::Blocked(reason) => {
                    let look = match reason {
                        Blocked::Ahead(conflict) | Blocked::Turning(conflict) => {
                            conflict.needs_look()
                        }
                        Blocked::OffPath(_) | Blocked::NoPath => true,
                    };
                    self.stopped(&reason.to_string(), look);
                    return;
                }
                FollowStatus::Following { .. } => {}
            }
            // The tilt is parked while the robot drives, and its line is read all along.
            let verdict = self.guard_line();
            if command.linear_mps > 0.0 && !verdict.is_clear() {
                self.stopped(&format!("guard line: {verdict:?}"), true);
                return;
            }
            command = command.limited(0.7, 1.0);
            let dt = 0.2;
            for _ in 0..4 {
                self.pose = self
                    .pose
                    .driven(0.25 * dt * command.linear_mps, 0.25 * dt * command.angular_rps);
                self.check();
            }
            self.driven += dt * command.linear_mps.abs();
            self.seconds += dt;
            self.trail.note(&self.pose);
            let body = self.body();
            self.terrain.drive_over(&body);
        }
        self.events.push("drive took too long".into());
        let now = self.now();
        self.explorer.give_up("too slow", now);
    }

    /// Something stopped the robot. Where a look may help, the goal is kept for one more try.
    fn stopped(&mut self, reason: &str, look: bool) {
        let at = self.pose.point();
        self.events.push(format!("stopped at ({:.2}, {:.2}): {reason}", at.x, at.y));
        let again = self.last_stop.is_some_and(|last| (last - at).norm() < 0.1);
        self.last_stop = Some(at);
        if again || !look {
            let now = self.now();
            self.explorer.give_up(reason, now);
            self.back_out();
        }
    }

    /// Half a metre back over the own track.
    fn back_out(&mut self) {
        let from = self.pose.point();
        for _ in 0..40 {
            if self.pose.distance_m(&from) > 0.5 {
                break;
            }
            let Some(command) = self.trail.back_out(&self.pose, 0.15, 0.5) else { break };
            self.pose = self.pose.driven(0.2 * command.linear_mps, 0.2 * command.angular_rps);
            self.check();
            self.trail.note(&self.pose);
            self.seconds += 0.2;
        }
    }

    fn guard_line(&mut self) -> usar_agent::navigation::GuardVerdict {
        let body = self.body();
        let tilt = (SENSOR_HEIGHT / GUARD_AHEAD).atan();
        let robot_from_sensor = robot_from_scan() * scan_from_sensor(0.0, tilt);
        let line = self.laser.line(&self.world, &(body * robot_from_sensor));
        self.terrain.integrate_guard_line(&line, &robot_from_sensor, &body);
        self.guard.confirm(&line, &robot_from_sensor, &body, &mut self.grid);
        self.guard.judge(&line, &robot_from_sensor, Some((&body, &self.grid)))
    }

    /// Every part of the hull must lie over ground near the body's own, and in nothing solid.
    fn check(&mut self) {
        let body = self.body();
        let floor = body.translation.z - super::world::BASE_HEIGHT;
        for ahead in [-0.26, -0.13, 0.0, 0.13, 0.26] {
            for aside in [-0.245, -0.12, 0.0, 0.12, 0.245] {
                let p = body * nalgebra::Point3::new(ahead, aside, 0.0);
                let slope = 0.4 * (p.x - body.translation.x).hypot(p.y - body.translation.y);
                // From the robot's top down, so that what hangs lower is struck.
                let from = floor + self.shape.height_m + slope;
                let under = self.world.floor_below(p.x, p.y, from).unwrap_or(-9.0);
                if under < floor - 0.1 - slope {
                    self.falls += 1;
                    self.violate(&format!(
                        "ground {:.2} m below at ({:.2}, {:.2})",
                        floor - under,
                        p.x,
                        p.y
                    ));
                } else if under > floor + 0.1 + slope
                    || self.world.is_inside(&nalgebra::Point3::new(p.x, p.y, floor + 0.3))
                {
                    self.touches += 1;
                    self.violate(&format!("hull touches something at ({:.2}, {:.2})", p.x, p.y));
                }
            }
        }
    }

    /// Share of the 0.1 m cells that the robot's centre can be driven to on the true world that the
    /// grid calls free or occupied, with a measured ground point within 0.3 m.
    pub fn coverage(&self) -> f64 {
        const SIDE: i32 = 300;
        let world = &self.world;
        let centre = |cell: i32| 0.1 * (f64::from(cell) - 50.0) + 0.05;
        let floor = |x: f64, y: f64, z: f64| world.floor_below(x, y, z + self.shape.height_m);
        // From the middle outwards no step of more than 0.06 m and no slope of more than 20°.
        let stands = |x: f64, y: f64, z: f64| {
            (0..16).all(|k| {
                let (sin, cos) = (f64::from(k) * std::f64::consts::FRAC_PI_8).sin_cos();
                let mut before = z;
                (1..=6).all(|step| {
                    let r = 0.05 * f64::from(step);
                    floor(x + r * cos, y + r * sin, z).is_some_and(|under| {
                        let rise = (under - before).abs();
                        before = under;
                        rise <= 0.06 && (under - z).abs() <= 0.06 + 0.36 * r
                    })
                })
            })
        };
        let mut heights = vec![f64::NAN; (SIDE * SIDE) as usize];
        let cell_of = |v: f64| ((v / 0.1).floor() as i32) + 50;
        let start = cell_of(self.began.y_m) * SIDE + cell_of(self.began.x_m);
        heights[start as usize] = 0.0;
        let mut open = vec![start];
        let (mut reachable, mut explored) = (0, 0);
        let covered: std::collections::BTreeSet<(i32, i32)> = self
            .terrain
            .measured_ground()
            .map(|(cell, _)| (cell.x.div_euclid(2), cell.y.div_euclid(2)))
            .collect();
        let coarse = self.grid.coarse(2);
        while let Some(at) = open.pop() {
            let (i, j) = (at % SIDE, at / SIDE);
            let (x, y, z) = (centre(i), centre(j), heights[at as usize]);
            reachable += 1;
            let class = coarse.class_at(x, y);
            let known = class.is_drivable()
                || matches!(class, CellClass::Occupied | CellClass::DropOff | CellClass::TooSteep);
            let cell = coarse.cell_of(x, y);
            let near =
                (-3..=3).any(|dy| (-3..=3).any(|dx| covered.contains(&(cell.x + dx, cell.y + dy))));
            explored += i32::from(known && near);
            for (di, dj) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                let (i, j) = (i + di, j + dj);
                if !(0..SIDE).contains(&i) || !(0..SIDE).contains(&j) {
                    continue;
                }
                let beside = (j * SIDE + i) as usize;
                if !heights[beside].is_nan() {
                    continue;
                }
                if let Some(under) = floor(centre(i), centre(j), z)
                    && (under - z).abs() <= 0.06
                    && stands(centre(i), centre(j), under)
                {
                    heights[beside] = under;
                    open.push(beside as i32);
                }
            }
        }
        f64::from(explored) / f64::from(reachable)
    }

    fn violate(&mut self, what: &str) {
        if self.violations.is_empty() {
            let window = super::edges::draw_around(&self.grid, self.pose.x_m, self.pose.y_m, 1.2);
            self.violations.push(window);
        }
        if self.violations.len() < 4 {
            self.violations.push(format!("{what} with the robot at {:?}", self.pose));
        }
    }
}

pub fn start_pose(x: f64, y: f64, yaw: f64) -> Pose2 {
    Pose2::from_isometry(&pose(x, y, 0.0, yaw))
}
