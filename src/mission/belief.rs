//! What the agent believes: where it is, what the world looks like, what can be driven on.
//!
//! Between two sweeps the pose is dead reckoning from the last one, and lines taken on the way enter
//! a *live* terrain under that pose. A sweep corrects the pose; the way since the one before is then
//! bent to fit, its lines enter the *settled* terrain where they really were taken, and the live
//! terrain begins anew as a copy of it. So an error of odometry lasts one leg and no longer. A later
//! sweep may move an earlier one: once that is more than the terrain can bear, all of it is drawn anew.

use super::alignment::LineAligner;
use super::leg::{BentLeg, Leg};
use super::lines::PendingLine;
use super::motion::{BodyAttitude, MotionTracker, PlanarPose};
use super::wall_alignment::WallAligner;
use crate::mapping::{
    Mapper, MapperConfig, Mode, Observation, ScanErrors, ScanObservations, UpdateReport,
    curved_observations, is_fixed, observations, upright,
};
use crate::robot::InsReading;
use crate::scan::{RangeImage, Return};
use crate::segmentation::{SegmentationConfig, Segmenter, Shape};
use crate::terrain::{Grid, RobotShape, Terrain, TerrainConfig};
use crate::time::Stamp;
use nalgebra::{Isometry3, Matrix6, Point3, Unit, UnitQuaternion, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::ops::Range;

/// What a robot that stands tilted tells of its laser's place, in metres per radian: servers print differences of
/// places in the world as if it stood level (protocol reference, sections 3.9 and 5.4).
const MOUNT_PER_RAD_M: f64 = 0.1;

/// Part of the heading in a direction that a sweep leaves open from which on it tells no heading.
const WEAK_HEADING: f64 = 0.3;

/// Dead-reckoned poses kept for looking up where a line was taken.
const HISTORY: usize = 64;

/// By how much a sweep may be believed elsewhere than where its points lie in the terrain.
#[derive(Clone, Copy)]
struct Tolerance {
    /// Sideways, in metres.
    aside_m: f64,
    /// In height, in metres.
    height_m: f64,
    /// About the vertical, in radians.
    turn_rad: f64,
    /// About any level axis, in radians.
    tilt_rad: f64,
}

/// What a terrain bears: beyond it two faces of a wall lie in different cells, and two sweeps of one
/// floor show a step.
const BORNE: Tolerance =
    Tolerance { aside_m: 0.03, height_m: 0.015, turn_rad: 0.006, tilt_rad: 0.004 };

/// What need not be mended even where the terrain has turned out wrong.
const NOTHING: Tolerance =
    Tolerance { aside_m: 0.002, height_m: 0.002, turn_rad: 5e-4, tilt_rad: 5e-4 };

impl Tolerance {
    fn bears(&self, before: &Isometry3<f64>, now: &Isometry3<f64>) -> bool {
        let way = now.translation.vector - before.translation.vector;
        let turn = (now.rotation * before.rotation.inverse()).scaled_axis();
        way.xy().norm() <= self.aside_m
            && way.z.abs() <= self.height_m
            && turn.z.abs() <= self.turn_rad
            && turn.xy().norm() <= self.tilt_rad
    }
}

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
    /// Whether the way between sweeps is taken from the places of an inertial unit, where it tells any,
    /// instead of from the wheels alone.
    pub inertial_places: bool,
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
            inertial_places: true,
            mapped_turn_rps: 0.08,
        }
    }
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

