//! What the agent believes: where it is, what the world looks like, what can be driven on.
//!
//! Between two sweeps the pose is dead reckoning from the last one, and lines taken on the way enter
//! a *live* terrain under that pose. A sweep corrects the pose; the way since the one before is then
//! bent to fit, its lines enter the *settled* terrain where they really were taken, and the live
//! terrain begins anew as a copy of it. So an error of odometry lasts one leg and no longer.

use super::lines::PendingLine;
use super::motion::{BodyAttitude, MotionTracker, PlanarPose};
use crate::geometry::lie::{se3_exp, se3_log};
use crate::mapping::{
    Mapper, MapperConfig, ScanErrors, ScanObservations, UpdateReport, observations,
};
use crate::scan::{RangeImage, Return};
use crate::segmentation::{SegmentationConfig, Segmenter, Shape};
use crate::terrain::{Grid, RobotShape, Terrain, TerrainConfig};
use crate::time::Stamp;
use nalgebra::{Isometry3, Matrix6, Point3, Vector6};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::ops::Range;

/// Dead-reckoned poses kept for looking up where a line was taken.
const HISTORY: usize = 64;

/// A loop closure that moves no keyframe farther than this does not rebuild the terrain.
const REBUILD_FROM_M: f64 = 0.03;

/// Settings of what the belief is made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BeliefConfig {
    /// Localisation and mapping.
    pub mapper: MapperConfig,
    /// Segmentation.
    pub segmentation: SegmentationConfig,
    /// Terrain.
    pub terrain: TerrainConfig,
    /// First beam that is segmented: the paper leaves the outer ones out, where points crowd.
    pub first_beam: usize,
    /// One more than the last beam that is segmented.
    pub end_beam: usize,
    /// Standard deviation of roll and pitch as the inertial unit gives them, in radians.
    pub attitude_sigma_rad: f64,
    /// Turn rate above which a line taken under way is not mapped, in rad/s: its heading is off by
    /// the rate times the uncertainty of its time.
    pub mapped_turn_rps: f64,
}

impl Default for BeliefConfig {
    fn default() -> Self {
        Self {
            mapper: MapperConfig::default(),
            segmentation: SegmentationConfig::default(),
            terrain: TerrainConfig::default(),
            first_beam: 25,
            end_beam: 156,
            attitude_sigma_rad: 0.01,
            mapped_turn_rps: 0.08,
        }
    }
}

/// A pose of the trajectory, tied to the keyframe before it so that corrections carry it along.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct TrackPoint {
    stamp: Stamp,
    keyframe: usize,
    keyframe_from_robot: Isometry3<f64>,
}

/// Ground ahead of a robot that its laser could not see and that was assumed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct AssumedSector {
    world_from_robot: Isometry3<f64>,
    radius_m: f64,
    half_angle_rad: f64,
}

impl AssumedSector {
    fn enter(&self, terrain: &mut Terrain) {
        terrain.assume_ahead(&self.world_from_robot, self.radius_m, self.half_angle_rad);
    }
}

/// A range image in the terrain and where it was taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Archived {
    keyframe: usize,
    keyframe_from_robot: Isometry3<f64>,
    image: RangeImage,
}

/// What a sweep told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScanFindings {
    /// Planes found.
    pub planes: usize,
    /// Spheres found.
    pub spheres: usize,
    /// Cylinders found.
    pub cylinders: usize,
    /// What the mapper did with the planes.
    pub update: UpdateReport,
}

/// Pose, map and terrain.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Belief {
    pub(super) config: BeliefConfig,
    pub(super) mapper: Mapper,
    #[serde(skip)]
    segmenter: Option<Segmenter>,
    pub(super) settled: Terrain,
    pub(super) live: Terrain,
    motion: MotionTracker,
    /// Poses since the last keyframe, newest last.
    pub(super) history: VecDeque<(Stamp, Isometry3<f64>)>,
    pub(super) keyframe_from_robot: Isometry3<f64>,
    pub(super) leg: Leg,
    pub(super) pending: VecDeque<PendingLine>,
    track: Vec<TrackPoint>,
    archive: Vec<Archived>,
    start: Isometry3<f64>,
    assumed_radius_m: f64,
    assumed_ahead: Vec<AssumedSector>,
    path_m: f64,
}

/// What was gathered since the last keyframe; places are relative to it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Leg {
    pub(super) poses: Vec<(Stamp, Isometry3<f64>, f64)>,
    pub(super) lines: Vec<(Isometry3<f64>, f64, RangeImage)>,
    pub(super) path_m: f64,
}

