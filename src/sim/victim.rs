//! Bodies of victims: boxes for the seven body parts that the victim sensor tells apart.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A body part as the victim sensor names it; left and right are not told apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum BodyPart {
    /// Head.
    Head,
    /// Upper or lower arm.
    Arm,
    /// Hand.
    Hand,
    /// Chest.
    Chest,
    /// Pelvis.
    Pelvis,
    /// Upper or lower leg.
    Leg,
    /// Foot.
    Foot,
}

impl BodyPart {
    /// The name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Self::Head => "Head",
            Self::Arm => "Arm",
            Self::Hand => "Hand",
            Self::Chest => "Chest",
            Self::Pelvis => "Pelvis",
            Self::Leg => "Leg",
            Self::Foot => "Foot",
        }
    }

    /// Whether it shows skin rather than cloth.
    pub(crate) fn is_bare(self) -> bool {
        matches!(self, Self::Head | Self::Arm | Self::Hand)
    }
}

/// How a victim rests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Posture {
    /// On the back, arms beside the body.
    #[default]
    Lying,
    /// On the ground, back upright, legs stretched out forward.
    Sitting,
}

/// One box of a body: the part, its pose in the victim's frame and its half extents in metres.
///
/// The victim's frame stands on the ground under the pelvis, z up, x along the victim's yaw.
pub struct PartBox {
    /// The body part.
    pub part: BodyPart,
    /// Pose of the box in the victim's frame.
    pub victim_from_box: Isometry3<f64>,
    /// Half extents.
    pub half: Vector3<f64>,
}

/// The boxes of a grown person of about 1.75 m.
pub fn body(posture: Posture) -> Vec<PartBox> {
    match posture {
        Posture::Lying => lying(),
        Posture::Sitting => sitting(),
    }
}

fn part(part: BodyPart, centre: [f64; 3], size: [f64; 3], pitch_rad: f64) -> PartBox {
    PartBox {
        part,
        victim_from_box: Isometry3::from_parts(
            Vector3::from(centre).into(),
            UnitQuaternion::from_euler_angles(0.0, pitch_rad, 0.0),
        ),
        half: Vector3::from(size) / 2.0,
    }
}

/// Both limbs of a pair, mirrored about the body's middle plane.
fn pair(kind: BodyPart, centre: [f64; 3], size: [f64; 3], pitch_rad: f64) -> [PartBox; 2] {
    let [x, y, z] = centre;
    [part(kind, [x, y, z], size, pitch_rad), part(kind, [x, -y, z], size, pitch_rad)]
}

fn lying() -> Vec<PartBox> {
    let mut boxes = vec![
        part(BodyPart::Head, [0.76, 0.0, 0.10], [0.24, 0.17, 0.20], 0.0),
        part(BodyPart::Chest, [0.37, 0.0, 0.11], [0.50, 0.38, 0.22], 0.0),
        part(BodyPart::Pelvis, [0.0, 0.0, 0.10], [0.24, 0.36, 0.20], 0.0),
    ];
    boxes.extend(pair(BodyPart::Arm, [0.30, 0.27, 0.06], [0.52, 0.10, 0.10], 0.0));
    boxes.extend(pair(BodyPart::Hand, [-0.06, 0.29, 0.04], [0.18, 0.09, 0.06], 0.0));
    boxes.extend(pair(BodyPart::Leg, [-0.50, 0.11, 0.08], [0.76, 0.15, 0.15], 0.0));
    boxes.extend(pair(BodyPart::Foot, [-0.92, 0.12, 0.12], [0.10, 0.10, 0.24], 0.0));
    boxes
}

fn sitting() -> Vec<PartBox> {
    let mut boxes = vec![
        part(BodyPart::Head, [-0.08, 0.0, 0.78], [0.20, 0.17, 0.24], 0.0),
        part(BodyPart::Chest, [-0.06, 0.0, 0.42], [0.24, 0.38, 0.46], 0.0),
        part(BodyPart::Pelvis, [0.0, 0.0, 0.10], [0.26, 0.36, 0.20], 0.0),
    ];
    boxes.extend(pair(BodyPart::Arm, [0.04, 0.25, 0.40], [0.10, 0.10, 0.52], -0.5));
    boxes.extend(pair(BodyPart::Hand, [0.22, 0.26, 0.17], [0.18, 0.09, 0.06], 0.0));
    boxes.extend(pair(BodyPart::Leg, [0.50, 0.12, 0.09], [0.78, 0.15, 0.15], 0.0));
    boxes.extend(pair(BodyPart::Foot, [0.93, 0.13, 0.12], [0.10, 0.10, 0.24], 0.0));
    boxes
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn both_postures_have_all_seven_parts_above_the_ground() {
        for posture in [Posture::Lying, Posture::Sitting] {
            let boxes = body(posture);
            let parts: BTreeSet<BodyPart> = boxes.iter().map(|b| b.part).collect();
            assert_eq!(parts.len(), 7);
            for b in &boxes {
                let down = b.victim_from_box.rotation.inverse() * Vector3::z();
                let reach = down.abs().dot(&b.half);
                assert!(b.victim_from_box.translation.z - reach > -0.011, "{:?}", b.part);
            }
        }
    }
}
