//! Trajectories in the TUM format: `time x y z qx qy qz qw` a line, `#` begins a comment.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use std::fmt::Write;

/// One pose of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    /// Time in seconds.
    pub time_s: f64,
    /// The pose: world from robot.
    pub pose: Isometry3<f64>,
}

/// A line that is no pose.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("line {line}: {reason}")]
pub struct TumError {
    line: usize,
    reason: String,
}

/// The trajectory as text.
pub fn format(trajectory: &[TimedPose]) -> String {
    let mut text = String::with_capacity(96 * trajectory.len());
    for TimedPose { time_s, pose } in trajectory {
        let (t, q) = (pose.translation.vector, pose.rotation.coords);
        // One of q and -q: w >= 0, so that equal rotations read alike.
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        writeln!(
            text,
            "{time_s:.4} {:.6} {:.6} {:.6} {:.9} {:.9} {:.9} {:.9}",
            t.x,
            t.y,
            t.z,
            sign * q.x,
            sign * q.y,
            sign * q.z,
            sign * q.w
        )
        .expect("writing to a String cannot fail");
    }
    text
}

/// Coordinates beyond this are no place on Earth, and their squares no weights.
const FARTHEST_M: f64 = 1e8;

/// The trajectory of a text.
///
/// # Errors
///
/// The first line that is neither blank, a comment nor eight finite numbers with a quaternion that
/// is not zero.
pub fn parse(text: &str) -> Result<Vec<TimedPose>, TumError> {
    let mut trajectory = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let content = line.split('#').next().unwrap_or_default().trim();
        if content.is_empty() {
            continue;
        }
        let fail = |reason: String| TumError { line: index + 1, reason };
        let numbers: Vec<f64> = content
            .split_whitespace()
            .map(|word| {
                word.parse()
                    .ok()
                    .filter(|number: &f64| number.is_finite())
                    .ok_or_else(|| fail(format!("`{word}` is not a finite number")))
            })
            .collect::<Result<_, _>>()?;
        let &[time_s, x, y, z, qx, qy, qz, qw] = numbers.as_slice() else {
            return Err(fail(format!(
                "{} numbers, expected 8: time x y z qx qy qz qw",
                numbers.len()
            )));
        };
        if [x, y, z].iter().any(|coordinate| coordinate.abs() > FARTHEST_M) {
            return Err(fail(format!("a position farther than {FARTHEST_M:e} m from the origin")));
        }
        let quaternion = Quaternion::new(qw, qx, qy, qz);
        if quaternion.norm() < 1e-6 {
            return Err(fail("the quaternion is zero".into()));
        }
        let pose = Isometry3::from_parts(
            Translation3::new(x, y, z),
            UnitQuaternion::from_quaternion(quaternion),
        );
        trajectory.push(TimedPose { time_s, pose });
    }
    Ok(trajectory)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_place_beyond_the_earth_is_refused_with_its_line() {
        let error = parse("0 0 0 0 0 0 0 1\n1 0 -1e300 0 0 0 0 1\n").unwrap_err();
        assert_eq!(error.line, 2);
        assert!(error.to_string().contains("origin"), "{error}");
    }

    proptest! {
        #[test]
        fn poses_survive_the_text(v in prop::array::uniform7(-100.0..100.0f64)) {
            let pose = Isometry3::from_parts(
                Translation3::new(v[0], v[1], v[2]),
                UnitQuaternion::from_euler_angles(v[3], v[4], v[5]),
            );
            let text = format(&[TimedPose { time_s: v[6], pose }]);
            let back = parse(&text).unwrap();
            prop_assert!((back[0].pose.translation.vector - pose.translation.vector).norm() < 2e-6);
            prop_assert!(back[0].pose.rotation.angle_to(&pose.rotation) < 1e-7);
        }
    }

    #[test]
    fn errors_name_line_and_reason() {
        assert_eq!(
            parse("# t\n0 0 0 0 0 0 0 1\n1 2 3\n").unwrap_err().to_string(),
            "line 3: 3 numbers, expected 8: time x y z qx qy qz qw"
        );
        assert!(parse("0 0 0 x 0 0 0 1").unwrap_err().to_string().contains("`x`"));
        assert!(parse("0 0 0 0 0 0 0 0").unwrap_err().to_string().contains("zero"));
    }
}
