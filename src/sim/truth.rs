//! What really happened to a robot: for scoring and tests, never for an agent.

use super::physics::Other;
use super::vehicle::VehicleState;
use super::world::{ObjectKind, World};
use crate::time::{Span, Stamp};
use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};

/// A robot sinks by more than this within [`FALL_WINDOW`]: it fell.
const FALL_M: f64 = 0.3;
const FALL_WINDOW: Span = Span::from_millis(1000);

/// A robot leans by more than this: it fell; it stands again below the second angle.
const TOPPLED_RAD: f64 = std::f64::consts::FRAC_PI_3;
const UPRIGHT_RAD: f64 = std::f64::consts::FRAC_PI_4;

/// A drop and the toppling it leads to are one fall.
const SAME_FALL: Span = Span::from_millis(3000);

/// Contacts with one thing less than this apart are one event.
const SAME_CONTACT: Span = Span::from_millis(500);

/// A push steeper than this comes from the ground: the belly sits on it, nothing was run into.
const GROUND_PUSH_Z: f64 = 0.7;

/// A portal counts for a robot whose origin is within this height of it.
const PORTAL_HEIGHT_M: f64 = 1.5;

/// The true state of a robot and what befell it so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// The robot's name.
    pub name: String,
    /// Its class.
    pub class: String,
    /// Level time.
    pub stamp: Stamp,
    /// What the robot's messages are stamped with at that time: the same but for a clock that was set.
    pub printed: Stamp,
    /// Pose of the robot's origin, core frame.
    pub world_from_robot: Isometry3<f64>,
    /// Speed of the origin in m/s.
    pub speed_mps: f64,
    /// Angular velocity in the world in rad/s.
    pub angular_rps: Vector3<f64>,
    /// True pan of the first unit in radians, positive left; 0 without one.
    pub pan_rad: f64,
    /// True tilt of the first unit in the core's sense, positive **down**; 0 without one.
    pub tilt_rad: f64,
    /// Wire length of the way so far in metres, as the origin went.
    pub distance_m: f64,
    /// Whether the robot lies on its side or back.
    pub toppled: bool,
    /// How often it fell: sank by 0.3 m within a second, or leant by 60°.
    pub falls: u32,
    /// How often its body ran into something.
    pub collisions: u32,
    /// The fastest of those, in m/s along the direction of contact.
    pub worst_collision_mps: f64,
    /// Portals crossed, each once, in order.
    pub portals: Vec<String>,
    /// How often each victim was touched.
    pub victim_contacts: BTreeMap<String, u32>,
}

/// The truth of one scanner line: where its rays started, and when.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CastTruth {
    /// The scanner's name.
    pub scanner: String,
    /// The stamp that the line carries.
    pub printed: Stamp,
    /// When the rays were cast.
    pub cast_at: Stamp,
    /// True pose of the sensor, core frame.
    pub world_from_sensor: Isometry3<f64>,
    /// True pan of the first unit in radians, positive left.
    pub pan_rad: f64,
    /// True tilt of the first unit in the core's sense, positive **down**.
    pub tilt_rad: f64,
}

/// What accumulates while a robot lives, and from one life to the next of the same name.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Score {
    pub(crate) distance_m: f64,
    pub(crate) toppled: bool,
    pub(crate) falls: u32,
    pub(crate) collisions: u32,
    pub(crate) worst_collision_mps: f64,
    pub(crate) portals: Vec<String>,
    pub(crate) victim_contacts: BTreeMap<String, u32>,
    heights: VecDeque<(Stamp, f64)>,
    last_fall: Option<Stamp>,
    pressed: BTreeMap<Other, Stamp>,
    touched: BTreeMap<usize, Stamp>,
    before: Option<VehicleState>,
}

impl Score {
    /// Forgets what belongs to a body, before the next body of the same name.
    pub(crate) fn reborn(self) -> Self {
        Self {
            heights: VecDeque::new(),
            last_fall: None,
            pressed: BTreeMap::new(),
            touched: BTreeMap::new(),
            before: None,
            toppled: false,
            ..self
        }
    }