/// A sweep and the way that led to it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Settled {
    leg: Leg,
    sweep: RangeImage,
    /// Where the robot was when the sweep entered the terrain.
    entered: Isometry3<f64>,
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
    /// Whether earlier sweeps had moved so far that the terrain was drawn anew.
    pub redrawn: bool,
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
    pub(super) motion: MotionTracker,
    /// Poses since the last keyframe, newest last.
    pub(super) history: VecDeque<(Stamp, Isometry3<f64>)>,
    /// The way since the last keyframe.
    pub(super) leg: Leg,
    pub(super) pending: VecDeque<PendingLine>,
    pub(super) pending_flat: VecDeque<PendingLine>,
    pub(super) flat_lines: usize,
    pub(super) aligner: LineAligner,
    pub(super) walls: WallAligner,
    /// One for each keyframe.
    settled_legs: Vec<Settled>,
    start: Isometry3<f64>,
    /// The start hangs on the first keyframe from behind.
    first_from_start: Isometry3<f64>,
    assumed_radius_m: f64,
    assumed_ahead: Vec<AssumedSector>,
    path_m: f64,
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
            leg: Leg::default(),
            pending: VecDeque::new(),
            pending_flat: VecDeque::new(),
            flat_lines: 0,
            aligner: LineAligner::default(),
            walls: WallAligner::default(),
            settled_legs: Vec::new(),
            start,
            first_from_start: Isometry3::identity(),
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
        self.keyframe_pose() * self.leg.begin_from_robot()
    }

    pub(super) fn keyframe_pose(&self) -> Isometry3<f64> {
        self.mapper.world_from_robot() * self.leg.begin_from_robot().inverse()
    }

    /// When the last row of each keyframe's sweep was taken; `None` for a sweep without stamps.
    pub fn keyframe_stamps(&self) -> impl Iterator<Item = Option<Stamp>> {
        self.settled_legs.iter().map(|settled| settled.sweep.rows().last()?.stamp)
    }

    /// The mapper.
    pub fn mapper(&self) -> &Mapper {
        &self.mapper
    }

    /// The newest sweep and the number of its keyframe.
    pub fn last_sweep(&self) -> Option<(usize, &RangeImage)> {
        self.settled_legs.last().map(|last| (self.settled_legs.len() - 1, &last.sweep))
    }

    /// The terrain as known now, the current leg included.
    pub fn terrain(&self) -> &Terrain {
        &self.live
    }

    /// The terrain as a grid of the level the robot is on.
    pub fn grid(&self) -> Grid {
        self.live.project(&self.world_from_robot())
    }

    /// Takes the sector of `radius_m` and `half_angle_rad` about the bearing `towards_rad` for ground.
    pub fn assume_towards(&mut self, towards_rad: f64, radius_m: f64, half_angle_rad: f64) {
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), towards_rad);
        let world_from_robot = self.world_from_robot() * turned;
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
        self.leg.path_m()
    }

    /// Length of the path believed driven, in metres.
    pub fn path_m(&self) -> f64 {
        self.path_m
    }

    /// The last attitude reading.
    pub fn attitude(&self) -> Option<BodyAttitude> {
        self.motion.last_attitude()
    }

    /// Whether turns between sweeps are measured by more than wheels that nobody has seen to turn the robot.
    pub fn knows_turns(&self) -> bool {
        self.motion.knows_turns()
    }

    /// Where the robot is from where its readings began, by more than its wheels.
    pub fn reckoned(&self) -> Option<&Isometry3<f64>> {
        self.motion.reckoned()
    }

    /// Takes in a reading of an inertial unit.
    pub fn take_inertial(&mut self, reading: &InsReading) {
        self.motion.attitude(reading.into());
        if let Some(place) = reading.place.filter(|_| self.config.inertial_places) {
            self.motion.place(place);
        }
    }

    /// Takes in a wheel odometry reading of the time `stamp`.
    pub fn take_wheels(&mut self, wheels: PlanarPose, stamp: Stamp) {
        let Some((increment, source)) = self.motion.wheels(wheels) else { return };
        self.mapper.predict(&increment, source);
        self.aligner.moved(&increment, source);
        self.walls.moved(&increment, source);
        self.path_m += increment.translation.vector.norm();
        let is_new_place = self.leg.drive(stamp, &increment);
        if self.history.len() == HISTORY {
            self.history.pop_front();
        }
        self.history.push_back((stamp, self.leg.begin_from_robot()));
        if is_new_place {
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
        self.pending_flat.clear();
        self.aligner.restart();
        self.walls = WallAligner::default();
    }

    /// Takes in that the robot is at `world_from_robot` now though nothing measured how it came there:
    /// a server put it there. `sigma_m` and `sigma_rad` say how well that place fits this map.
    pub fn put_at(&mut self, world_from_robot: &Isometry3<f64>, sigma_m: f64, sigma_rad: f64) {
        self.restart_wheels();
        let increment = self.world_from_robot().inverse() * world_from_robot;
        let spread = Vector6::new(sigma_m, sigma_m, sigma_m, sigma_rad, sigma_rad, sigma_rad);
        let covariance = Matrix6::from_diagonal(&spread.component_mul(&spread));
        self.mapper.predict_with(&increment, &covariance);
        self.leg.put(&increment);
    }

    /// The same with a laser whose place on the robot is known to `sigma_m` in each axis.
    #[must_use]
    pub fn mounted_within(self, sigma_m: f64) -> Self {
        Self { mapper: self.mapper.mounted_within(sigma_m), ..self }
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
            curves: curved_observations(segmentation, &image.robot_from_scan),
            robot_from_scan: image.robot_from_scan,
            errors,
            contacts: self.live.shape().contacts(),
        };
        self.stand_as_seen(&scan.observations);
        if let Some(attitude) = self.motion.last_attitude() {
            let step_share = self.mapper.config().odometry.inertial.step_share;
            let drifted = self.motion.level_sigma_rad(step_share);
            let sigma = self.config.attitude_sigma_rad.hypot(drifted);
            self.mapper.attitude(attitude.roll_rad, attitude.pitch_rad, sigma);
        }
        let update = self.mapper.observe(&scan);
        self.settle_attitude(&update.world_from_robot);
        self.settle_heading(&update);
        self.pending.clear();
        self.pending_flat.clear();
        self.aligner.restart();
        self.walls = WallAligner::default();
        let redrawn = self.settle(&update, image);
        ScanFindings { planes, spheres, cylinders, update, redrawn }
    }

    /// The vertical in the robot's frame, as a sweep shows it, or as the robot was said to stand where that shows
    /// nothing else.
    pub(super) fn up_as_seen(&mut self, image: &RangeImage) -> Unit<Vector3<f64>> {
        let columns = self.segmented_columns(image.columns());
        let grid = image.point_grid(columns);
        let segmenter =
            self.segmenter.get_or_insert_with(|| Segmenter::new(self.config.segmentation.clone()));
        let seen = observations(segmenter.segment(&grid), &grid, &image.robot_from_scan);
        let assumed = self.assumed_up();
        upright(&seen, &assumed).unwrap_or(assumed)
    }

    fn assumed_up(&self) -> Unit<Vector3<f64>> {
        Unit::new_normalize(self.world_from_robot().rotation.inverse() * Vector3::z())
    }

    /// Before the first sweep is taken in: if it shows that the robot does not stand as it was said to, the map begins
    /// so that it does, and the inertial unit, which has missed that, is off by it.
    fn stand_as_seen(&mut self, observations: &[Observation]) {
        if !self.mapper.is_empty() {
            return;
        }
        let world_from_robot = self.world_from_robot();
        let Some(up) = upright(observations, &self.assumed_up()) else { return };
        let (_, _, heading_rad) = world_from_robot.rotation.euler_angles();
        // Roll and pitch of `Rz Ry Rx` under which the vertical is `up` in the robot's frame.
        let (roll_rad, pitch_rad) = (up.y.atan2(up.z), (-up.x).asin());
        let stands = UnitQuaternion::from_euler_angles(roll_rad, pitch_rad, heading_rad);
        self.start.rotation = stands * self.leg.begin_from_robot().rotation.inverse();
        let mount_m = MOUNT_PER_RAD_M * up.angle(&Vector3::z_axis());
        self.mapper = self.mapper.begun_at(self.start, mount_m);
        self.restart(self.live.shape().clone());
        self.motion.settle_attitude(&BodyAttitude { roll_rad, pitch_rad, heading_rad }, 0.0);
    }

    /// Tells the inertial unit's error from the pose that a sweep has given.
    fn settle_attitude(&mut self, world_from_robot: &Isometry3<f64>) {
        let (roll_rad, pitch_rad, heading_rad) = world_from_robot.rotation.euler_angles();
        let covariance = self.mapper.covariance();
        // The paper's filter takes its map for true and knows no honest deviation.
        let is_honest = self.mapper.config().mode != Mode::Mip;
        let told_rad = covariance[(3, 3)].max(covariance[(4, 4)]).sqrt();
        let sigma_rad = if is_honest { told_rad } else { f64::INFINITY };
        self.motion.settle_attitude(&BodyAttitude { roll_rad, pitch_rad, heading_rad }, sigma_rad);
    }

    /// Tells the wheels how far the robot has turned since the sweep before.
    fn settle_heading(&mut self, update: &UpdateReport) {
        let begins = self.mapper.keyframes().len() == 1;
        let is_open =
            update.weak_directions.iter().any(|weak| weak.direction[5].abs() > WEAK_HEADING);
        let tells = begins || (!update.associations.is_empty() && !is_open);
        let heading_rad = update.world_from_robot.rotation.euler_angles().2;
        self.motion.settle_heading(tells.then_some(heading_rad), begins || is_fixed(update));
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

    /// Settles the leg that led to a sweep. Returns whether the terrain was drawn anew.
    fn settle(&mut self, update: &UpdateReport, sweep: RangeImage) -> bool {
        let keyframes = self.mapper.keyframes();
        let leg = std::mem::take(&mut self.leg);
        if self.settled_legs.is_empty() {
            self.first_from_start = update.world_from_robot.inverse() * self.start;
        }
        self.settled_legs.push(Settled { leg, sweep, entered: update.world_from_robot });
        let redrawn = self.strayed(&BORNE, &keyframes);
        if redrawn {
            self.redraw(&keyframes);
        } else {
            self.draw(self.settled_legs.len() - 1, &keyframes);
        }
        self.live = self.settled.clone();
        // Lines that are still to come may be older than this moment: keep where the robot is now.
        if let Some((stamp, _)) = self.history.back().copied() {
            self.history.clear();
            self.history.push_back((stamp, Isometry3::identity()));
        }
        redrawn
    }

    /// Whether a sweep is believed elsewhere by now than where its points lie in the terrain.
    fn strayed(&self, tolerance: &Tolerance, keyframes: &[Isometry3<f64>]) -> bool {
        let mut settled = self.settled_legs.iter().zip(keyframes);
        settled.any(|(settled, now)| !tolerance.bears(&settled.entered, now))
    }

    /// Draws the terrain anew if any sweep is believed elsewhere by now, however little: for a robot
    /// that the map has shut in. Returns whether it did.
    pub fn mend(&mut self) -> bool {
        let keyframes = self.mapper.keyframes();
        if !self.strayed(&NOTHING, &keyframes) {
            return false;
        }
        self.redraw(&keyframes);
        self.live = self.settled.clone();
        let leg = self.leg.from(&self.keyframe_pose());
        for (image, pose) in leg.images() {
            self.live.integrate(image, &pose);
        }
        for (_, pose) in leg.track() {
            self.live.drive_over(&pose);
        }
        true
    }

    /// Draws the settled terrain anew from all that was seen, where it is believed now.
    fn redraw(&mut self, keyframes: &[Isometry3<f64>]) {
        self.settled.clear();
        self.settled.assume(&self.start, self.assumed_radius_m);
        for sector in &self.assumed_ahead {
            sector.enter(&mut self.settled);
        }
        for keyframe in 0..self.settled_legs.len() {
            self.draw(keyframe, keyframes);
        }
    }

    /// Enters a sweep and the leg that led to it into the settled terrain.
    fn draw(&mut self, keyframe: usize, keyframes: &[Isometry3<f64>]) {
        let bent = bent_leg(&self.settled_legs, keyframe, keyframes, &self.first_from_start);
        for (image, pose) in bent.images() {
            self.settled.integrate(image, &pose);
        }
        let settled = &self.settled_legs[keyframe];
        self.settled.integrate(&settled.sweep, &keyframes[keyframe]);
        for (_, pose) in bent.track() {
            self.settled.drive_over(&pose);
        }
        self.settled_legs[keyframe].entered = keyframes[keyframe];
    }

    /// The legs that sweeps have settled, bent to where those are believed now.
    fn bent_legs<'a>(
        &'a self,
        keyframes: &'a [Isometry3<f64>],
    ) -> impl Iterator<Item = BentLeg<'a>> + 'a {
        (0..self.settled_legs.len()).map(move |keyframe| {
            bent_leg(&self.settled_legs, keyframe, keyframes, &self.first_from_start)
        })
    }

    /// Every point of every sweep and line in the map, where it is believed now. Points beyond what the
    /// terrain reads are among them.
    pub fn points(&self) -> Vec<Point3<f64>> {
        let keyframes = self.mapper.keyframes();
        let mut points = Vec::new();
        for (bent, (settled, pose)) in
            self.bent_legs(&keyframes).zip(self.settled_legs.iter().zip(&keyframes))
        {
            let images = bent.images().chain([(&settled.sweep, *pose)]);
            images.for_each(|(image, pose)| add_points(image, &pose, &mut points));
        }
        points
    }

    /// The trajectory as it is believed now, later corrections included.
    pub fn trajectory(&self) -> Vec<(Stamp, Isometry3<f64>)> {
        let keyframes = self.mapper.keyframes();
        let mut poses: Vec<_> = Vec::new();
        for bent in self.bent_legs(&keyframes) {
            poses.extend(bent.track());
        }
        poses.extend(self.leg.from(&self.keyframe_pose()).track());
        poses
    }
}

/// The leg that led to a keyframe, between where both its ends are believed now.
fn bent_leg<'a>(
    legs: &'a [Settled],
    keyframe: usize,
    keyframes: &[Isometry3<f64>],
    first_from_start: &Isometry3<f64>,
) -> BentLeg<'a> {
    let begin =
        keyframe.checked_sub(1).map_or(keyframes[0] * first_from_start, |before| keyframes[before]);
    legs[keyframe].leg.between(&begin, &keyframes[keyframe])
}

/// Adds the points of an image taken with the robot at `world_from_robot`.
fn add_points(
    image: &RangeImage,
    world_from_robot: &Isometry3<f64>,
    points: &mut Vec<Point3<f64>>,
) {
    let world_from_scan = world_from_robot * image.robot_from_scan;
    for row in 0..image.rows().len() {
        for column in 0..image.columns() {
            if let Return::Hit(range_m) = image.at(row, column) {
                points.push(world_from_scan * image.point_at(row, column, range_m));
            }
        }
    }
}
