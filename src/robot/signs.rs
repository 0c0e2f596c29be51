//! Whether a joint turns the way its axis promises, judged by laser lines taken at two angles.

use super::head::HeadPose;
use super::visibility::GroundView;
use crate::scan::{LaserLine, Return};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// What lines taken at two angles say about the sign of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SignVerdict {
    /// The joint turns as believed.
    AsBelieved,
    /// The joint turns the other way.
    Inverted,
    /// The lines fit both, or neither: too little structure, or nothing below.
    Undecided,
}

/// Beams farther off the head's x axis than this are left out: the tilt hardly moves them.
const WIDEST_BEARING_RAD: f64 = 1.05;
/// The quantile that stands for how far below or above the laser a line reaches.
const REACH_QUANTILE: f64 = 0.75;
/// How much farther the line that looks up must reach than the one that looks down.
const TIMES_FARTHER: f64 = 1.5;
/// A line that was believed to look down must reach this many times below the supposed ground before
/// it is taken for one that looks up, and the other no farther: it meets the ground that the robot stands on. From
/// a slope a line that looks down may reach far below, into the room beyond.
const BELOW_GROUND: f64 = 1.4;
/// Fewer beams than this tell nothing.
const FEWEST_BEAMS: usize = 20;

/// Judges the tilt by two lines: one taken at `down_rad > 0`, believed to look down, and one at
/// `up_rad < 0`, believed to look up.
///
/// Nothing is seen below the ground: whichever line looks down reaches no deeper than the laser is
/// high, the other as high as the room is or for ever. The height itself need not be known well, as it
/// is not before the first scan. Between near walls both lines end at the walls, and nothing is decided.
pub fn tilt_sign(
    view: &GroundView<'_>,
    (down_rad, down): (f64, &LaserLine),
    (up_rad, up): (f64, &LaserLine),
) -> SignVerdict {
    let (Some(depth), Some(height)) = (reach_m(view, down_rad, down), reach_m(view, up_rad, up))
    else {
        return SignVerdict::Undecided;
    };
    if height > TIMES_FARTHER * depth {
        SignVerdict::AsBelieved
    } else if depth > TIMES_FARTHER * height
        && depth > BELOW_GROUND * view.laser_height_m()
        && height < BELOW_GROUND * view.laser_height_m()
    {
        SignVerdict::Inverted
    } else {
        SignVerdict::Undecided
    }
}

/// How far off the laser's level a line under `tilt_rad` reaches, in metres: a high quantile, beams
/// without a return counted at the greatest range.
fn reach_m(view: &GroundView<'_>, tilt_rad: f64, line: &LaserLine) -> Option<f64> {
    let robot_from_device = view.head.robot_from_device(HeadPose::tilted(tilt_rad));
    let mut reaches: Vec<f64> = (0..line.len())
        .filter(|&beam| line.bearing_rad(beam).abs() <= WIDEST_BEARING_RAD)
        .filter_map(|beam| {
            let range_m = match line.classify(beam) {
                Return::Hit(range) => range,
                Return::Nothing => line.max_range_m,
                Return::Missing => return None,
            };
            let (sin, cos) = line.bearing_rad(beam).sin_cos();
            let direction = robot_from_device.rotation * Vector3::new(cos, sin, 0.0);
            Some(range_m * direction.z.abs())
        })
        .collect();
    if reaches.len() < FEWEST_BEAMS {
        return None;
    }
    reaches.sort_by(f64::total_cmp);
    Some(reaches[(reaches.len() as f64 * REACH_QUANTILE) as usize])
}