    /// Judges one physics step.
    pub(crate) fn step(&mut self, state: &VehicleState, world: &World, now: Stamp) {
        let origin = Point3::from(state.world_from_robot.translation.vector);
        if let Some(before) = self.before.take() {
            let from = Point3::from(before.world_from_robot.translation.vector);
            if from != origin {
                self.distance_m += (origin - from).norm();
                self.cross_portals(world, &from, &origin);
            }
            self.judge_contacts(state, &before, world, now);
        }
        self.judge_falls(state, &origin, now);
        self.before = Some(state.clone());
    }

    fn judge_falls(&mut self, state: &VehicleState, origin: &Point3<f64>, now: Stamp) {
        while self.heights.front().is_some_and(|(at, _)| now - *at > FALL_WINDOW) {
            self.heights.pop_front();
        }
        // Higher samples that came later make lower earlier ones useless.
        while self.heights.back().is_some_and(|(_, height)| *height <= origin.z) {
            self.heights.pop_back();
        }
        self.heights.push_back((now, origin.z));
        let sunk = self.heights.front().is_some_and(|(_, height)| height - origin.z > FALL_M);
        let up = state.world_from_robot.rotation * Vector3::z();
        let lean = up.z.clamp(-1.0, 1.0).acos();
        let topples = !self.toppled && lean > TOPPLED_RAD;
        self.toppled = if self.toppled { lean > UPRIGHT_RAD } else { topples };
        if sunk || topples {
            let same = self.last_fall.is_some_and(|at| now - at < SAME_FALL);
            if !same {
                self.falls += 1;
            }
            self.last_fall = Some(now);
        }
        if sunk {
            self.heights.clear();
        }
    }

    fn judge_contacts(
        &mut self,
        state: &VehicleState,
        before: &VehicleState,
        world: &World,
        now: Stamp,
    ) {
        for touch in &state.body_touches {
            let last = self.pressed.insert(touch.other, now);
            let new = last.is_none_or(|at| now - at > SAME_CONTACT);
            if new && touch.push.z < GROUND_PUSH_Z {
                let approach = -before.velocity_at(&touch.point).dot(&touch.push);
                self.collisions += 1;
                self.worst_collision_mps = self.worst_collision_mps.max(approach);
            }
        }
        for touch in state.body_touches.iter().chain(&state.wheel_touches) {
            let Other::Object(id) = touch.other else { continue };
            let ObjectKind::VictimPart { victim, .. } = world.object(id).kind else { continue };
            let last = self.touched.insert(victim, now);
            if last.is_none_or(|at| now - at > SAME_CONTACT) {
                let name = world.victims()[victim].name.clone();
                *self.victim_contacts.entry(name).or_default() += 1;
            }
        }
    }

    fn cross_portals(&mut self, world: &World, from: &Point3<f64>, to: &Point3<f64>) {
        for portal in world.portals() {
            let level = (portal.from.z + portal.to.z) / 2.0;
            if (to.z - level).abs() < PORTAL_HEIGHT_M
                && crosses(from, to, &portal.from, &portal.to)
                && !self.portals.contains(&portal.name)
            {
                self.portals.push(portal.name.clone());
            }
        }
    }
}