impl Belief {
    /// A belief that begins at `start`, with ground assumed within `assumed_radius_m` of it.
    pub fn new(
        config: BeliefConfig,
        shape: RobotShape,
        start: Isometry3<f64>,
        assumed_radius_m: f64,
    ) -> Self {
        let mut terrain = Terrain::new(config.terrain.clone(), shape);
        terrain.assume(&start, assumed_radius_m);
        Self {
            mapper: Mapper::new(config.mapper.clone(), start),
            segmenter: None,
            settled: terrain.clone(),
            live: terrain,
            motion: MotionTracker::default(),
            history: VecDeque::new(),
            keyframe_from_robot: Isometry3::identity(),
            leg: Leg::default(),
            pending: VecDeque::new(),
            track: Vec::new(),
            archive: Vec::new(),
            start,
            assumed_radius_m,
            assumed_ahead: Vec::new(),
            path_m: 0.0,
            config,
        }
    }

    /// The settings.
    pub fn config(&self) -> &BeliefConfig {
        &self.config
    }

    /// Where the robot is believed to be now.
    pub fn world_from_robot(&self) -> Isometry3<f64> {
        self.keyframe_pose() * self.keyframe_from_robot
    }

    pub(super) fn keyframe_pose(&self) -> Isometry3<f64> {
        self.mapper.world_from_robot() * self.keyframe_from_robot.inverse()
    }

    /// The mapper.
    pub fn mapper(&self) -> &Mapper {
        &self.mapper
    }

    /// The newest sweep and the number of its keyframe.
    pub fn last_sweep(&self) -> Option<(usize, &RangeImage)> {
        self.archive.last().map(|item| (item.keyframe, &item.image))
    }

    /// The terrain as known now, the current leg included.
    pub fn terrain(&self) -> &Terrain {
        &self.live
    }

    /// The terrain as a grid of the level the robot is on.
    pub fn grid(&self) -> Grid {
        self.live.project(&self.world_from_robot())
    }

    /// Takes the sector of `radius_m` and `half_angle_rad` ahead of the robot for ground.
    pub fn assume_ahead(&mut self, radius_m: f64, half_angle_rad: f64) {
        let world_from_robot = self.world_from_robot();
        let sector = AssumedSector { world_from_robot, radius_m, half_angle_rad };
        sector.enter(&mut self.live);
        sector.enter(&mut self.settled);
        self.assumed_ahead.push(sector);
    }

    /// Begins anew at the same place for a robot of another shape. Motion so far is kept.
    pub fn restart(&mut self, shape: RobotShape) {
        let mut terrain = Terrain::new(self.config.terrain.clone(), shape);
        terrain.assume(&self.start, self.assumed_radius_m);
        self.settled = terrain.clone();
        self.live = terrain;
    }

    /// Length of the way since the last sweep, in metres.
    pub fn leg_m(&self) -> f64 {
        self.leg.path_m
    }

    /// Length of the path believed driven, in metres.
    pub fn path_m(&self) -> f64 {
        self.path_m
    }

    /// The last attitude reading.
    pub fn attitude(&self) -> Option<BodyAttitude> {
        self.motion.last_attitude()
    }

    /// Takes in an attitude reading.
    pub fn take_attitude(&mut self, attitude: BodyAttitude) {
        self.motion.attitude(attitude);
    }

    /// Takes in a wheel odometry reading of the time `stamp`.
    pub fn take_wheels(&mut self, wheels: PlanarPose, stamp: Stamp) {
        let Some((increment, source)) = self.motion.wheels(wheels) else { return };
        self.mapper.predict(&increment, source);
        self.keyframe_from_robot *= increment;
        self.keyframe_from_robot.rotation.renormalize();
        let step_m = increment.translation.vector.norm();
        self.path_m += step_m;
        self.leg.path_m += step_m;
        if self.history.len() == HISTORY {
            self.history.pop_front();
        }
        self.history.push_back((stamp, self.keyframe_from_robot));
        let moved = step_m > 0.0 || increment.rotation.angle() > 0.0;
        if moved || self.leg.poses.is_empty() {
            self.leg.poses.push((stamp, self.keyframe_from_robot, self.leg.path_m));
            let pose = self.world_from_robot();
            self.live.drive_over(&pose);
        }
        self.map_pending();
    }

    /// Forgets the wheels' origin: a new robot's odometry starts at zero.
    pub fn restart_wheels(&mut self) {
        self.motion.restart_wheels();
        self.history.clear();
        self.pending.clear();
    }