/// Judges the pan by lines taken at two pan angles, which must differ by less than the field of view.
///
/// Turning the head to the left moves everything seen to the right: the second line is the first one
/// shifted by the turn, one way or the other.
pub fn pan_sign(
    (first_rad, first): (f64, &LaserLine),
    (second_rad, second): (f64, &LaserLine),
) -> SignVerdict {
    let turn_rad = second_rad - first_rad;
    // Without noise both medians may be 0, as in a round room; the resolution of ranges is a floor.
    const FLOOR: f64 = 1e-3;
    let difference = |shift_rad| shifted_difference(first, second, shift_rad);
    let (Some(believed), Some(inverted)) = (difference(turn_rad), difference(-turn_rad)) else {
        return SignVerdict::Undecided;
    };
    let (believed, inverted) = (believed + FLOOR, inverted + FLOOR);
    // A clear fit is within a few percent and several times better than the other way round.
    const FIT: f64 = 0.03;
    const TIMES_BETTER: f64 = 3.0;
    if believed < FIT && believed * TIMES_BETTER < inverted {
        SignVerdict::AsBelieved
    } else if inverted < FIT && inverted * TIMES_BETTER < believed {
        SignVerdict::Inverted
    } else {
        SignVerdict::Undecided
    }
}

/// Median relative difference between `second` and `first` read `shift_rad` further to the left;
/// `None` if too few beams can be compared.
fn shifted_difference(first: &LaserLine, second: &LaserLine, shift_rad: f64) -> Option<f64> {
    let mut differences: Vec<f64> = (0..second.len())
        .filter_map(|beam| {
            let bearing = second.bearing_rad(beam) + shift_rad;
            let at = (bearing - first.first_bearing_rad) / first.bearing_step_rad;
            let index = at.round();
            if index < 0.0 || index >= first.len() as f64 {
                return None;
            }
            match (first.classify(index as usize), second.classify(beam)) {
                (Return::Hit(a), Return::Hit(b)) => Some((a / b).ln().abs()),
                _ => None,
            }
        })
        .collect();
    if differences.len() < FEWEST_BEAMS {
        return None;
    }
    differences.sort_by(f64::total_cmp);
    Some(differences[differences.len() / 2])
}

#[cfg(test)]
mod tests {
    use super::super::head::ScanHead;
    use super::super::mount::{Joint, JointKind, Mount};
    use super::*;
    use crate::time::Stamp;
    use nalgebra::{Isometry3, Vector3};
    use std::f64::consts::{FRAC_PI_2, PI};

    fn head() -> ScanHead {
        let revolute = JointKind::Revolute;
        ScanHead::new(Mount {
            joints: vec![
                Joint::from_wire("PT", 1, revolute, [0.1, 0.0, -0.4], [PI, 0.0, 0.0]),
                Joint::from_wire("PT", 2, revolute, [0.0; 3], [FRAC_PI_2, 0.0, 0.0]),
            ],
            part_from_device: Isometry3::identity(),
        })
    }

    /// A line seen under `pose` in a room with walls at the given distances (front, left, right,
    /// back), the floor 0.15 m below the robot's origin and a ceiling.
    fn line(pose: HeadPose, walls: [f64; 4], ceiling: f64) -> LaserLine {
        let robot_from_sensor = head().robot_from_device(pose);
        let o = robot_from_sensor.translation.vector;
        let step = PI / 180.0;
        let ranges_m = (0..181)
            .map(|beam| {
                let (sin, cos) = (f64::from(beam) * step - FRAC_PI_2).sin_cos();
                let d = robot_from_sensor.rotation * Vector3::new(cos, sin, 0.0);
                [
                    (walls[0] - o.x) / d.x,
                    (-walls[3] - o.x) / d.x,
                    (walls[1] - o.y) / d.y,
                    (-walls[2] - o.y) / d.y,
                    (-0.15 - o.z) / d.z,
                    (ceiling - o.z) / d.z,
                ]
                .into_iter()
                .filter(|t| *t > 1e-9)
                .fold(20.0, f64::min)
            })
            .collect();
        LaserLine {
            stamp: Stamp(0),
            first_bearing_rad: -FRAC_PI_2,
            bearing_step_rad: step,
            min_range_m: 0.1,
            max_range_m: 20.0,
            phantom_m: None,
            ranges_m,
        }
    }

    const ROOM: [f64; 4] = [5.0, 3.0, 7.0, 4.0];