/// Whether two segments cross in the plane; an end that lies on the other counts.
fn crosses(a: &Point3<f64>, b: &Point3<f64>, c: &Point3<f64>, d: &Point3<f64>) -> bool {
    let side = |p: &Point3<f64>, q: &Point3<f64>, r: &Point3<f64>| {
        (q.x - p.x) * (r.y - p.y) - (q.y - p.y) * (r.x - p.x)
    };
    side(a, b, c) * side(a, b, d) <= 0.0 && side(c, d, a) * side(c, d, b) <= 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::map_file::MapFile;
    use crate::sim::physics::Touching;
    use crate::sim::world::{ObjectId, placed};

    fn world() -> World {
        let map = "name = \"m\"\nbounds = [0.0, 0.0, 1.0, 1.0]\n\
                   [[box]]\ncenter = [0.0, 0.0, -0.5]\nsize = [9.0, 9.0, 1.0]\n\
                   [[portal]]\nname = \"door\"\nfrom = [1.0, -1.0, 0.0]\nto = [1.0, 1.0, 0.0]\n\
                   [[victim]]\nname = \"Anna\"\nposition = [3.0, 0.0, 0.0]\nstatus = \"alive\"\n";
        World::new(&MapFile::parse(map).unwrap(), &BTreeMap::new()).unwrap()
    }

    fn at(position: [f64; 3], roll_deg: f64) -> VehicleState {
        VehicleState {
            world_from_robot: placed(position, [roll_deg, 0.0, 0.0]),
            velocity_mps: Vector3::new(0.4, 0.0, 0.0),
            angular_rps: Vector3::zeros(),
            wheel_angles_rad: vec![0.0; 4],
            body_touches: Vec::new(),
            wheel_touches: Vec::new(),
        }
    }

    fn score(states: impl IntoIterator<Item = VehicleState>) -> Score {
        let world = world();
        let mut score = Score::default();
        for (number, state) in states.into_iter().enumerate() {
            score.step(&state, &world, Stamp::from_seconds(number as f64 * 0.05));
        }
        score
    }

    #[test]
    fn a_ramp_is_no_fall_and_a_drop_is_one() {
        let ramp = (0..100).map(|i| at([0.0, 0.0, 2.0 - f64::from(i) * 0.012], 0.0));
        assert_eq!(score(ramp).falls, 0);
        let drop = (0..100).map(|i| at([0.0, 0.0, if i < 50 { 1.0 } else { 0.1 }], 0.0));
        assert_eq!(score(drop).falls, 1);
    }

    #[test]
    fn falling_onto_the_side_is_one_fall() {
        let states = (0..60).map(|i| {
            let down = i > 10;
            at([0.0, 0.0, if down { 0.1 } else { 1.0 }], if i > 20 { 90.0 } else { 0.0 })
        });
        let score = score(states);
        assert!(score.toppled);
        assert_eq!(score.falls, 1);
    }

    #[test]
    fn a_contact_counts_once_with_its_speed_and_ground_does_not_count() {
        let touch = |push: Vector3<f64>| Touching {
            other: Other::Object(ObjectId(0)),
            point: Point3::new(0.2, 0.0, 0.2),
            push,
        };
        let wall = (0..20).map(|i| VehicleState {
            body_touches: if i > 3 { vec![touch(-Vector3::x())] } else { vec![] },
            ..at([0.0; 3], 0.0)
        });
        let hit = score(wall);
        assert_eq!(hit.collisions, 1);
        assert!((hit.worst_collision_mps - 0.4).abs() < 1e-12);
        let belly = (0..20)
            .map(|_| VehicleState { body_touches: vec![touch(Vector3::z())], ..at([0.0; 3], 0.0) });
        assert_eq!(score(belly).collisions, 0);
    }

    #[test]
    fn portals_count_when_crossed_and_victims_when_touched() {
        let pass = [0.5, 0.9, 1.1, 0.9, 1.2].map(|x| at([x, 0.0, 0.2], 0.0));
        assert_eq!(score(pass).portals, ["door"]);
        let past = [0.5, 1.5].map(|x| at([x, 2.0, 0.2], 0.0));
        assert!(score(past).portals.is_empty());
        let world = world();
        let part = world.objects().iter().position(|o| o.name == "Anna/Chest").unwrap();
        let touching = (0..5).map(|_| VehicleState {
            wheel_touches: vec![Touching {
                other: Other::Object(ObjectId(part as u32)),
                point: Point3::origin(),
                push: Vector3::x(),
            }],
            ..at([0.0; 3], 0.0)
        });
        assert_eq!(score(touching).victim_contacts, BTreeMap::from([("Anna".to_owned(), 1)]));
    }
}