    /// Takes in that the robot is at `world_from_robot` now though nothing measured how it came there:
    /// a server put it there. `sigma_m` and `sigma_rad` say how well that place fits this map.
    pub fn put_at(&mut self, world_from_robot: &Isometry3<f64>, sigma_m: f64, sigma_rad: f64) {
        self.restart_wheels();
        let increment = self.world_from_robot().inverse() * world_from_robot;
        let spread = Vector6::new(sigma_m, sigma_m, sigma_m, sigma_rad, sigma_rad, sigma_rad);
        let covariance = Matrix6::from_diagonal(&spread.component_mul(&spread));
        self.mapper.predict_with(&increment, &covariance);
        self.keyframe_from_robot *= increment;
        self.keyframe_from_robot.rotation.renormalize();
    }

    /// Where the robot began.
    pub fn start(&self) -> &Isometry3<f64> {
        &self.start
    }

    /// Takes in a finished sweep: segments it, corrects the pose by its planes, settles the leg that
    /// led here, and maps the sweep.
    pub fn take_scan(&mut self, image: RangeImage, errors: ScanErrors) -> ScanFindings {
        let columns = self.segmented_columns(image.columns());
        let grid = image.point_grid(columns);
        let segmenter =
            self.segmenter.get_or_insert_with(|| Segmenter::new(self.config.segmentation.clone()));
        let segmentation = segmenter.segment(&grid);
        let count = |is: fn(&Shape) -> bool| {
            segmentation.surfaces.iter().filter(|surface| is(&surface.shape)).count()
        };
        let planes = count(|shape| matches!(shape, Shape::Plane(_)));
        let spheres = count(|shape| matches!(shape, Shape::Sphere(_)));
        let cylinders = count(|shape| matches!(shape, Shape::Cylinder(_)));
        let scan = ScanObservations {
            observations: observations(segmentation, &grid, &image.robot_from_scan),
            robot_from_scan: image.robot_from_scan,
            errors,
            contacts: self.live.shape().contacts(),
        };
        if let Some(attitude) = self.motion.last_attitude() {
            let sigma = self.config.attitude_sigma_rad;
            self.mapper.attitude(attitude.roll_rad, attitude.pitch_rad, sigma);
        }
        let update = self.mapper.observe(&scan);
        self.pending.clear();
        self.settle(&update, image);
        ScanFindings { planes, spheres, cylinders, update }
    }

    /// The beams that are segmented: the configured ones of the paper's 181, the same angles of others.
    fn segmented_columns(&self, columns: usize) -> Range<usize> {
        const PAPER_BEAMS: usize = 181;
        if columns == PAPER_BEAMS {
            return self.config.first_beam..self.config.end_beam;
        }
        let scaled = |beam: usize| beam * columns / PAPER_BEAMS;
        scaled(self.config.first_beam)..scaled(self.config.end_beam)
    }

    fn settle(&mut self, update: &UpdateReport, image: RangeImage) {
        let keyframes = self.mapper.keyframes();
        let leg = std::mem::take(&mut self.leg);
        let previous = update.keyframe.checked_sub(1);
        let before = previous.map_or(self.start, |k| keyframes[k]);
        // What the correction adds at the end of the leg, spread over its length.
        let correction =
            se3_log(&((before * self.keyframe_from_robot).inverse() * update.world_from_robot));
        let bent = |keyframe_from_robot: &Isometry3<f64>, way_m: f64| {
            let share = if leg.path_m > 0.0 { way_m / leg.path_m } else { 1.0 };
            keyframe_from_robot * se3_exp(&(correction * share))
        };
        // Before the first keyframe everything hangs on it from behind.
        let first_from_start =
            previous.is_none().then(|| update.world_from_robot.inverse() * self.start);
        let anchor = previous.unwrap_or(update.keyframe);
        let tie = |pose: Isometry3<f64>| first_from_start.map_or(pose, |first| first * pose);
        for (stamp, pose, way_m) in &leg.poses {
            let keyframe_from_robot = tie(bent(pose, *way_m));
            self.track.push(TrackPoint { stamp: *stamp, keyframe: anchor, keyframe_from_robot });
        }
        let mut fresh: Vec<Archived> = leg
            .lines
            .iter()
            .map(|(pose, way_m, image)| Archived {
                keyframe: anchor,
                keyframe_from_robot: tie(bent(pose, *way_m)),
                image: image.clone(),
            })
            .collect();
        fresh.push(Archived {
            keyframe: update.keyframe,
            keyframe_from_robot: Isometry3::identity(),
            image,
        });
        let farthest_m = update
            .moved
            .iter()
            .map(|moved| {
                let (a, b) = (moved.before.translation, moved.world_from_robot.translation);
                (a.vector - b.vector).norm()
            })
            .fold(0.0, f64::max);
        if farthest_m > REBUILD_FROM_M {
            self.archive.append(&mut fresh);
            self.rebuild(&keyframes);
        } else {
            for item in &fresh {
                let pose = keyframes[item.keyframe] * item.keyframe_from_robot;
                self.settled.integrate(&item.image, &pose);
            }
            for (_, pose, way_m) in &leg.poses {
                let pose = keyframes[anchor] * tie(bent(pose, *way_m));
                self.settled.drive_over(&pose);
            }
            self.archive.append(&mut fresh);
        }
        self.live = self.settled.clone();
        self.keyframe_from_robot = Isometry3::identity();
        // Lines that are still to come may be older than this moment: keep where the robot is now.
        if let Some((stamp, _)) = self.history.back().copied() {
            self.history.clear();
            self.history.push_back((stamp, Isometry3::identity()));
        }
    }

