//! `keyframes.json`: where the robot stood when it looked, how sure it is of that, and which landmark it
//! took each plane for.

use super::evaluate::Patch;
use crate::mapping::Mapper;
use crate::mission::Belief;
use crate::time::Stamp;
use nalgebra::{Isometry3, Matrix3, Matrix6, Point3};
use serde::{Deserialize, Serialize};

/// One scan that went into the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Keyframe {
    /// Level time of its last row in seconds; `None` where the scan had no stamps.
    pub time_s: Option<f64>,
    /// Estimated pose in the map frame: `translation` in metres, `rotation` as a quaternion (x, y, z, w).
    pub pose: Isometry3<f64>,
    /// Covariance of the motion from the first keyframe, as a perturbation (translation in metres, rotation
    /// vector in radians) in the frame of the first.
    pub motion_covariance: Option<Matrix6<f64>>,
    /// The same of the motion from the keyframe before, in the frame of that one; `None` for the first, and in the
    /// paper's mode, which forgets where it was before.
    #[serde(default)]
    pub step_covariance: Option<Matrix6<f64>>,
    /// The planes seen, in the robot frame.
    pub sightings: Vec<Sighting>,
}

/// A plane seen in a scan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sighting {
    /// `id` of the landmark in `surfaces.json` that it was taken for.
    pub landmark: u32,
    /// The plane, in the robot frame.
    #[serde(flatten)]
    pub patch: Patch,
    /// Standard deviation of its normal in radians, about the axis about which it is greatest: a sliver one column
    /// wide tells nothing of how it is turned about its length.
    #[serde(default)]
    pub tilt_sigma_rad: f64,
}

/// The keyframes of a belief, in order.
pub fn keyframes(belief: &Belief) -> Vec<Keyframe> {
    let times = belief.keyframe_stamps().map(|stamp| stamp.map(Stamp::seconds));
    keyframes_at(belief.mapper(), times)
}

/// The keyframes of a mapper, in order, made at `times_s`.
pub fn keyframes_at(
    mapper: &Mapper,
    times_s: impl IntoIterator<Item = Option<f64>>,
) -> Vec<Keyframe> {
    let record = |(number, (pose, time_s)): (usize, (Isometry3<f64>, Option<f64>))| Keyframe {
        time_s,
        pose,
        motion_covariance: mapper.motion_covariance(0, number),
        step_covariance: mapper.step_covariance(number),
        sightings: sightings(mapper, number),
    };
    mapper.keyframes().into_iter().zip(times_s).enumerate().map(record).collect()
}

fn sightings(mapper: &Mapper, number: usize) -> Vec<Sighting> {
    let planes = mapper.sightings(number).into_iter();
    planes
        .map(|(landmark, seen)| Sighting {
            landmark: landmark.0,
            patch: Patch {
                normal: seen.normal(),
                centroid: Point3::from(seen.robot_from_plane.translation.vector),
                hull: seen.hull_points().collect(),
            },
            tilt_sigma_rad: tilt_sigma_rad(&seen.covariance),
        })
        .collect()
}

/// The greatest standard deviation of the tilts of a plane with this covariance (offset, tilts).
fn tilt_sigma_rad(covariance: &Matrix3<f64>) -> f64 {
    let tilts = covariance.fixed_view::<2, 2>(1, 1).into_owned();
    tilts.symmetric_eigenvalues().max().max(0.0).sqrt()
}
