//! What ground a rig can see, from its mount and limits alone.

use super::head::{HeadPose, ScanHead};
use crate::geometry::wrap_pi;
use nalgebra::{Point2, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::fmt;

/// A scan head above level ground: where its beams meet that ground.
#[derive(Clone, Copy, Debug)]
pub struct GroundView<'a> {
    /// The head that carries the laser.
    pub head: &'a ScanHead,
    /// Height of the robot frame's origin above the ground, in metres.
    pub origin_height_m: f64,
    /// Greatest bearing of a beam to either side, in radians.
    pub half_fov_rad: f64,
}

/// The nearest level ground that a rig sees in one direction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroundSight {
    /// Direction from the robot's centre in radians, left positive.
    pub bearing_rad: f64,
    /// Distance from the robot's centre to the nearest visible ground with the pan straight ahead,
    /// in metres; `None` where no ground within reach is visible.
    pub nearest_m: Option<f64>,
    /// The same with the pan turned to wherever it helps.
    pub nearest_panned_m: Option<f64>,
}

/// What level ground a rig can see while it stands still.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Visibility {
    /// Height of the laser above the ground at zero tilt, in metres.
    pub laser_height_m: f64,
    /// Steepest tilt the link reaches, in radians; `None` for a laser that cannot tilt.
    pub steepest_tilt_rad: Option<f64>,
    /// Distance along the ground from under the laser to the nearest ground it sees straight ahead.
    pub nearest_ahead_m: Option<f64>,
    /// The same from the robot's centre.
    pub nearest_from_centre_m: Option<f64>,
    /// Radius about the robot's centre inside which no ground is ever seen, however the robot turns
    /// on the spot.
    pub blind_radius_m: Option<f64>,
    /// Nearest visible ground in every direction, in steps of 5° from -π.
    pub by_bearing: Vec<GroundSight>,
}

/// Ground farther than this does not count as seen ground: cli.md's coverage asks for 8 m, and a
/// laser line that meets the ground at a grazing angle says little about it.
const FAR_GROUND_M: f64 = 20.0;

/// A joint without limits is taken to reach this far down: beyond it the beams look at the robot.
const STEEPEST_USEFUL_RAD: f64 = FRAC_PI_2 - 0.05;