    /// The settled terrain from all images at their corrected poses.
    fn rebuild(&mut self, keyframes: &[Isometry3<f64>]) {
        let poses: Vec<Isometry3<f64>> = self
            .archive
            .iter()
            .map(|item| keyframes[item.keyframe] * item.keyframe_from_robot)
            .collect();
        self.settled.rebuild(self.archive.iter().map(|item| &item.image).zip(&poses));
        self.settled.assume(&self.start, self.assumed_radius_m);
        for sector in &self.assumed_ahead {
            sector.enter(&mut self.settled);
        }
        for point in &self.track {
            self.settled.drive_over(&(keyframes[point.keyframe] * point.keyframe_from_robot));
        }
    }

    /// Every point of every sweep and line in the map, where it is believed now. Points beyond what the
    /// terrain reads are among them.
    pub fn points(&self) -> impl Iterator<Item = Point3<f64>> + '_ {
        let keyframes = self.mapper.keyframes();
        self.archive.iter().flat_map(move |item| {
            let world_from_robot = keyframes[item.keyframe] * item.keyframe_from_robot;
            let world_from_scan = world_from_robot * item.image.robot_from_scan;
            let (rows, columns) = (item.image.rows().len(), item.image.columns());
            (0..rows * columns).filter_map(move |at| {
                let (row, column) = (at / columns, at % columns);
                match item.image.at(row, column) {
                    Return::Hit(range_m) => {
                        Some(world_from_scan * item.image.point_at(row, column, range_m))
                    }
                    _ => None,
                }
            })
        })
    }

    /// The trajectory as it is believed now, later corrections included.
    pub fn trajectory(&self) -> Vec<(Stamp, Isometry3<f64>)> {
        let keyframes = self.mapper.keyframes();
        let base = self.keyframe_pose();
        let settled = self
            .track
            .iter()
            .map(|point| (point.stamp, keyframes[point.keyframe] * point.keyframe_from_robot));
        settled.chain(self.leg.poses.iter().map(|(at, pose, _)| (*at, base * pose))).collect()
    }

    /// How far the floor lies below the robot's origin, from what a sweep saw of it nearby; `None`
    /// where too little was seen.
    ///
    /// The commonest depth in steps of a centimetre among the points within 3 m, and the median
    /// about it: walls and boxes spread over all heights, the floor does not.
    pub fn floor_below_m(image: &RangeImage) -> Option<f64> {
        const REACH_M: f64 = 3.0;
        const DEEPEST_M: f64 = 0.8;
        const STEP_M: f64 = 0.01;
        const ENOUGH: usize = 50;
        let mut depths: Vec<f64> = Vec::new();
        for row in 0..image.rows().len() {
            for column in 0..image.columns() {
                let Return::Hit(range) = image.at(row, column) else { continue };
                let p = image.robot_from_scan * image.point_at(row, column, range);
                if p.x.hypot(p.y) < REACH_M && (0.0..DEEPEST_M).contains(&-p.z) {
                    depths.push(-p.z);
                }
            }
        }
        let mut counts = vec![0_usize; (DEEPEST_M / STEP_M) as usize + 1];
        for depth in &depths {
            counts[(depth / STEP_M) as usize] += 1;
        }
        let (commonest, count) = counts
            .iter()
            .enumerate()
            .max_by_key(|(index, count)| (**count, std::cmp::Reverse(*index)))?;
        if *count < ENOUGH {
            return None;
        }
        let middle_m = (commonest as f64 + 0.5) * STEP_M;
        depths.retain(|depth| (depth - middle_m).abs() <= 2.0 * STEP_M);
        depths.sort_by(f64::total_cmp);
        Some(depths[depths.len() / 2])
    }
}