    #[test]
    fn a_tilt_is_judged_by_the_ground_it_sees() {
        let head = head();
        let view = GroundView { head: &head, origin_height_m: 0.15, half_fov_rad: FRAC_PI_2 };
        let at = |tilt| line(HeadPose::tilted(tilt), ROOM, 2.5);
        let (down, up) = (at(0.25), at(-0.25));
        assert_eq!(tilt_sign(&view, (0.25, &down), (-0.25, &up)), SignVerdict::AsBelieved);
        assert_eq!(tilt_sign(&view, (0.25, &up), (-0.25, &down)), SignVerdict::Inverted);
    }

    #[test]
    fn a_tilt_before_near_walls_cannot_be_judged() {
        let head = head();
        let view = GroundView { head: &head, origin_height_m: 0.15, half_fov_rad: FRAC_PI_2 };
        let at = |tilt| line(HeadPose::tilted(tilt), [0.9, 0.7, 0.7, 0.9], 2.5);
        let (down, up) = (at(0.2), at(-0.2));
        assert_eq!(tilt_sign(&view, (0.2, &down), (-0.2, &up)), SignVerdict::Undecided);
    }

    #[test]
    fn the_height_of_the_laser_need_not_be_known_well() {
        let head = head();
        for origin_height_m in [0.05, 0.15, 0.4] {
            let view = GroundView { head: &head, origin_height_m, half_fov_rad: FRAC_PI_2 };
            let at = |tilt| line(HeadPose::tilted(tilt), ROOM, 100.0);
            let (down, up) = (at(0.2), at(-0.2));
            assert_eq!(tilt_sign(&view, (0.2, &down), (-0.2, &up)), SignVerdict::AsBelieved);
            // A height supposed wrongly may leave it open, but never confirms the wrong sign.
            let verdict = tilt_sign(&view, (0.2, &up), (-0.2, &down));
            assert_ne!(verdict, SignVerdict::AsBelieved, "{origin_height_m}");
        }
    }

    #[test]
    fn a_slope_inverts_nothing() {
        let head = head();
        let view = GroundView { head: &head, origin_height_m: 0.15, half_fov_rad: FRAC_PI_2 };
        // Nose up by 0.13 rad on a ramp that ends before the robot, in a long room with a low roof.
        let at = |tilt| line(HeadPose::tilted(tilt - 0.13), [14.0, 5.0, 5.0, 4.0], 1.9);
        let (mut down, up) = (at(0.2), at(-0.2));
        // The floor of the room lies half a metre below.
        down.ranges_m.iter_mut().for_each(|range_m| *range_m *= 2.0);
        assert_ne!(tilt_sign(&view, (0.2, &down), (-0.2, &up)), SignVerdict::Inverted);
    }

    #[test]
    fn a_low_ceiling_inverts_nothing() {
        let head = head();
        let view = GroundView { head: &head, origin_height_m: 0.15, half_fov_rad: FRAC_PI_2 };
        // Under a table: the board 0.25 m above the laser, the ground 0.55 m below it.
        let at = |tilt| line(HeadPose::tilted(tilt), ROOM, 0.65);
        let (down, up) = (at(0.2), at(-0.2));
        assert_eq!(tilt_sign(&view, (0.2, &down), (-0.2, &up)), SignVerdict::Undecided);
    }

    #[test]
    fn a_pan_is_judged_by_the_shift_of_the_walls() {
        let at = |pan_rad| line(HeadPose { pan_rad, tilt_rad: 0.0 }, ROOM, 2.5);
        let (ahead, left, right) = (at(0.0), at(0.3), at(-0.3));
        assert_eq!(pan_sign((0.0, &ahead), (0.3, &left)), SignVerdict::AsBelieved);
        assert_eq!(pan_sign((0.0, &ahead), (0.3, &right)), SignVerdict::Inverted);
        let open = line(HeadPose::default(), [100.0; 4], 2.5);
        assert_eq!(pan_sign((0.0, &open), (0.3, &open)), SignVerdict::Undecided);
    }

    #[test]
    fn a_round_room_tells_nothing_about_the_pan() {
        let mut round = line(HeadPose::default(), ROOM, 2.5);
        round.ranges_m.fill(3.0);
        assert_eq!(pan_sign((0.0, &round), (0.3, &round)), SignVerdict::Undecided);
    }
}