impl GroundView<'_> {
    /// Where the beam at `bearing_rad` meets level ground, in robot coordinates; `None` for a beam
    /// that does not point down.
    pub fn ground_point(&self, pose: HeadPose, bearing_rad: f64) -> Option<Point2<f64>> {
        let robot_from_sensor = self.head.robot_from_device(pose);
        let (sin, cos) = bearing_rad.sin_cos();
        let direction = robot_from_sensor.rotation * Vector3::new(cos, sin, 0.0);
        let origin = robot_from_sensor.translation.vector;
        let drop = origin.z + self.origin_height_m;
        // A beam within 0.06° of level meets the ground a kilometre away, if at all.
        const LEVEL: f64 = 1e-3;
        if direction.z > -LEVEL || drop <= 0.0 {
            return None;
        }
        let range = drop / -direction.z;
        Some(Point2::new(origin.x + range * direction.x, origin.y + range * direction.y))
    }

    /// Range in metres at which the beam at `bearing_rad` meets level ground.
    pub fn ground_range_m(&self, pose: HeadPose, bearing_rad: f64) -> Option<f64> {
        let robot_from_sensor = self.head.robot_from_device(pose);
        let meets = self.ground_point(pose, bearing_rad)?;
        let from = robot_from_sensor.translation.vector;
        let drop = from.z + self.origin_height_m;
        Some((meets.x - from.x).hypot(meets.y - from.y).hypot(drop))
    }

    /// Distance from the robot's centre to where the middle beam meets level ground under `tilt_rad`.
    pub fn ground_ahead_m(&self, tilt_rad: f64) -> Option<f64> {
        self.ground_point(HeadPose::tilted(tilt_rad), 0.0).map(|p| p.coords.norm())
    }

    /// The tilt under which the middle beam meets level ground `ahead_m` from the robot's centre, in
    /// radians, without regard to the link's limits; `None` for a laser that cannot tilt or a
    /// distance behind the laser.
    pub fn tilt_for_ground_ahead(&self, ahead_m: f64) -> Option<f64> {
        self.head.tilt()?;
        // The distance falls as the tilt grows, so a bisection finds it whatever the mount's offsets.
        let (mut flat, mut steep) = (-FRAC_PI_2 / 2.0, STEEPEST_USEFUL_RAD);
        let nearer =
            |tilt| self.ground_point(HeadPose::tilted(tilt), 0.0).is_some_and(|p| p.x <= ahead_m);
        if !nearer(steep) {
            return None;
        }
        for _ in 0..60 {
            let middle = 0.5 * (flat + steep);
            if nearer(middle) {
                steep = middle;
            } else {
                flat = middle;
            }
        }
        Some(steep)
    }

    /// Height of the laser above the ground at zero pan and tilt, in metres.
    pub fn laser_height_m(&self) -> f64 {
        self.head.robot_from_device(HeadPose::default()).translation.z + self.origin_height_m
    }

    /// The steepest tilt the link reaches, in radians; `None` for a laser that cannot tilt.
    pub fn steepest_tilt_rad(&self) -> Option<f64> {
        let tilt = self.head.tilt()?;
        Some(tilt.limits.map_or(STEEPEST_USEFUL_RAD, |l| l.max_rad.min(STEEPEST_USEFUL_RAD)))
    }

    /// Everything the rig can see of level ground.
    pub fn visibility(&self) -> Visibility {
        let steepest = self.steepest_tilt_rad();
        let tilts = self.sampled_tilts(steepest);
        let ahead = self.nearest_by_bearing(&tilts, &[0.0]);
        let panned = self.nearest_by_bearing(&tilts, &self.sampled_pans());
        let by_bearing: Vec<_> = (0..BINS)
            .map(|bin| GroundSight {
                bearing_rad: bin as f64 / BINS as f64 * TAU - PI,
                nearest_m: ahead[bin],
                nearest_panned_m: panned[bin],
            })
            .collect();
        let straight = self.ground_point(HeadPose::tilted(steepest.unwrap_or(0.0)), 0.0);
        let laser = self.head.robot_from_device(HeadPose::default()).translation.vector;
        Visibility {
            laser_height_m: self.laser_height_m(),
            steepest_tilt_rad: steepest,
            nearest_ahead_m: straight.map(|p| (p.x - laser.x).hypot(p.y - laser.y)),
            nearest_from_centre_m: straight.map(|p| p.coords.norm()),
            blind_radius_m: ahead.iter().flatten().copied().reduce(f64::min),
            by_bearing,
        }
    }

    fn sampled_tilts(&self, steepest: Option<f64>) -> Vec<f64> {
        const STEPS: usize = 24;
        let Some(steepest) = steepest else { return vec![0.0] };
        (0..=STEPS).map(|i| steepest * (1.0 - i as f64 / STEPS as f64)).collect()
    }

    fn sampled_pans(&self) -> Vec<f64> {
        const STEPS: usize = 36;
        let Some(pan) = self.head.pan() else { return vec![0.0] };
        let (low, high) = pan.limits.map_or((-PI, PI), |l| (l.min_rad, l.max_rad));
        (0..=STEPS).map(|i| low + (high - low) * i as f64 / STEPS as f64).chain([0.0]).collect()
    }

    fn nearest_by_bearing(&self, tilts: &[f64], pans: &[f64]) -> Vec<Option<f64>> {
        const BEAMS: usize = 90;
        let mut nearest: Vec<Option<f64>> = vec![None; BINS];
        for (&tilt_rad, &pan_rad) in tilts.iter().flat_map(|t| pans.iter().map(move |p| (t, p))) {
            for beam in 0..=BEAMS {
                let bearing = self.half_fov_rad * (2.0 * beam as f64 / BEAMS as f64 - 1.0);
                let Some(p) = self.ground_point(HeadPose { pan_rad, tilt_rad }, bearing) else {
                    continue;
                };
                let distance = p.coords.norm();
                if distance <= FAR_GROUND_M {
                    let bin = bin_of(p.y.atan2(p.x));
                    nearest[bin] = Some(nearest[bin].map_or(distance, |d: f64| d.min(distance)));
                }
            }
        }
        nearest
    }
}

const BINS: usize = 72;

fn bin_of(bearing_rad: f64) -> usize {
    let share = (wrap_pi(bearing_rad) + PI) / TAU;
    (share * BINS as f64).round() as usize % BINS
}

impl Visibility {
    /// The nearest ground visible at a bearing from the robot's centre with the pan straight ahead.
    pub fn nearest_m(&self, bearing_rad: f64) -> Option<f64> {
        self.by_bearing[bin_of(bearing_rad)].nearest_m
    }
}

impl fmt::Display for Visibility {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let height = self.laser_height_m;
        match (self.steepest_tilt_rad, self.nearest_ahead_m) {
            (None, None) => {
                write!(f, "the laser, {height:.2} m up, cannot tilt: no ground is seen")
            }
            (None, Some(ahead)) => write!(
                f,
                "the laser, {height:.2} m up, cannot tilt: it sees level ground {ahead:.1} m ahead only"
            ),
            (Some(tilt), None) => write!(
                f,
                "the tilt stops at {:.1}°: no ground is seen from {height:.2} m up",
                tilt.to_degrees()
            ),
            (Some(tilt), Some(ahead)) => write!(
                f,
                "ground nearer than {ahead:.1} m cannot be seen: the tilt stops at {:.1}° down, \
                 {height:.2} m up",
                tilt.to_degrees()
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::mount::{Joint, JointKind, Mount};
    use super::*;
    use crate::geometry::AngleSpan;
    use nalgebra::Isometry3;
    use proptest::prelude::*;

    fn head(limits: Option<AngleSpan>, x_m: f64, up_m: f64, device_x_m: f64) -> ScanHead {
        let revolute = JointKind::Revolute;
        let pan = Joint::from_wire("PT", 1, revolute, [x_m, 0.0, -up_m], [PI, 0.0, 0.0]);
        let mut tilt = Joint::from_wire("PT", 2, revolute, [0.0; 3], [FRAC_PI_2, 0.0, 0.0]);
        tilt.limits = limits;
        ScanHead::new(Mount {
            joints: vec![pan, tilt],
            part_from_device: Isometry3::translation(device_x_m, 0.0, 0.0),
        })
    }

    fn view(head: &ScanHead) -> GroundView<'_> {
        GroundView { head, origin_height_m: 0.15, half_fov_rad: FRAC_PI_2 }
    }

    #[test]
    fn stock_limits_hide_all_ground_nearer_than_three_point_seven_metres() {
        let head = head(Some(AngleSpan::new(-0.16, 0.40)), 0.1, 0.45, 0.0);
        let seen = view(&head).visibility();
        assert!((seen.nearest_ahead_m.unwrap() - 0.6 / 0.16_f64.tan()).abs() < 1e-9);
        assert!(seen.to_string().starts_with("ground nearer than 3.7 m cannot be seen"), "{seen}");
    }

    #[test]
    fn thirty_degrees_from_sixty_centimetres_see_ground_from_one_metre_on() {
        let head = head(Some(AngleSpan::new(-(30_f64.to_radians()), 1.0)), 0.1, 0.45, 0.0);
        let seen = view(&head).visibility();
        assert!((seen.nearest_ahead_m.unwrap() - 1.04).abs() < 0.01);
        assert!((seen.nearest_from_centre_m.unwrap() - 1.14).abs() < 0.01);
        // The line on the ground is straight across: off the axis the ground is farther away.
        let aside = seen.nearest_m(60_f64.to_radians()).unwrap();
        assert!(aside > 2.0 * 1.14 * 0.95, "{aside}");
        assert_eq!(seen.nearest_m(PI), None, "nothing behind without panning");
        assert!(seen.by_bearing[0].nearest_panned_m.is_some(), "the pan looks behind");
    }

    #[test]
    fn a_fixed_level_laser_sees_no_ground_and_says_so() {
        let head = ScanHead::new(Mount::on_body([0.14, 0.0, -0.09], [0.0; 3]));
        let seen = view(&head).visibility();
        assert_eq!((seen.nearest_ahead_m, seen.blind_radius_m), (None, None));
        assert!(seen.to_string().contains("cannot tilt"));
    }

    proptest! {
        #[test]
        fn a_tilt_found_for_a_distance_meets_the_ground_there(
            ahead in 0.6..8.0f64, x in -0.1..0.2f64, device_x in 0.0..0.1f64
        ) {
            let head = head(None, x, 0.45, device_x);
            let view = view(&head);
            let tilt = view.tilt_for_ground_ahead(ahead).unwrap();
            prop_assert!((view.ground_ahead_m(tilt).unwrap() - ahead).abs() < 1e-6);
        }

        #[test]
        fn a_ground_range_ends_on_the_ground(tilt in 0.05..1.2f64, bearing in -1.4..1.4f64) {
            let head = head(None, 0.1, 0.45, 0.05);
            let view = view(&head);
            let pose = HeadPose::tilted(tilt);
            let range = view.ground_range_m(pose, bearing).unwrap();
            let p = head.robot_from_device(pose)
                * nalgebra::Point3::new(range * bearing.cos(), range * bearing.sin(), 0.0);
            prop_assert!((p.z + 0.15).abs() < 1e-9);
        }
    }
}
